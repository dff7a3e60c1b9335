"""First-order fits from end to end: convergence, progress at every step, and any kind of source."""

import numpy as np
import pytest

from meshfit.fitting.callbacks import Step
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron, octahedron
from meshfit.settings import build
from meshfit.subdivision.refine import subdivide
from tests.fits import fit
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, patch

QUICK = {"device": "cpu", "samples": 60}
NOTHING = {"chamfer": 0, "normal": 0, "edge": 0, "laplacian": 0, "consistency": 0}
AXES = np.array([1.3, 1.0, 0.8])


def sphere(levels):
    mesh = subdivide(icosahedron(), "loop", levels)
    return Mesh(mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True), mesh.faces)


def stretched(mesh, factors):
    return Mesh(mesh.verts * factors, mesh.faces)


def distance_to_ellipsoid(verts, axes):
    """To first order, which is exact on a sphere."""
    radius = np.linalg.norm(verts / axes, axis=1)
    return np.abs(radius * (radius - 1) / np.linalg.norm(verts / axes**2, axis=1))


@pytest.mark.parametrize(
    "axes", [pytest.param(np.full(3, 1.2), marks=pytest.mark.slow), AXES], ids=["sphere", "ellipsoid"]
)
@over(
    ("changes", "factor"),
    [
        ({}, 2),  # edges of weight 1 keep the result small
        ({"losses": {"edge": 0.1}}, 10),
        ({"losses": {"edge": 0.0, "laplacian": 0.02}, "laplacian": "cotangent"}, 10),
        ({"losses": {"edge": 0.1, "normal": 0.01}}, 10),
        ({"losses": {"edge": 0.1}, "optimizer": {"name": "adam", "lr": 0.02}}, 10),
    ],
    ids=["defaults", "little edge", "cotangent", "normal", "adam"],
)
def test_a_sphere_comes_nearer_to_a_larger_one_and_to_an_ellipsoid(axes, changes, factor):
    source, target = sphere(2), stretched(sphere(3), axes)
    result = fit(source, target, steps=80, samples=500, device="cpu", **changes)
    before, after = (distance_to_ellipsoid(verts, axes).mean() for verts in (source.verts, result.mesh.verts))
    assert after < before / factor
    np.testing.assert_array_equal(result.mesh.faces, source.faces)
    assert result.trace.rows[-1][2] < result.trace.rows[0][2]
    assert result.device == "cpu"


def test_on_step_is_told_of_every_step_in_order_and_of_the_traced_loss():
    seen = []
    result = fit(icosahedron(), cube(), steps=13, trace_every=1, on_step=seen.append, **QUICK)
    assert seen == [Step(row[0] + 1, 13, row[1]) for row in result.trace.rows]
    assert [step.done for step in seen] == list(range(1, 14))


def test_no_steps_give_the_source_back():
    result = fit(mixed_open(), cube(), steps=0, dtype="float64", on_step=pytest.fail, **QUICK)
    np.testing.assert_array_equal(result.mesh.verts, mixed_open().verts)
    assert result.trace.rows == []


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_meshes_given_are_left_as_they_are_and_the_result_is_in_float64(dtype):
    source, target = mixed_closed(), cube()
    arrays = (source.verts, source.faces, target.verts, target.faces)
    copies = [array.copy() for array in arrays]
    result = fit(source, target, steps=5, dtype=dtype, **QUICK)
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    assert result.mesh.verts.dtype == np.float64
    assert not np.array_equal(result.mesh.verts, source.verts)


@pytest.mark.parametrize("optimizer", ["sgd", "adam"])
def test_with_all_weights_0_nothing_moves_and_every_term_is_still_traced(optimizer):
    result = fit(octahedron(), cube(), steps=6, losses=NOTHING, dtype="float64", optimizer={"name": optimizer}, **QUICK)
    np.testing.assert_array_equal(result.mesh.verts, octahedron().verts)
    assert [row[1] for row in result.trace.rows] == [0.0, 0.0]
    assert all(term > 0 for row in result.trace.rows for term in row[2:-1])


def test_settings_and_single_changes_mean_the_same():
    settings = build(FirstOrderSettings, {"steps": 4, "samples": 60, "losses": {"edge": 0.3}})
    whole = fit(icosahedron(), cube(), settings, device="cpu")
    changed = fit(icosahedron(), cube(), FirstOrderSettings(), steps=4, samples=60, losses={"edge": 0.3}, device="cpu")
    assert whole.trace == changed.trace


TRIANGLE = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]]), np.array([[0, 1, 2]]))
LOOSE = Mesh(np.concatenate([mixed_open().verts, [[7.0, 8.0, 9.0]]]), mixed_open().faces)
COLLAPSED = Mesh(
    np.concatenate([octahedron().verts, [[0, 0, 0]]]), np.concatenate([octahedron().faces, [[0, 1, 6], [6, 6, 6]]])
)
BOOK = Mesh(np.concatenate([np.eye(3), [[0, 0, 0], [1, 1, 1]]]), np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
ODD = {
    "open": mixed_open(),
    "flat": patch(4, 4),
    "one triangle": TRIANGLE,
    "verts of no face": LOOSE,
    "faces without area": COLLAPSED,
    "three faces at an edge": BOOK,
}


@pytest.mark.parametrize("mesh", ODD.values(), ids=ODD)
@over("laplacian", ["uniform", "cotangent"])
def test_odd_sources_and_targets_are_fitted(mesh, laplacian):
    for source, target in ((mesh, cube()), (icosahedron(), mesh)):
        result = fit(source, target, steps=4, laplacian=laplacian, losses={"normal": 0.01}, **QUICK)
        assert np.isfinite(result.mesh.verts).all()
        assert not np.allclose(result.mesh.verts, source.verts, rtol=0, atol=1e-4)


@pytest.mark.parametrize("laplacian", ["uniform", "cotangent"])
def test_verts_of_no_face_stay_where_they_are(laplacian):
    result = fit(LOOSE, cube(), steps=4, laplacian=laplacian, dtype="float64", **QUICK)
    np.testing.assert_array_equal(result.mesh.verts[-1], [7, 8, 9])


def test_a_mesh_fitted_to_itself_at_weight_1_of_chamfer_stays_near():
    result = fit(cube(), cube(), steps=30, losses=NOTHING | {"chamfer": 1.0}, **{**QUICK, "samples": 1000})
    assert np.abs(result.mesh.verts - cube().verts).max() < 0.15
