"""Orders of faces and vertices for speed leave the surface unchanged."""

import numpy as np
import pytest

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import renumber_verts_by_faces, sort_faces_spatially
from tests.loops import over
from tests.shapes import ALL, mixed_closed, real, torus

LOOSE = Mesh(np.concatenate([[[9.0, 9, 9]], mixed_closed().verts, [[7.0, 8, 9]]]), 1 + mixed_closed().faces)
ALIKE = Mesh(np.eye(3), np.array([[0, 1, 2], [1, 2, 0], [2, 1, 0], [0, 1, 2], [1, 1, 1]]))
MESHES = {name: make() for name, make in ALL.items()} | {
    "verts of no face": LOOSE,
    "faces at the same place, and one without area": ALIKE,
    "larger than a leaf": torus(20, 21),
}
EACH = over("mesh", MESHES.values())


def triangles(mesh):
    """Each face by the places of its corners in their order, which is its orientation and its first corner."""
    return sorted(mesh.verts[mesh.faces].reshape(-1, 9).tolist())


@EACH
@over("order", [sort_faces_spatially, renumber_verts_by_faces])
def test_triangles_and_their_orientations_stay_the_same(mesh, order):
    assert triangles(order(mesh)) == triangles(mesh)


@EACH
def test_spatial_order_leaves_verts_as_they_are_and_takes_each_face_once(mesh):
    ordered = sort_faces_spatially(mesh)
    np.testing.assert_array_equal(ordered.verts, mesh.verts)
    assert sorted(ordered.faces.tolist()) == sorted(mesh.faces.tolist())


@EACH
def test_renumbering_keeps_the_order_of_faces_and_numbers_verts_as_they_are_met(mesh):
    renumbered = renumber_verts_by_faces(mesh)
    np.testing.assert_array_equal(renumbered.verts[renumbered.faces], mesh.verts[mesh.faces])
    met = list(dict.fromkeys(renumbered.faces.reshape(-1).tolist()))
    assert met == list(range(renumbered.num_verts))


def test_renumbering_drops_verts_of_no_face():
    assert renumber_verts_by_faces(LOOSE).num_verts == LOOSE.num_verts - 2
    assert not (renumber_verts_by_faces(LOOSE).verts == [9, 9, 9]).all(axis=1).any()


@EACH
@over("order", [sort_faces_spatially, renumber_verts_by_faces])
def test_an_order_is_the_same_each_time(mesh, order):
    np.testing.assert_array_equal(order(mesh).faces, order(mesh).faces)


@pytest.mark.slow
def test_faces_that_follow_each_other_lie_near_each_other():
    def way(mesh):
        return np.linalg.norm(np.diff(mesh.verts[mesh.faces].mean(axis=1), axis=0), axis=1).mean()

    bunny = real("bunny", 3000)
    shuffled = Mesh(bunny.verts, np.random.default_rng(0).permutation(bunny.faces))
    assert way(sort_faces_spatially(shuffled)) < way(shuffled) / 8
