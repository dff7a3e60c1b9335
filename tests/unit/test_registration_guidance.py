"""Guidance of a registration: landmarks, weights, parts that stay or move rigidly, and an offset from the target."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

import meshfit
from meshfit.errors import ConfigError, MeshError
from meshfit.fitting.registration.guidance import Guidance, HeldParts
from meshfit.mesh.landmarks import PlacedLandmarks

SETTINGS = meshfit.GaussNewtonSettings(connectivity="fixed", levels=0, register="near-rigid")

# Round arms and balls fit turned, too.
pytestmark = pytest.mark.filterwarnings("ignore:the template fits about as well turned")


@pytest.fixture(scope="module")
def arm():
    """A smooth arm along x, around which any angle would fit."""
    ball = meshfit.icosphere(3)
    return ball.with_verts(ball.verts * np.array([2.0, 0.5, 0.5]))


def twisted(verts, turn):
    angle = turn * verts[:, 0]
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([verts[:, 0], c * verts[:, 1] - s * verts[:, 2], s * verts[:, 1] + c * verts[:, 2]], axis=1)


def error(result, verts):
    return float(np.sqrt(((result.mesh.verts - verts) ** 2).sum(axis=1).mean()))


def fit(source, target, **keys):
    return meshfit.fit(source, target, keys.pop("settings", SETTINGS), device="cpu", **keys)


@pytest.fixture(scope="module")
def guided(arm):
    """The arm twisted: its surface stays what it was, and only landmarks tell."""
    verts = twisted(arm.verts, 0.5)
    target = arm.with_verts(verts)
    some = np.arange(0, arm.num_verts, 16)
    goals = verts[some].copy()
    wrong = np.arange(0, len(some), 10)
    goals[wrong] = goals[wrong][::-1]
    known = meshfit.Landmarks.of(some, goals).held_out([str(number) for number in range(2, len(some), 8)])
    return target, known, fit(arm, target, landmarks=known), wrong


@pytest.mark.slow
def test_landmarks_bring_vertices_to_where_they_belong_though_some_are_wrong(arm, guided):
    target, known, result, wrong = guided
    with pytest.warns(
        meshfit.MeshfitWarning, match=r"fits about as well turned by \d+ degrees .* three landmarks tell"
    ):
        alone = fit(arm, target)
    assert error(result, target.verts) < 0.4 * error(alone, target.verts)
    errors = result.landmarks.errors(result.mesh.verts)
    right = np.ones(len(errors), dtype=bool)
    right[wrong] = False
    diagonal = np.linalg.norm(np.ptp(target.verts, axis=0))
    assert errors[right & result.landmarks.used].max() < 0.01 * diagonal
    assert (~result.landmarks.used).sum() == len(known) - sum(known.used)
    assert errors[right & ~result.landmarks.used].mean() < 0.02 * diagonal
    assert result.shortfalls == ()


@pytest.mark.slow
def test_guided_fits_continue_from_a_checkpoint_to_the_same_bytes(arm, guided):
    target, known, result, _ = guided
    checkpoints = []

    def interrupt(step):
        if step.done == 26:
            raise meshfit.Interrupted

    with pytest.raises(meshfit.Interrupted):
        fit(arm, target, landmarks=known, on_step=interrupt, save=checkpoints.append)
    again = fit(arm, target, landmarks=known, resume=checkpoints[-1])
    assert again.mesh.verts.tobytes() == result.mesh.verts.tobytes()


@pytest.mark.slow
def test_what_is_fixed_does_not_move_to_the_bit_and_rigid_parts_keep_their_distances(arm):
    bent = arm.with_verts(arm.verts + np.array([0, 0.15, 0]) * arm.verts[:, :1] ** 2)
    fixed, rigid = np.abs(arm.verts[:, 0]) < 0.3, np.where(arm.verts[:, 0] > 1.2, 2, 0)
    finer = SETTINGS.model_copy(update={"levels": 1, "level_steps": 2, "last_steps": 1})
    for settings in (SETTINGS, finer):
        result = fit(arm, bent, fixed=fixed, rigid=rigid, settings=settings, scheme="midpoint", normalise="none")
        moved = result.mesh.verts[: arm.num_verts]
        assert np.array_equal(moved[fixed], arm.verts[fixed])
        before, after = pdist(arm.verts[rigid == 2]), pdist(moved[rigid == 2])
        assert np.abs(after / before - 1).max() < 1e-9
        assert np.linalg.norm(moved[rigid == 2] - arm.verts[rigid == 2], axis=1).min() > 0.1
        free = ~fixed & (rigid == 0)
        assert np.abs(moved - bent.verts)[free].mean() < 0.5 * np.abs(arm.verts - bent.verts)[free].mean()


@pytest.mark.slow
def test_vertices_without_weight_follow_the_others(arm):
    bulge = np.exp(-6 * ((arm.verts - [0, 0.5, 0]) ** 2).sum(axis=1))
    target = arm.with_verts(arm.verts + 0.2 * bulge[:, None] * np.array([0, 1, 0]))
    weights = np.where(bulge > 0.1, 0.0, 1.0)
    still = np.flatnonzero(arm.verts[:, 1] < -0.3)
    pose = meshfit.Landmarks.of(still, arm.verts[still])
    plain, weighed = (fit(arm, target, weights=values, landmarks=pose) for values in (None, weights))
    at = bulge.argmax()
    assert plain.mesh.verts[at, 1] > weighed.mesh.verts[at, 1] + 0.05
    assert np.abs(weighed.mesh.verts[at, 1] - 0.5) < 0.1


@pytest.mark.slow
def test_an_offset_is_the_distance_from_the_target_along_its_normals():
    ball = meshfit.icosphere(3)
    near = ball.with_verts(1.02 * ball.verts)
    plain = meshfit.GaussNewtonSettings(connectivity="fixed", levels=0, coarse_steps=4, tries=1)
    for settings, offset in ((SETTINGS, 0.1), (plain, -0.1)):
        found = fit(near, ball, settings=settings, offset=offset, normalise="none")
        assert np.abs(np.linalg.norm(found.mesh.verts, axis=1) - 1 - offset).max() < 0.005


def test_refined_guidance_is_that_of_the_vertices_it_depends_on(arm):
    labels = np.where(arm.verts[:, 0] > 1, 3, 0) + np.where(arm.verts[:, 0] < -1, 5, 0)
    weights, fixed = arm.verts[:, 0] ** 2, arm.verts[:, 1] > 0.2
    landmarks = PlacedLandmarks(
        ("a", "b"),
        np.array([[7, 7, 7], arm.faces[50]]),
        np.array([[1, 0, 0], [0.2, 0.3, 0.5]]),
        np.zeros((2, 3)),
        np.ones(2, bool),
    )
    fine = meshfit.subdivide(arm, "loop", 1)
    flat = meshfit.subdivide(arm, "midpoint", 1)
    refined = Guidance(landmarks, weights, fixed, labels).refined(arm, "loop")
    assert np.allclose(refined.landmarks.points(flat.verts), landmarks.points(arm.verts))
    other = arm.with_verts(arm.verts + np.where(fixed, 0.0, 1.0)[:, None])
    assert np.array_equal(refined.fixed, (meshfit.subdivide(other, "loop", 1).verts == fine.verts).all(axis=1))
    assert set(np.unique(refined.rigid)) == {0, 3, 5}
    assert (refined.rigid == 3).sum() > (labels == 3).sum()
    assert refined.weights.min() >= 0
    assert np.allclose(refined.weights.mean(), weights.mean(), rtol=0.2)


def test_held_parts_are_moved_by_the_nearest_rigid_motion():
    generator = np.random.default_rng(0)
    rest = generator.normal(size=(20, 3))
    guidance = Guidance(fixed=np.arange(20) < 3, rigid=np.repeat([1, 1, 2, 0], 5))
    turn = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    now = rest @ turn.T + [1, 2, 3]
    held = HeldParts.of(rest, guidance).applied(now)
    assert np.array_equal(held[:3], rest[:3])
    assert np.allclose(held[3:], now[3:])
    assert not HeldParts.of(rest, None)


def test_values_that_do_not_fit_the_source_are_refused(arm):
    count = arm.num_verts
    for keys, words in (
        ({"weights": np.ones(5)}, f"weights: expected one value for each of the {count} vertices"),
        ({"weights": -np.ones(count)}, "weights: expected finite numbers of 0 or more"),
        ({"weights": np.zeros(count)}, "weights: all are 0"),
        ({"fixed": np.ones(count)}, "fixed: all vertices are"),
        ({"rigid": "abc"}, "rigid: expected a number for each vertex"),
    ):
        with pytest.raises((ConfigError, MeshError), match=words):
            fit(arm, arm, **keys)
    with pytest.raises(ConfigError, match="rigid: only a fit with register"):
        meshfit.fit(arm, arm, rigid=np.ones(count))
