"""Loop's limit normals: masks that are left eigenvectors, and normals to which refinement converges."""

from math import cos, inf, pi

import numpy as np
import pytest

from meshfit.errors import SchemeError
from meshfit.mesh.geometry import area_vectors, unit_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS, cube
from meshfit.mesh.topology import Topology
from meshfit.subdivision.creases import Creases, creases_by_angle
from meshfit.subdivision.limit import (
    dart_masks,
    loop_limit,
    loop_limit_normals,
    loop_limit_tangents,
    open_tangents,
    smooth_tangents,
)
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import resolve
from tests.laws.local_matrix import boundary_matrix, local_matrix
from tests.laws.test_subdivision_spectra import loop_ring, warren_ring
from tests.loops import over
from tests.shapes import fan, mixed_closed, mixed_open, opened, patch, wheel

VALENCES = range(3, 13)


def area_normals(mesh: Mesh) -> np.ndarray:
    """Vertex normals of a fine mesh, by the areas of the faces around."""
    total = np.zeros_like(mesh.verts)
    np.add.at(total, mesh.faces, area_vectors(mesh)[:, None, :])
    return unit_vectors(total)


def degrees_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1)))


def dart_matrix(n: int, weights: str = "loop") -> np.ndarray:
    """Around an inner vertex from which one crease leads to its first neighbour and on."""
    mesh = wheel(n, 3)
    topology = Topology.of(mesh)
    creases = Creases.of(topology, [(0, 1)])
    rows = refine(topology, resolve(f"loop:weights={weights}"), 1, creases).matrix.toarray()
    spokes = np.flatnonzero((topology.edges == 0).any(axis=1))
    assert np.array_equal(topology.edges[spokes, 1], np.arange(1, n + 1))
    return rows[np.concatenate([[0], mesh.num_verts + spokes])][:, : n + 1]


@over("n", VALENCES)
@over("weights", ["loop", "warren"])
def test_smooth_tangents_are_left_eigenvectors(n, weights):
    matrix = local_matrix(n, f"loop:weights={weights}", 1)
    for mask in smooth_tangents(n):
        np.testing.assert_allclose(mask @ matrix, (3 / 8 + cos(2 * pi / n) / 4) * mask, rtol=0, atol=1e-14)


@over("k", range(2, 12))
def test_tangents_at_a_boundary_are_left_eigenvectors(k):
    matrix = boundary_matrix(k, "loop", 1)
    along, across = open_tangents(k)
    np.testing.assert_allclose(along @ matrix, along / 2, rtol=0, atol=1e-14)
    eigenvalue = 1 / 4 if k == 2 else 3 / 8 + cos(pi / (k - 1)) / 4
    np.testing.assert_allclose(across @ matrix, eigenvalue * across, rtol=0, atol=1e-14)
    assert np.linalg.norm(across) > 0.5


@over("n", [*VALENCES, 20, 40])
@over("weights, ring", [("loop", loop_ring), ("warren", warren_ring)])
def test_dart_masks_are_the_leading_left_eigenvectors(n, weights, ring):
    """The midpoint on the sharp edge makes the two tangents' eigenvalues differ, but both still lead all others."""
    matrix = dart_matrix(n, weights)
    position, along, across = dart_masks(n, ring(n))
    np.testing.assert_allclose(position @ matrix, position, rtol=0, atol=1e-13)
    assert np.isclose(position.sum(), 1)
    leading = 3 / 8 + cos(2 * pi / n) / 4
    np.testing.assert_allclose(across @ matrix, leading * across, rtol=0, atol=1e-13)
    other = float(along @ matrix @ along / (along @ along))
    np.testing.assert_allclose(along @ matrix, other * along, rtol=0, atol=1e-13)
    moduli = np.sort(np.abs(np.linalg.eigvals(matrix)))[::-1]
    np.testing.assert_allclose(moduli[:3], [1, *sorted((leading, other), reverse=True)], rtol=0, atol=1e-12)
    assert moduli[3] < moduli[2] - 1e-4


