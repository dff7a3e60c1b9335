"""Frames: known answers, and round trips."""

import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame, frame_of
from tests.loops import over
from tests.shapes import ALL, mixed_closed

TRIANGLE = np.array([[1.0, 0, 0], [4, 0, 0], [1, 4, 12]])


def test_tutorial_frame_has_its_mean_at_0_and_its_largest_coordinate_at_1():
    frame = frame_of(TRIANGLE, "tutorial")
    assert frame.centre == pytest.approx((2, 4 / 3, 4))
    assert frame.scale == pytest.approx(8)
    verts = frame.normalise(Mesh(TRIANGLE, np.array([[0, 1, 2]]))).verts
    assert verts.mean(axis=0) == pytest.approx(0)
    assert np.abs(verts).max() == 1.0


def test_box_frame_has_its_box_about_0_with_diagonal_1():
    frame = frame_of(TRIANGLE, "box")
    assert frame == Frame((2.5, 2.0, 6.0), 13.0)
    verts = frame.normalise(Mesh(TRIANGLE, np.array([[0, 1, 2]]))).verts
    assert verts.min(axis=0) == pytest.approx(-verts.max(axis=0))
    assert np.linalg.norm(np.ptp(verts, axis=0)) == pytest.approx(1)


def test_sphere_frame_has_its_mean_at_0_and_its_farthest_vertex_at_distance_1():
    frame = frame_of(TRIANGLE, "sphere")
    assert frame.centre == pytest.approx((2, 4 / 3, 4))
    assert frame.scale == pytest.approx(np.sqrt(1 + 64 / 9 + 64))


def test_cube_frame_has_its_box_about_0_with_longest_side_1():
    assert frame_of(TRIANGLE, "cube") == Frame((2.5, 2.0, 6.0), 12.0)


def test_no_frame_leaves_coordinates_as_they_are():
    assert frame_of(TRIANGLE, "none") == Frame((0.0, 0.0, 0.0), 1.0)
    mesh = mixed_closed()
    assert np.array_equal(frame_of(mesh.verts, "none").normalise(mesh).verts, mesh.verts)


def test_the_box_does_not_depend_on_how_densely_verts_lie():
    dense = np.concatenate([TRIANGLE, np.repeat(TRIANGLE[:1], 50, axis=0)])
    assert frame_of(dense, "box") == frame_of(TRIANGLE, "box")
    assert frame_of(dense, "tutorial") != frame_of(TRIANGLE, "tutorial")


@over("size", [1e-9, 1.0, 1e9])
@over("how", ["tutorial", "sphere", "box", "cube", "none"])
@over("shape", ALL)
def test_there_and_back(shape, how, size):
    mesh = Mesh(ALL[shape]().verts * size + 3 * size, ALL[shape]().faces)
    frame = frame_of(mesh.verts, how)
    found = frame.restore(frame.normalise(mesh))
    assert np.allclose(found.verts, mesh.verts, rtol=0, atol=1e-14 * size)
    assert np.array_equal(found.faces, mesh.faces)


@over("how", ["tutorial", "sphere", "box", "cube"])
def test_the_frame_moves_and_scales_with_the_mesh(how):
    verts = mixed_closed().verts
    one, other = frame_of(verts, how), frame_of(verts * 7 + [1, 2, 3], how)
    assert other.scale == pytest.approx(7 * one.scale)
    assert other.centre == pytest.approx(np.array(one.centre) * 7 + [1, 2, 3])


@over("how", ["tutorial", "sphere", "box", "cube"])
def test_a_mesh_at_one_point_has_no_frame(how):
    with pytest.raises(MeshError, match="no extent: all its vertices are at one point"):
        frame_of(np.full((5, 3), 0.5), how)
