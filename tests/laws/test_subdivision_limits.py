"""Limits of repeated refinement: positions, and whether the surface flattens out around a vertex."""

from math import cos, pi

import numpy as np
import pytest

from meshfit.mesh.geometry import face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import subdivide
from tests.laws.local_matrix import boundary_matrix, local_matrix
from tests.loops import over

VALENCES = (3, 4, 5, 6, 7, 8, 12)


def limit_mask(matrix: np.ndarray) -> np.ndarray:
    """Weights of the limit position of the central vertex: what its row tends to under repetition."""
    return np.linalg.matrix_power(matrix, 128)[0]


def loop_ring(n: int) -> float:
    return 5 / 8 - (3 / 8 + cos(2 * pi / n) / 4) ** 2


@over("n", VALENCES)
def test_loop_limit_position(n):
    found = limit_mask(local_matrix(n, "loop"))
    chi = 1 / (n + 3 * n / (8 * loop_ring(n)))
    np.testing.assert_allclose(found, [1 - n * chi] + [chi] * n + [0] * (3 * n - n), rtol=0, atol=1e-12)


@over("n", VALENCES)
def test_sqrt3_limit_position(n):
    found = limit_mask(local_matrix(n, "sqrt3"))
    a = (4 - 2 * cos(2 * pi / n)) / 9
    expected = np.array([1] + [3 * a / n] * n + [0] * (2 * n)) / (1 + 3 * a)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@over("n", VALENCES)
@over("alpha", [0, 0.25, 0.5, 0.75, 1])
def test_blend_limit_position(n, alpha):
    """Sums over the rings; in the second ring, verts straight ahead on a spoke and those between alternate."""
    a, g = alpha, loop_ring(n)
    found = limit_mask(local_matrix(n, f"interp-loop:alpha={alpha}"))
    scale = 840 * g + 33 * a + 315 - 328 * a * g
    parts = {
        "centre": (found[0], 92 * a**2 * g + 420 * a * g + 33 * a + 315),
        "ring": (found[1 : n + 1].sum(), 8 * g * (1 - a) * (23 * a + 105)),
        "ahead": (found[n + 1 :: 2].sum(), -28 * a * g * (1 - a)),
        "between": (found[n + 2 :: 2].sum(), -64 * a * g * (1 - a)),
    }
    for value, numerator in parts.values():
        assert np.isclose(value, numerator / scale, rtol=0, atol=1e-10)


@over("neighbours", [2, 3, 4, 5, 7])
def test_limit_of_loops_boundary_is_the_cubic_bsplines(neighbours):
    found = limit_mask(boundary_matrix(neighbours, "loop"))
    inner_spokes = neighbours - 1
    expected = np.zeros(len(found))
    expected[0], expected[1], expected[-2] = 4 / 6, 1 / 6, 1 / 6
    assert len(found) == 1 + 3 * inner_spokes + 2
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def bends(mesh: Mesh) -> np.ndarray:
    """Angles, in degrees, between the faces at each edge of a closed mesh."""
    topology, normals = Topology.of(mesh), face_normals(mesh)
    other = topology.twin[topology.edge_halfedge] // 3
    cosine = (normals[topology.edge_halfedge // 3] * normals[other]).sum(axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def volume(mesh: Mesh) -> float:
    return float(np.linalg.det(mesh.verts[mesh.faces]).sum() / 6)


SHARPEST = {
    "icosahedron": {
        "loop": 1.65,
        "interp-loop:alpha=0.5": 2.19,
        "interp-loop": 3.48,
        "butterfly": 4.03,
        "modified-butterfly": 4.36,
    },
    "octahedron": {
        "loop": 3.5,
        "interp-loop:alpha=0.5": 5.4,
        "interp-loop": 9.4,
        "interp-loop:weights=warren": 28.9,
        "butterfly": 11.0,
        "modified-butterfly": 11.3,
    },
    "tetrahedron": {
        "loop": 7.6,
        "interp-loop:alpha=0.5": 35,
        "interp-loop": 57.8,
        "interp-loop:valence3=zorin": 25.5,
        "butterfly": 109,
        "modified-butterfly": 28.3,
    },
}


@over("solid, spec", [(solid, spec) for solid, row in SHARPEST.items() for spec in row])
def test_sharpest_bend_after_five_levels(solid, spec):
    expected = SHARPEST[solid][spec]
    assert np.isclose(bends(subdivide(SOLIDS[solid](), spec, 5)).max(), expected, rtol=0.015, atol=0.05)


@pytest.mark.parametrize(("spec", "expected"), [("loop", 0.57), ("interp-loop:alpha=0.5", 0.95), ("interp-loop", 1.52)])
def test_volume_of_a_refined_icosahedron(spec, expected):
    """Loop shrinks, interpolation swells; the circumscribed sphere has 1.65 times the volume."""
    solid = SOLIDS["icosahedron"]()
    assert np.isclose(volume(subdivide(solid, spec, 5)) / volume(solid), expected, rtol=0, atol=0.006)


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("interp-loop", [101, 85, 42, 23, 58, 63, 48]),
        ("interp-loop:valence3=zorin", [98, 70, 41, 22, 11, 5.5, 2.7]),
        ("butterfly", [109.47] * 6),
    ],
)
def test_bend_at_the_corners_of_a_tetrahedron_by_level(spec, expected):
    """Valence 3: the displacement rule never flattens out there, the safeguard halves the bend with each level."""
    mesh, found = SOLIDS["tetrahedron"](), []
    for _ in expected:
        mesh = subdivide(mesh, spec)
        corner = (Topology.of(mesh).edges < 4).any(axis=1)
        found.append(bends(mesh)[corner].max())
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.6)
