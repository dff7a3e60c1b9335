"""Connectivity after refinement: counts, manifoldness, orientation, boundaries, and no unused vertex."""

from collections import Counter

import numpy as np
import pytest

from meshfit.mesh.geometry import area_vectors
from meshfit.mesh.manifold import euler_number, num_components, require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES
from tests.laws.variants import QUADRISECTING, SQRT3, by_variant, refined
from tests.loops import over
from tests.shapes import ALL, CLOSED, OPEN, mixed_open, patch, wheel

NAMES = tuple(TRIANGLE_SCHEMES)
by_name = pytest.mark.parametrize("spec", NAMES)


def edge_counts(faces: np.ndarray) -> Counter:
    """How often each directed edge occurs."""
    return Counter((int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True))


def euler_by_counting(faces: np.ndarray) -> int:
    undirected = {frozenset(edge) for edge in edge_counts(faces)}
    return len(np.unique(faces)) - len(undirected) + len(faces)


@by_name
@over("shape", ALL)
@over("levels", [1, 2])
def test_counts(spec, shape, levels):
    mesh = ALL[shape]()
    coarse = Topology.of(mesh)
    fine = Topology.of(subdivide(mesh, spec, levels))
    border = int(coarse.boundary_edges.sum())
    verts, edges, faces = coarse.num_verts, coarse.num_edges, coarse.num_faces
    for step in range(levels):
        if spec in QUADRISECTING:
            verts, edges, faces, border = verts + edges, 2 * edges + 3 * faces, 4 * faces, 2 * border
        elif step % 2 == 0:
            verts, edges, faces = verts + faces, edges + 3 * faces, 3 * faces
        else:
            # Each boundary face gets two verts on its edge in place of one inside.
            verts, edges, faces = verts + faces + border, edges + 3 * faces + border, 3 * faces
            border *= 3
    assert (fine.num_verts, fine.num_edges, fine.num_faces) == (verts, edges, faces)
    assert int(fine.boundary_edges.sum()) == border


@by_name
@over("shape", ALL)
def test_topology_is_kept(spec, shape):
    mesh = ALL[shape]()
    for levels in (1, 2):
        fine = subdivide(mesh, spec, levels)
        topology = Topology.of(fine)
        require_manifold(topology, "the test")
        assert euler_by_counting(fine.faces) == euler_by_counting(mesh.faces) == euler_number(topology)
        assert num_components(topology) == num_components(Topology.of(mesh))
        assert topology.is_watertight == (shape in CLOSED)
        assert np.array_equal(np.unique(fine.faces), np.arange(fine.num_verts))


@by_name
@over("shape", ALL)
def test_orientation_is_consistent_and_that_of_the_mesh(spec, shape):
    mesh = ALL[shape]()
    fine = subdivide(mesh, spec, 2)
    counts = edge_counts(fine.faces)
    assert max(counts.values()) == 1
    rim = {edge for edge in counts if edge[::-1] not in counts}
    assert (len(rim) > 0) == (shape in OPEN)
    leaving = Counter(tail for tail, _ in rim)
    assert set(leaving.values()) <= {1}, "boundaries are simple closed curves"
    assert leaving == Counter(head for _, head in rim)


@by_name
@over("make", [patch, lambda: wheel(7, 3), lambda: wheel(4, 3)])
def test_flat_counter_clockwise_patches_stay_so(spec, make):
    for levels in (1, 2, 3):
        areas = area_vectors(subdivide(make(), spec, levels))
        assert (areas[:, 2] > 0).all()
        np.testing.assert_allclose(areas[:, :2], 0, atol=1e-14)


def test_quadrisection_tiles_each_face():
    """Under midpoint the four parts have a quarter of the area each and follow each other, the middle one last."""
    mesh = mixed_open()
    fine = subdivide(mesh, "midpoint")
    whole, parts = area_vectors(mesh), area_vectors(fine).reshape(-1, 4, 3)
    np.testing.assert_allclose(parts, np.repeat(whole[:, None] / 4, 4, axis=1), rtol=0, atol=1e-14)
    assert np.array_equal(fine.faces[3::4] >= mesh.num_verts, np.full((mesh.num_faces, 3), fill_value=True))


@pytest.mark.parametrize("spec", QUADRISECTING)
def test_all_quadrisecting_schemes_share_their_faces(spec):
    mesh = mixed_open()
    assert np.array_equal(refined(mesh, spec, 2).faces, refined(mesh, "midpoint", 2).faces)


@pytest.mark.parametrize("spec", QUADRISECTING)
def test_valences_after_quadrisection(spec):
    mesh = mixed_open()
    coarse, fine = Topology.of(mesh), Topology.of(subdivide(mesh, spec))
    assert np.array_equal(fine.valence[: mesh.num_verts], coarse.valence)
    new_on_border = fine.boundary_verts[mesh.num_verts :]
    assert np.array_equal(fine.valence[mesh.num_verts :], np.where(new_on_border, 4, 6))


@pytest.mark.parametrize("spec", SQRT3)
def test_valences_after_two_sqrt3_steps(spec):
    """Old inner verts have their own valence again, each new inner one has 6; the boundary's own verts lie on it."""
    for make in CLOSED.values():
        mesh = make()
        fine = Topology.of(subdivide(mesh, spec, 2))
        assert np.array_equal(fine.valence[: mesh.num_verts], Topology.of(mesh).valence)
        assert (fine.valence[mesh.num_verts :] == 6).all()
    mesh = patch(7, 6)
    coarse, fine = Topology.of(mesh), Topology.of(subdivide(mesh, spec, 2))
    assert np.array_equal(fine.boundary_verts[: mesh.num_verts], coarse.boundary_verts)
    assert (fine.valence[~fine.boundary_verts] == 6).all()


@by_variant
@over("levels", [1, 2, 3])
def test_verts_without_faces_stay_put(spec, levels):
    solid = octahedron()
    loose = np.array([[5.0, 6.0, 7.0], [-1.0, 2.0, -3.0]])
    # Number 0 and a number in the middle, so that indices shift.
    verts = np.concatenate([loose[:1], solid.verts[:3], loose[1:], solid.verts[3:]])
    faces = np.array([1, 2, 3, 5, 6, 7])[solid.faces]
    fine, expected = subdivide(Mesh(verts, faces), spec, levels), subdivide(solid, spec, levels)
    assert np.array_equal(fine.verts[[0, 4]], loose)
    np.testing.assert_allclose(np.delete(fine.verts, [0, 4], axis=0), expected.verts, rtol=0, atol=1e-15)
    assert not np.isin(fine.faces, [0, 4]).any()


@by_name
def test_verts_alone_are_refined_to_themselves(spec):
    points = Mesh(np.eye(3), np.empty((0, 3), dtype=np.int64))
    fine = subdivide(points, spec, 2)
    assert np.array_equal(fine.verts, points.verts)
    assert fine.faces.shape == (0, 3)