@over("seed", range(4))
@over("make", [mixed_closed, mixed_open])
@pytest.mark.parametrize("spec", ["loop", "loop:weights=warren"])
def test_limit_positions_stay_when_a_mesh_with_creases_is_refined(make, spec, seed):
    mesh, generator, scheme = make(), np.random.default_rng(seed), resolve(spec)
    topology = Topology.of(mesh)
    edges = topology.edges[generator.random(topology.num_edges) < 0.25]
    creases = Creases.of(topology, edges, corners=[int(generator.integers(mesh.num_verts))])
    refinement = refine(topology, scheme, 2, creases)
    fine = Topology(refinement.matrix.shape[0], refinement.faces)
    found = (loop_limit(fine, scheme, refinement.creases) @ refinement.matrix).toarray()[: mesh.num_verts]
    np.testing.assert_allclose(found, loop_limit(topology, scheme, creases).toarray(), rtol=0, atol=1e-13)


def test_limit_masks_on_a_crease_and_at_a_corner():
    mesh = wheel(6, 3)
    creases = Creases.of(Topology.of(mesh), [(0, 1), (0, 4)], corners=[5])
    limit = loop_limit(Topology.of(mesh), creases=creases).toarray()
    expected = np.zeros((2, mesh.num_verts))
    expected[0, [1, 0, 4]], expected[1, 5] = np.array([1, 4, 1]) / 6, 1
    np.testing.assert_allclose(limit[[0, 5]], expected, rtol=0, atol=1e-15)


@over("make", [mixed_closed, mixed_open, *SOLIDS.values()])
@over("weights", ["loop", "warren"])
def test_refinement_tends_to_the_normals(make, weights):
    """But for boundary verts of many neighbours: slowly at 6, and from 7 on the surface is not smooth there."""
    mesh, spec = make(), f"loop:weights={weights}"
    topology = Topology.of(mesh)
    smooth = ~topology.boundary_verts | (topology.valence < 6)
    normals = loop_limit_normals(mesh, resolve(spec))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=0, atol=1e-14)
    angles = [
        degrees_between(area_normals(subdivide(mesh, spec, levels))[: mesh.num_verts], normals) for levels in (3, 6)
    ]
    assert smooth.mean() > 0.8
    assert angles[1][smooth].max() < 3
    assert (angles[1] < np.maximum(0.5 * angles[0], 1e-3))[smooth].all()


def test_refinement_tends_to_the_normals_at_darts():
    mesh = mixed_closed()
    topology = Topology.of(mesh)
    creases = Creases.of(topology, topology.edges[[0, 40]])
    ends = topology.edges[[0, 40]].reshape(-1)
    normals = loop_limit_normals(mesh, creases=creases)[ends]
    angles = []
    for levels in (3, 6):
        fine = refine(topology, resolve("loop"), levels, creases)
        angles.append(degrees_between(area_normals(Mesh(fine(mesh.verts), fine.faces))[ends], normals))
    assert angles[1].max() < 3
    assert (angles[1] < 0.8 * angles[0]).all()


@over("make", [mixed_closed, mixed_open])
def test_normals_are_those_of_the_refined_mesh_with_its_creases(make):
    """Exactly, at verts of every kind but corners, where there is a choice."""
    mesh = make()
    topology = Topology.of(mesh)
    creases = Creases.of(topology, topology.edges[::3])
    corner = creases.rules(topology).corner == 1
    refinement = refine(topology, resolve("loop"), 2, creases)
    fine = Mesh(refinement(mesh.verts), refinement.faces)
    found = loop_limit_normals(fine, creases=refinement.creases)[: mesh.num_verts]
    assert 3 < corner.sum() < mesh.num_verts - 3
    np.testing.assert_allclose(found[~corner], loop_limit_normals(mesh, creases=creases)[~corner], atol=1e-10)


