"""Refusals of refinement: meshes that are not manifold, numbers out of range, arrays of the wrong shape."""

import numpy as np
import pytest
import torch

from meshfit.errors import MeshError, SchemeError
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron, tetrahedron
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import resolve
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES
from tests.loops import over

by_name = over("name", TRIANGLE_SCHEMES)
POINTS = np.random.default_rng(0).standard_normal((7, 3))


@by_name
@over(
    ("faces", "message"),
    [
        ([[0, 1, 2], [1, 0, 3], [0, 1, 4]], r"edge \(0, 1\) has 3 faces; allowed: 1 or 2 \(1 such edge\)"),
        ([[0, 1, 2], [0, 3, 4]], r"vertex 0 joins separate fans of faces"),
        ([[0, 1, 2], [2, 1, 3], [2, 4, 5], [2, 5, 6]], r"vertex 2 joins separate fans"),
        ([[0, 1, 2], [0, 1, 3]], r"edge \(0, 1\) has two faces of opposite orientation; make the face winding"),
    ],
    ids=["three faces at an edge", "bow tie", "bow tie of pairs", "winding"],
)
def test_what_is_no_oriented_manifold(name, faces, message):
    with pytest.raises(MeshError, match=f"subdivision needs a manifold mesh: {message}"):
        subdivide(Mesh(POINTS, np.array(faces)), name)


@by_name
def test_one_turned_face_among_many(name):
    solid = octahedron()
    faces = solid.faces.copy()
    faces[3] = faces[3, ::-1]
    with pytest.raises(MeshError, match=r"opposite orientation.*\(3 such edges\)"):
        subdivide(Mesh(solid.verts, faces), name)


@pytest.mark.parametrize("name", ["loop", "sqrt3"])
@pytest.mark.parametrize("faces", [[[0, 1, 2], [0, 2, 1]], [[0, 0, 1]]], ids=["doubled triangle", "degenerate face"])
def test_faces_on_the_same_verts_or_on_one_vertex_twice(name, faces):
    with pytest.raises(MeshError):
        subdivide(Mesh(np.eye(3), np.array(faces)), name, 2)


@by_name
@over("levels", [-1, -5])
def test_negative_levels(name, levels):
    with pytest.raises(SchemeError, match=f"levels={levels} is not allowed: expected 0 or more"):
        subdivide(octahedron(), name, levels)


@pytest.mark.parametrize("value", [float("nan"), -0.1, 1.1, float("inf"), np.float64(2), "half"])
def test_alpha_out_of_range(value):
    with pytest.raises(SchemeError, match=r"alpha=.* is not allowed: expected a number from 0 to 1"):
        subdivide(octahedron(), "interp-loop", alpha=value)


@pytest.mark.parametrize("value", [float("nan"), -0.1, 1.1, float("inf")])
def test_alpha_out_of_range_at_one_vertex(value):
    alphas = np.full(6, 0.5)
    alphas[4] = value
    with pytest.raises(SchemeError, match="alpha is not allowed: all its values must lie from 0 to 1"):
        subdivide(octahedron(), "interp-loop", alpha=alphas)


@pytest.mark.parametrize("shape", [(5,), (7,), (6, 1), (1,), (0,), (6, 6)])
def test_alpha_of_another_shape_than_the_verts(shape):
    with pytest.raises(MeshError, match="expected one value for each of 6 vertices"):
        subdivide(octahedron(), "interp-loop", alpha=np.full(shape, 0.5))


@pytest.mark.parametrize("value", [np.float64(0.25), np.array(0.25)], ids=["scalar", "array of no dimension"])
def test_one_alpha_from_numpy_is_as_good_as_a_number(value):
    found, expected = (subdivide(octahedron(), "interp-loop", 2, alpha=alpha).verts for alpha in (value, 0.25))
    assert np.array_equal(found, expected)
    assert not np.array_equal(found, subdivide(octahedron(), "interp-loop", 2).verts)


@pytest.mark.parametrize("scheme", ["loop", "midpoint", "sqrt3", "butterfly", resolve("loop")])
def test_alphas_for_a_scheme_without(scheme):
    with pytest.raises(SchemeError, match="no parameter alpha"):
        subdivide(octahedron(), scheme, alpha=np.full(6, 0.5))


@pytest.mark.parametrize(("name", "key", "value"), [("butterfly", "tension", 0.05), ("interp-loop", "weights", "loop")])
def test_arrays_for_parameters_that_take_one_value(name, key, value):
    with pytest.raises(SchemeError, match=f"parameter '{key}' takes one value, not an array"):
        subdivide(octahedron(), name, **{key: np.array([value] * 6)})


def test_parameters_beside_a_declared_scheme():
    with pytest.raises(SchemeError, match="'weights' goes with a scheme's name"):
        subdivide(octahedron(), resolve("loop"), weights="warren")


def test_unknown_scheme_and_parameter():
    with pytest.raises(SchemeError, match="did you mean 'loop'"):
        subdivide(octahedron(), "looop")
    with pytest.raises(SchemeError, match=r"no parameter 'tension': .*allowed: weights"):
        subdivide(octahedron(), "loop", tension=0.05)


def test_alphas_of_a_declared_scheme_are_checked_by_refine():
    topology = Topology.of(tetrahedron())
    for alphas in (np.full(5, 0.5), np.full(4, np.nan), np.full(4, 1.5), float("nan")):
        with pytest.raises((SchemeError, MeshError), match="alpha"):
            refine(topology, resolve("interp-loop").with_alpha(alphas))


def test_integers_are_not_silently_refined_to_nothing():
    """Weights below 1 become 0 as integers: refine them as reals, or refuse them."""
    refinement = refine(Topology.of(octahedron()), resolve("loop"), 1)
    ones = torch.ones(6, dtype=torch.int64)
    try:
        found = refinement(ones)
    except (TypeError, MeshError, SchemeError):
        return
    torch.testing.assert_close(found.to(torch.float64), torch.ones(18, dtype=torch.float64))
