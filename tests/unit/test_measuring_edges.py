"""Edge scores and angles between normals, on shapes whose creases are known."""

import numpy as np
import pytest

from meshfit.measuring.distance import surface_distances
from meshfit.measuring.edges import crease_segments, edge_scores
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron, octahedron
from meshfit.subdivision.refine import subdivide

COUNT, ANGLE, TAU = 2000, 30.0, 0.01


def scores(result, target, angle=ANGLE, tau=TAU):
    return edge_scores(result, target, COUNT, angle, tau, seed=0)


def scaled(mesh, factor):
    return Mesh(factor * mesh.verts, mesh.faces)


def length(segments):
    return np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()


def test_creases_are_the_edges_with_a_large_dihedral_angle():
    side = np.ptp(cube().verts[:, 0])
    assert length(crease_segments(cube(), 89.999)) == pytest.approx(12 * side)
    assert len(crease_segments(cube(), 90.001)) == 0
    assert len(crease_segments(icosahedron(), 41.8)) == 30  # 180° - 138.19°
    assert len(crease_segments(icosahedron(), 41.9)) == 0
    fine = subdivide(cube(), "midpoint", 2)
    assert length(crease_segments(fine, ANGLE)) == pytest.approx(12 * side)


def test_faces_turned_over_and_faces_without_area_do_not_make_creases():
    flat = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 2, 0]], [[0, 1, 2], [0, 3, 2], [0, 2, 4]])
    assert len(crease_segments(flat, ANGLE)) == 0


def test_identical_creases_agree_exactly_whatever_their_faces():
    found = scores(subdivide(cube(), "midpoint", 2), cube())
    assert found.chamfer <= 1e-15
    assert (found.f1, found.precision, found.recall, found.reason) == (1, 1, 1, "")


def test_parallel_creases_are_as_far_apart_as_they_were_moved():
    """An open book and its copy: every point of a crease of length 2 is moved by 0.1 at right angles to it."""
    verts, faces = np.array([[0, 0, 0], [0, 2, 0], [1, 0, 1.0], [-1, 0, 1.0]]), [[0, 1, 3], [1, 0, 2]]
    book, moved = Mesh(verts, faces), Mesh(verts + np.array([0, 0, 0.1]), faces)
    found = scores(moved, book)
    assert found.chamfer == pytest.approx(0.2, rel=1e-12)
    assert (found.f1, found.precision, found.recall) == (0, 0, 0)
    assert scores(moved, book, tau=0.11).f1 == 1
    # A quarter of the longer crease is within reach of the shorter one: 0.5 of 2, and 0.1 beyond its end.
    short = Mesh(verts * [1, 0.25, 1], faces)
    found = scores(book, short, tau=0.1)
    assert (found.precision, found.recall) == (pytest.approx(0.6 / 2, abs=1e-3), 1)
    assert found.f1 == pytest.approx(2 * 0.3 / 1.3, abs=1e-3)


def test_meshes_without_creases_have_a_reason_instead_of_a_value():
    smooth = subdivide(icosahedron(), "loop", 3)
    found = scores(smooth, smooth)
    assert (found.chamfer, found.f1, found.precision, found.recall) == (None, None, None, None)
    assert found.reason == "neither mesh has creases of 30° or more"
    found = scores(smooth, cube())
    assert (found.chamfer, found.f1, found.precision, found.recall) == (None, 0, None, 0)
    assert found.reason == "the result has no creases of 30° or more"
    found = scores(cube(), smooth)
    assert (found.chamfer, found.f1, found.precision, found.recall) == (None, 0, 0, None)
    assert found.reason == "the target has no creases of 30° or more"


def test_a_longer_crease_is_drawn_no_denser():
    """The mean distance of the points of two creases, of lengths 1 and 3, at distances 0 and 0.4."""

    def books(lengths, heights):
        verts = np.concatenate(
            [
                [[9 * i, 0, h], [9 * i, y, h], [9 * i + 1, 0, h + 1], [9 * i - 1, 0, h + 1]]
                for i, (y, h) in enumerate(zip(lengths, heights, strict=True))
            ]
        )
        return Mesh(verts, [[a + 4 * i for a in face] for i in range(2) for face in ([0, 1, 3], [1, 0, 2])])

    found = scores(books([1, 3], [0, 0.4]), books([1, 3], [0, 0]))
    assert found.chamfer == pytest.approx(2 * 0.3, rel=1e-3)


def test_normals_differ_by_the_angle_that_a_square_is_tilted():
    square = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    for angle in (1e-6, 20.0, 89.0):
        turn = np.radians(angle)
        tilt = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
        found = surface_distances(Mesh(square.verts @ tilt.T, square.faces), square, 500, 0)[2]
        assert [found.mean, found.p50, found.p90, found.p95, found.p99] == pytest.approx([angle] * 5, rel=1e-6)
    inside_out = Mesh(square.verts, square.faces[:, ::-1])
    assert surface_distances(inside_out, square, 500, 0)[2].mean == 180


def test_percentiles_of_distances_are_those_of_a_ramp():
    """Heights over a square rise evenly from 0 to 1, so that the percentiles are the heights themselves."""
    square = Mesh([[-1, -9, 0], [9, -9, 0], [9, 9, 0], [-1, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    ramp = Mesh([[0, 0, 0], [1, 0, 1], [1, 1, 1], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    found = surface_distances(ramp, square, 20_000, 0)[1]
    percentiles = [found.forward_p50, found.forward_p90, found.forward_p95, found.forward_p99]
    assert percentiles == pytest.approx([0.5, 0.9, 0.95, 0.99], abs=8e-3)
    there, back = (
        surface_distances(octahedron(), cube(), 9999, 0)[1],
        surface_distances(cube(), octahedron(), 9999, 0)[1],
    )
    assert there.forward_p95 == pytest.approx(back.backward_p95, rel=0.02)
    assert there.backward_p95 == pytest.approx(back.forward_p95, rel=0.02)
