"""Registration: poses, deformation graphs, pairs, unfolding, and whole fits with known correspondence."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import meshfit
from meshfit.errors import ConfigError, MeshfitError
from meshfit.fitting.registration.deformation_graph import DeformationGraph, nearest_rotations, rotation_matrices
from meshfit.fitting.registration.guidance import NO_GUIDANCE, HeldParts
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.pairs import Matching, find_pairs, geman_mcclure, metric_roots
from meshfit.fitting.registration.plan import PlannedStep, planned_steps
from meshfit.fitting.registration.poses import candidate_poses
from meshfit.fitting.registration.registration import Registration, RegistrationTask
from meshfit.fitting.registration.target_points import target_points
from meshfit.fitting.registration.template import Template
from meshfit.fitting.registration.unfolding import Unfolding
from meshfit.fitting.registration.vertex_fit import VertexFit
from meshfit.mesh.geometry import signed_volume
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.pieces import manifold_pieces
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.targets import load_target
from tests.shapes import torus

TURN = Rotation.from_rotvec([0.3, -0.5, 0.4]).as_matrix()


@pytest.fixture(scope="module")
def animal():
    return manifold_pieces(decimate(load_target("mousehead"), 3000))


def bent(verts, angle=1.2):
    """Bend along x, about an axis along z above the shape."""
    low, high = verts.min(axis=0), verts.max(axis=0)
    radius = (high[0] - low[0]) / angle
    turn = (verts[:, 0] - (low[0] + high[0]) / 2) / radius
    reach = radius - (verts[:, 1] - low[1]) + 0.5 * (high[1] - low[1])
    return np.stack([reach * np.sin(turn), radius - reach * np.cos(turn), verts[:, 2]], axis=1)


def root_mean_square(offsets):
    return float(np.sqrt((offsets**2).sum(axis=1).mean()))


def test_a_graph_at_rest_moves_nothing_and_follows_a_rigid_motion_exactly(animal):
    graph = DeformationGraph.of(Template(animal), 40)
    assert np.allclose(graph.weights.sum(axis=1), 1)
    assert np.allclose(graph.positions(), animal.verts, atol=1e-12)
    moved = animal.verts @ TURN.T + [1, 2, 3]
    placed = graph.fitted_to(moved)
    assert np.allclose(placed.positions(), moved, atol=1e-9)
    assert np.allclose(placed.rotations, TURN, atol=1e-7)
    assert np.allclose(placed.stiffness()[1], 0, atol=1e-9)


def test_a_soft_graph_follows_a_similarity_exactly_and_keeps_derivatives(animal):
    graph = DeformationGraph.of(Template(animal), 40)
    moved = 1.7 * animal.verts @ TURN.T + [1, 2, 3]
    stiff, soft = (graph.fitted_to(moved, similar=similar) for similar in (False, True))
    assert np.allclose(soft.rescaled().rotations, 1.7 * TURN, atol=1e-7)
    assert np.allclose(soft.rotations, 1.7 * TURN, atol=1e-7)
    assert np.allclose(soft.positions(), moved, atol=1e-7)
    assert np.allclose(soft.stiffness()[1], 0, atol=1e-7)
    assert np.abs(stiff.stiffness()[1]).max() > 0.1
    generator = np.random.default_rng(0)
    rows, step = np.arange(0, animal.num_verts, 50), 1e-6 * generator.normal(size=(graph.num_nodes, 6))
    roots = generator.normal(size=(len(rows), 3, 3))
    after, before = soft.moved(step, 1.0), soft.moved(-step, 1.0)
    change = np.einsum("nij,nj->ni", roots, (after.positions() - before.positions())[rows] / 2)
    assert np.allclose(soft.jacobian(rows, roots) @ step.ravel(), change.ravel(), atol=1e-11)


def test_derivatives_of_a_graph_are_those_of_finite_differences():
    mesh = torus(12, 8)
    generator = np.random.default_rng(0)
    graph = DeformationGraph.of(Template(mesh), 6)
    graph = graph.moved(0.3 * generator.normal(size=(graph.num_nodes, 6)), 1.0)
    rows, step = np.arange(0, mesh.num_verts, 5), 1e-6 * generator.normal(size=(graph.num_nodes, 6))
    roots = generator.normal(size=(len(rows), 3, 3))
    after, before = graph.moved(step, 1.0), graph.moved(-step, 1.0)
    change = np.einsum("nij,nj->ni", roots, (after.positions() - before.positions())[rows] / 2)
    assert np.allclose(graph.jacobian(rows, roots) @ step.ravel(), change.ravel(), atol=1e-11)
    jacobian, _ = graph.stiffness()
    assert np.allclose(jacobian @ step.ravel(), (after.stiffness()[1] - before.stiffness()[1]) / 2, atol=1e-11)


def test_every_piece_of_a_mesh_has_nodes():
    ball = meshfit.icosphere(1)
    verts = np.concatenate([ball.verts, ball.verts + np.array([5, 0, 0])])
    both = Mesh(verts, np.concatenate([ball.faces, ball.faces + ball.num_verts]))
    graph = DeformationGraph.of(Template(both), 4)
    piece = graph.nodes[graph.node_of][:, :, 0] > 2.5
    assert ((graph.weights > 0) & (piece != (both.verts[:, :1] > 2.5))).sum() == 0


def test_rotations_of_rotation_vectors_and_nearest_rotations_agree_with_scipy():
    vectors = np.random.default_rng(1).normal(size=(20, 3))
    expected = Rotation.from_rotvec(vectors).as_matrix()
    assert np.allclose(rotation_matrices(vectors), expected)
    points = np.random.default_rng(2).normal(size=(20, 7, 3))
    turned = np.einsum("nij,nkj->nki", expected, points)
    assert np.allclose(nearest_rotations(np.einsum("nki,nkj->nij", points, turned)), expected)


def test_roots_of_metrics_have_the_metric_as_square():
    normals = np.eye(3)
    weights = np.array([1.0, 2.0, 0.5])
    roots = metric_roots(normals, weights, 0.1)
    expected = weights[:, None, None] * (normals[:, :, None] * normals[:, None, :] + 0.1 * np.eye(3))
    assert np.allclose(np.swapaxes(roots, 1, 2) @ roots, expected)


def test_pairs_of_a_surface_with_itself_are_its_own_points_and_the_width_is_where_a_quarter_of_the_weight_is_left():
    points = Template(torus(20, 12)).points_at(torus(20, 12).verts)
    everything = np.arange(len(points))
    pairs = find_pairs(points, points, everything, everything, Matching(0.1, 0.1))
    assert np.array_equal(pairs.goals, points.points[pairs.verts])
    assert pairs.weights.sum() == pytest.approx(2.0)
    assert geman_mcclure(np.array([0.1]), 0.1)[0] == pytest.approx(0.25)


def test_pairs_do_not_end_on_a_rim():
    flat = meshfit.Mesh(*grid(9))
    half = meshfit.Mesh(flat.verts, flat.faces[flat.verts[flat.faces][:, :, 0].mean(axis=1) < 0.5])
    target, everything = Template(half).points_at(half.verts), np.arange(flat.num_verts)
    used = np.flatnonzero(target.areas > 0)
    target = target.subset(used)
    template = Template(flat).points_at(flat.verts)
    matching = Matching(10.0, 0.0, "to-target")
    pairs = find_pairs(template, target, everything, np.arange(len(target)), matching)
    assert pairs.goals[:, 0].max() < 0.5 - 1e-9
    assert set(pairs.verts) == set(everything[(flat.verts[:, 0] < 0.49) & ~on_rim(flat.verts)])


def grid(count):
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count)))
    verts = np.stack([x, y, np.zeros_like(x)], axis=1)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + count + 1], axis=1)
    return verts, np.concatenate([lower, np.stack([corner, corner + count + 1, corner + count], axis=1)])


def on_rim(verts):
    return np.abs(verts[:, :2] - 0.5).max(axis=1) > 0.49


@pytest.mark.slow
def test_one_of_the_poses_undoes_a_turn_and_a_change_of_size(animal):
    template = Template(animal).points_at(animal.verts)
    turn = Rotation.from_rotvec([0.2, 2.4, 0.3]).as_matrix()
    for scale in (1.0, 20.0):
        moved = animal.with_verts((animal.verts - [1, 2, 3]) @ turn.T / scale)
        source = Template(moved).points_at(moved.verts)
        poses = candidate_poses(source, template, similarity=scale != 1, most=6, seed=0)
        errors = [root_mean_square(pose.applied(moved.verts) - animal.verts) for pose in poses]
        assert min(errors) < 0.02 * np.linalg.norm(np.ptp(animal.verts, axis=0))
        assert poses[0].scale == 1
        assert np.array_equal(poses[0].rotation, np.eye(3))


def test_remoteness_does_not_depend_on_size_or_on_how_limbs_are_held(animal):
    template, moved = Template(animal), Template(animal.with_verts(7 * bent(animal.verts, 0.2)))
    assert np.allclose(template.remoteness, moved.remoteness, atol=0.1)
    assert template.remoteness.mean() == pytest.approx(0, abs=1e-12)


def test_unfolding_takes_crossing_faces_apart_and_allows_those_that_crossed_before(animal):
    unfolding = Unfolding.of(Template(animal))
    assert not len(unfolding.new_pairs(animal.verts))
    pushed, top = animal.verts.copy(), animal.verts[:, 1].argmax()
    near = np.linalg.norm(pushed - pushed[top], axis=1) < 0.15
    pushed[near] -= [0, 0.3, 0]
    assert len(unfolding.new_pairs(pushed)) > 0
    verts, left = unfolding.unfolded(pushed)
    assert left == unfolding.faults(verts) == (0, 0)
    assert root_mean_square((verts - pushed)[~near]) < 0.05
    crossing = Template(animal.with_verts(pushed))
    assert not len(Unfolding.of(crossing).new_pairs(pushed))


def test_what_cannot_be_unfolded_goes_back_to_a_sound_state_and_says_so():
    tube = torus(24, 12)
    task = RegistrationTask(tube, Template(tube).points_at(tube.verts))
    registration = Registration(task)
    registration.verts = tube.verts + 0.5 * np.random.default_rng(0).normal(size=tube.verts.shape)
    assert len(Unfolding.of(Template(tube)).new_pairs(registration.verts)) > 0
    registration.step(PlannedStep("unfolding", "unfold"))
    assert registration.crossing == len(Unfolding.of(Template(tube)).new_pairs(registration.verts)) == 0
    assert ("stayed back" in " ".join(registration.shortfalls)) == (registration.retreat > 0.005)


def test_factors_of_roots_are_within_a_factor_of_the_equations_of_vertices():
    mesh = torus(12, 6)
    template = Template(mesh)
    points = template.points_at(mesh.verts)
    fit = VertexFit(template, points, mesh.verts, "both", 1.0, NO_GUIDANCE, HeldParts.of(mesh.verts, NO_GUIDANCE))
    for mean in (np.ones(mesh.num_verts), np.random.default_rng(0).uniform(0.3, 3, mesh.num_verts)):
        equations = 0.5 * fit._bending.toarray() + np.diag(mean)
        values = np.linalg.eigvals(fit._root_inverse(0.5, mean)(np.eye(mesh.num_verts)) @ equations).real
        assert values.min() > 0.3
        assert values.max() < 1.5


def test_points_of_a_target_are_oriented_whatever_it_is(animal):
    ball = meshfit.icosphere(2)
    points = sample_surface(ball, 5000, np.random.default_rng(0)).points
    for target in (ball, PointCloud(points), PointCloud(points, points)):
        found = target_points(target)
        radial = found.points / np.linalg.norm(found.points, axis=1, keepdims=True)
        assert isinstance(found, OrientedPoints)
        assert len(found) >= 4000
        assert (np.abs((found.normals * radial).sum(axis=1)) > 0.9).mean() > 0.99
        assert not found.rim.any()


@pytest.fixture(scope="module")
def registered(animal):
    target = animal.with_verts(bent(animal.verts, 0.7))
    source = animal.with_verts((animal.verts @ TURN.T) + [0.1, 0, 0])
    settings = meshfit.GaussNewtonSettings(connectivity="fixed", levels=0, register="near-rigid")
    result = meshfit.fit(source, target, settings, device="cpu")
    return source, target, settings, result


@pytest.mark.slow
def test_vertices_of_a_bent_animal_go_where_they_belong(registered, animal):
    _, target, settings, result = registered
    diagonal = np.linalg.norm(np.ptp(target.verts, axis=0))
    assert root_mean_square(result.mesh.verts - target.verts) < 0.01 * diagonal
    assert np.array_equal(result.mesh.faces, animal.faces)
    assert result.shortfalls == ()
    assert len(result.trace.rows) == settings.steps == len(planned_steps("near-rigid"))


@pytest.mark.slow
def test_a_registration_continues_from_a_checkpoint_to_the_same_bytes(registered):
    source, target, settings, result = registered
    checkpoints = []

    def interrupt(step):
        if step.done == 4:
            raise meshfit.Interrupted

    with pytest.raises(meshfit.Interrupted):
        meshfit.fit(source, target, settings, device="cpu", on_step=interrupt, save=checkpoints.append)
    again = meshfit.fit(source, target, settings, device="cpu", resume=checkpoints[-1])
    assert again.mesh.verts.tobytes() == result.mesh.verts.tobytes()
    assert again.trace.rows == result.trace.rows


@pytest.fixture(scope="module")
def short():
    keys = {"connectivity": "fixed", "levels": 1, "tries": 1, "coarse_steps": 3, "level_steps": 2, "last_steps": 2}
    return meshfit.GaussNewtonSettings(register="auto", **keys)


def test_auto_finds_that_a_pose_is_enough_and_leaves_out_the_rest(animal, short):
    moved = animal.with_verts(40 * animal.verts @ TURN + [1, 2, 3])
    done = []
    result = meshfit.fit(moved, animal, short, scheme="midpoint", device="cpu", on_step=done.append)
    assert result.registered.register == "rigid"
    assert root_mean_square(result.mesh.verts[: animal.num_verts] - animal.verts) < 0.01
    assert [step.done for step in done[:-1]] == [1, 2, 3, 4, 5]  # one for the pose, then the level
    assert done[-1].done == done[-1].steps == len(result.trace.rows) == 5


def test_auto_registers_nothing_that_was_made_to_start_from(animal, short):
    off = short.model_copy(update={"register": "off"})
    one, other = (meshfit.fit("icosahedron", animal, settings, device="cpu") for settings in (short, off))
    assert one.registered.register == "off"
    assert one.mesh.verts.tobytes() == other.mesh.verts.tobytes()
    assert [row[1:] for row in one.trace.rows] == [row[1:] for row in other.trace.rows]


@pytest.mark.slow
def test_auto_fits_another_shape_without_a_registration_and_continues_from_a_checkpoint(animal, short):
    ball, checkpoints = meshfit.icosphere(2), []

    def interrupt(step):
        if step.done == 3:
            raise meshfit.Interrupted

    with pytest.raises(meshfit.Interrupted):
        meshfit.fit(ball, animal, short, device="cpu", on_step=interrupt, save=checkpoints.append)
    again = meshfit.fit(ball, animal, short, device="cpu", resume=checkpoints[-1])
    result = meshfit.fit(ball, animal, short, device="cpu")
    assert result.registered.register == "off"
    assert "another shape" in result.registered.reason
    assert again.mesh.verts.tobytes() == result.mesh.verts.tobytes()


@pytest.mark.slow
def test_a_template_that_fits_badly_from_every_pose_is_doubted():
    source, target = decimate(load_target("airplane"), 300), decimate(load_target("cow"), 600)
    settings = meshfit.GaussNewtonSettings(connectivity="fixed", levels=0, register="near-rigid")
    with pytest.warns(meshfit.MeshfitWarning, match="the template bends no nearer than .* give landmarks"):
        meshfit.fit(source, target, settings, device="cpu")


@pytest.mark.slow
def test_levels_after_registration_keep_vertices_in_place(registered):
    source, target, settings, _ = registered
    finer = settings.model_copy(update={"levels": 1, "register": "rigid", "level_steps": 2, "last_steps": 1})
    turned = target.with_verts(target.verts @ TURN.T)
    result = meshfit.fit(target, turned, finer, device="cpu", scheme="midpoint")
    assert result.mesh.num_faces == 4 * source.num_faces
    errors = result.mesh.verts[: target.num_verts] - turned.verts
    assert root_mean_square(errors) < 0.005 * np.linalg.norm(np.ptp(turned.verts, axis=0))


@pytest.mark.slow
def test_landmarks_lead_where_a_pose_cannot_be_seen():
    ball = meshfit.subdivide(meshfit.icosphere(2), "midpoint", 1)
    ball = ball.with_verts(ball.verts / np.linalg.norm(ball.verts, axis=1, keepdims=True))
    turned = ball.with_verts(3 * ball.verts @ TURN.T + [1, 0, 0])
    settings = meshfit.GaussNewtonSettings(connectivity="fixed", levels=0, register="near-rigid")
    some = np.arange(0, ball.num_verts, 40)
    wrong = turned.verts[some].copy()
    wrong[1] = [2, 0, 0] - wrong[1]  # on the other side
    for places in (some, ball.verts[some]):
        result = meshfit.fit(ball, turned, settings, landmarks=meshfit.Landmarks.of(places, wrong), device="cpu")
        assert root_mean_square(result.mesh.verts - turned.verts) < 0.1
        assert result.shortfalls == ()


def test_landmarks_that_cannot_be_used_are_refused(tmp_path):
    settings = meshfit.GaussNewtonSettings(connectivity="fixed", levels=0, register="rigid")
    of, goals = meshfit.Landmarks.of, meshfit.as_mesh("cube").verts[:3]
    missing = str(tmp_path / "missing.csv")
    for places, ends, words in (
        ([0, 1], goals[:2], "expected 3 or more, got 2"),
        ([0, 1, 99], goals, "landmark '3': no vertex 99; the source has 8"),
        ([0, 1, 1.5], goals, "places: expected numbers of vertices, got 1.5"),
        ([0, 1, 2, 3], goals, "as many places as goals, got 4 and 3"),
        ([0, 1, 2], goals[:, :2], r"goals: .* got shape \(3, 2\)"),
        ([0, 1, 2], goals * np.nan, "goals: expected finite numbers"),
        ("abc", goals, "places: expected vertices or rows of three"),
    ):
        with pytest.raises(MeshfitError, match=words):
            meshfit.fit("cube", "cube", settings, landmarks=of(places, ends))
    known = of([0, 1, 2, 3], [0, 1, 2, 3])
    for given, words in (
        ((known, goals), "expected Landmarks, got a tuple"),
        (known.held_out(["2", "3"]), r"expected 3 or more, got 2 \(2 held out\)"),
        (missing, "no such file"),
    ):
        with pytest.raises(MeshfitError, match=words):
            meshfit.fit("cube", "cube", settings, landmarks=given)
    with pytest.raises(ConfigError, match="the source 'target' has no places of its own"):
        meshfit.fit("target", "cube", settings, landmarks=known)
    with pytest.raises(ConfigError, match="only a fit with register"):
        meshfit.fit("cube", "cube", landmarks=known)


def test_landmarks_that_are_held_out_are_measured_alone():
    ball = meshfit.icosphere(1)
    turned = ball.with_verts(2 * ball.verts + [1, 0, 0])
    known = meshfit.Landmarks.of(np.arange(9), turned.verts[:9])
    result = meshfit.fit(ball, turned, steps=2, samples=50, landmarks=known.held_out(1.0), device="cpu")
    assert np.allclose(result.landmarks.goals, turned.verts[:9])
    expected = np.linalg.norm(result.mesh.verts[:9] - turned.verts[:9], axis=1)
    assert np.allclose(result.landmarks.errors(result.mesh.verts), expected)


def test_only_sources_that_keep_their_faces_are_registered():
    for keys in ({"connectivity": "remeshed"}, {"connectivity": "fixed", "variables": "control"}):
        with pytest.raises(ConfigError, match="register: requires connectivity: fixed and variables: verts"):
            meshfit.fit("cube", "cube", method="gauss-newton", register="rigid", **keys)


def test_a_mirrored_template_keeps_its_size_and_is_not_pressed_flat(animal):
    mirrored = animal.with_verts(animal.verts * [-1, 1, 1])  # its faces are inside out
    task = RegistrationTask(mirrored, target_points(animal))
    registration = Registration(task)
    registration.step(planned_steps("near-rigid")[0])
    volumes = [abs(signed_volume(mesh)) for mesh in (animal, mirrored.with_verts(registration.verts))]
    assert volumes[1] == pytest.approx(volumes[0], rel=0.1)
    assert registration.distance < 0.05 * task.diagonal