@over("centre", [0, 5, 14])
def test_on_a_crease_it_is_the_mean_of_the_normals_of_both_sides(centre):
    mesh = mixed_closed()
    inner = (mesh.faces == centre).any(axis=1)
    rim = Topology(mesh.num_verts, mesh.faces[inner])
    edges = rim.edges[rim.boundary_edges]
    verts = np.unique(edges)
    sides = [loop_limit_normals(Mesh(mesh.verts, mesh.faces[side])) for side in (inner, ~inner)]
    found = loop_limit_normals(mesh, creases=Creases.of(Topology.of(mesh), edges))
    np.testing.assert_allclose(found[verts], unit_vectors(sides[0] + sides[1])[verts], rtol=0, atol=1e-13)
    tangents = loop_limit_tangents(Topology.of(mesh), creases=Creases.of(Topology.of(mesh), edges))
    assert np.array_equal(np.bincount(tangents.vert), 1 + np.isin(np.arange(mesh.num_verts), verts))


@over("scale", [1e-200, 1, 1e60])
def test_planes_have_their_own_normal(scale):
    for mesh in (patch(5, 4), wheel(7, 2), fan(5, 2), fan(3, 2)):
        topology = Topology.of(mesh)
        for creases in (None, Creases.of(topology, topology.edges[::3], corners=[1])):
            found = loop_limit_normals(Mesh(mesh.verts * scale, mesh.faces), creases=creases)
            np.testing.assert_allclose(found, np.tile([0, 0, 1], (mesh.num_verts, 1)), rtol=0, atol=1e-13)


@over("solid", SOLIDS)
def test_they_point_outwards_and_turn_with_the_faces_and_the_mesh(solid):
    mesh = SOLIDS[solid]()
    for levels in (0, 2):
        fine = subdivide(mesh, "loop", levels)
        normals = loop_limit_normals(fine)
        assert ((normals * unit_vectors(fine.verts)).sum(axis=1) > 0.8).all()
        np.testing.assert_allclose(loop_limit_normals(Mesh(fine.verts, fine.faces[:, ::-1])), -normals, atol=1e-13)
        turn, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
        turn *= np.sign(np.linalg.det(turn))
        np.testing.assert_allclose(
            loop_limit_normals(Mesh(fine.verts @ turn + 5, fine.faces)), normals @ turn, atol=1e-12
        )


def test_a_cube_with_sharp_edges_has_the_normals_of_a_cube():
    solid = cube()
    creases = creases_by_angle(solid, 45)
    refinement = refine(Topology.of(solid), resolve("loop"), 2, creases)
    fine = Mesh(refinement(solid.verts), refinement.faces)
    outer = np.abs(fine.verts) > solid.verts.max() - 1e-9
    expected = unit_vectors(np.where(outer, np.sign(fine.verts), 0.0))
    np.testing.assert_allclose(loop_limit_normals(fine, creases=refinement.creases), expected, rtol=0, atol=1e-13)


def test_verts_on_a_line_and_verts_without_faces_have_none():
    flat = Mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]], [[0, 1, 2]])
    assert not loop_limit_normals(flat).any()
    holed = opened(mixed_closed(), 3)
    more = Mesh(np.vstack([holed.verts, [[9.0, 9.0, 9.0]]]), holed.faces)
    found = loop_limit_normals(more)
    assert not found[-1].any()
    assert np.array_equal(found[:-1], loop_limit_normals(holed)) or np.allclose(
        found[:-1], loop_limit_normals(holed), atol=1e-13
    )


def test_limits_are_refused_where_they_are_not_known():
    mesh = mixed_closed()
    topology = Topology.of(mesh)
    for compute in (lambda **given: loop_limit(topology, **given), lambda **given: loop_limit_normals(mesh, **given)):
        with pytest.raises(SchemeError, match="known for loop only"):
            compute(scheme=resolve("interp-loop"))
        with pytest.raises(SchemeError, match=r"a sharpness of 1\.5 is left; refine 2 levels more"):
            compute(creases=Creases.of(topology, topology.edges[:3], [1, 1.5, inf]))
