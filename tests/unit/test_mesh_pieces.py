"""Oriented manifold pieces of any triangles, and the crossings within them and between them."""

import numpy as np

from meshfit.mesh.cleaning import outward
from meshfit.mesh.geometry import face_areas, signed_volume
from meshfit.mesh.manifold import describe_topology, require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.pieces import crossing_faces, manifold_pieces, piece_of_face
from meshfit.mesh.solids import cube, icosahedron, octahedron
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import subdivide
from tests.shapes import patch, torus


def joined(*meshes):
    offsets = np.cumsum([0, *(mesh.num_verts for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return Mesh(np.concatenate([mesh.verts for mesh in meshes]), np.concatenate(faces))


def topology(mesh):
    return describe_topology(Topology.of(mesh))


def moebius(count=12):
    turn = np.pi * np.arange(count) / count
    rim = [
        np.stack(
            [(2 + s * np.cos(turn)) * np.cos(2 * turn), (2 + s * np.cos(turn)) * np.sin(2 * turn), s * np.sin(turn)]
        )
        for s in (-0.5, 0.5)
    ]
    low, high = np.arange(count), np.arange(count) + count
    # The last piece joins each side to the other.
    next_low, next_high = np.append(low[1:], high[0]), np.append(high[1:], low[0])
    faces = np.concatenate([np.stack([low, next_low, high], 1), np.stack([next_low, next_high, high], 1)])
    return Mesh(np.concatenate(rim, axis=1).T, faces)


def test_sound_meshes_stay_as_they_are():
    for mesh in (cube(), torus(), patch(), joined(cube(), torus())):
        pieces = manifold_pieces(mesh)
        assert topology(pieces) == topology(mesh)
        np.testing.assert_array_equal(pieces.verts[pieces.faces], mesh.verts[mesh.faces])


def test_faces_are_wound_as_most_of_their_piece():
    mesh = joined(subdivide(octahedron(), "midpoint", 2), torus())
    turned = np.random.default_rng(0).random(mesh.num_faces) < 0.3
    mixed = Mesh(mesh.verts, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces))
    pieces = manifold_pieces(mixed)
    require_manifold(Topology.of(pieces), "this")
    assert topology(pieces) == topology(mesh)
    np.testing.assert_allclose(signed_volume(pieces), signed_volume(mesh))
    inwards = Mesh(mesh.verts, np.where(turned[:, None], mesh.faces, mesh.faces[:, ::-1]))
    np.testing.assert_allclose(signed_volume(outward(inwards)), signed_volume(mesh))
    assert outward(mesh) is mesh


def test_surfaces_that_are_no_manifold_are_separated_without_loss_of_area():
    fin = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    tip = joined(octahedron(), octahedron())
    tip = Mesh(tip.verts + np.repeat([[0, 0, 0], [2, 0, 0]], 6, axis=0), tip.faces)
    shared = int(np.flatnonzero((tip.verts == [1, 0, 0]).all(axis=1))[1])
    tip = Mesh(tip.verts, np.where(tip.faces == shared, np.flatnonzero((tip.verts == [1, 0, 0]).all(1))[0], tip.faces))
    for mesh, expected in ((fin, 2), (tip, 2), (moebius(), 1)):
        pieces = manifold_pieces(mesh)
        require_manifold(Topology.of(pieces), "this")
        assert piece_of_face(pieces)[0] >= expected
        np.testing.assert_allclose(face_areas(pieces).sum(), face_areas(mesh).sum())


def test_pillows_and_faces_without_three_corners_are_dropped():
    pillow = Mesh([[5, 0, 0], [6, 0, 0], [5, 1, 0]], [[0, 1, 2], [0, 2, 1], [0, 0, 1]])
    assert topology(manifold_pieces(joined(cube(), pillow))) == topology(cube())


def test_crossings_between_pieces_are_told_from_those_within():
    ball = icosahedron()
    apart = joined(ball, Mesh(ball.verts + 5, ball.faces))
    through = joined(ball, Mesh(ball.verts + 0.5, ball.faces))
    assert not crossing_faces(apart)[0].any()
    crossing, within = crossing_faces(through)
    assert crossing.any()
    assert not within.any()
    folded = patch(7, 5)
    folded = Mesh(folded.verts * [1, 1, 0] + np.where(folded.verts[:, :1] > 4, [[-4.3, 0.2, 0.0]], 0), folded.faces)
    lifted = Mesh(folded.verts + np.array([0, 0, 1.0]) * (folded.verts[:, :1] % 2), folded.faces)
    crossing, within = crossing_faces(joined(lifted, Mesh(ball.verts + 50, ball.faces)))
    assert within.any()
    np.testing.assert_array_equal(crossing, within)
