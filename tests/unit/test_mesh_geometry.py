"""Areas, normals and angles: known answers and laws."""

import numpy as np
import pytest

from meshfit.mesh.geometry import (
    area_vectors,
    bounding_box,
    bounding_box_diagonal,
    corner_angles,
    face_areas,
    face_normals,
    unit_vectors,
)
from meshfit.mesh.mesh import Mesh
from tests.loops import over
from tests.shapes import ALL, CLOSED

RIGHT = Mesh(np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]), np.array([[0, 1, 2]]))
every_shape = over("shape", ALL)


def test_right_triangle():
    assert area_vectors(RIGHT).tolist() == [[0, 0, 6]]
    assert face_areas(RIGHT).tolist() == [6]
    assert face_normals(RIGHT).tolist() == [[0, 0, 1]]
    assert np.degrees(corner_angles(RIGHT))[0] == pytest.approx([90, np.degrees(np.arctan2(4, 3)), 36.86989764584402])


def test_turning_a_face_over_turns_its_normal():
    over = Mesh(RIGHT.verts, RIGHT.faces[:, ::-1])
    assert face_normals(over).tolist() == [[0, 0, -1]]
    assert face_areas(over).tolist() == [6]


def test_faces_without_area_have_no_normal_and_no_nan():
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2], [0, 0, 1], [2, 2, 2]]))
    assert face_areas(mesh).tolist() == [0, 0, 0]
    assert face_normals(mesh).tolist() == [[0, 0, 0]] * 3
    assert np.degrees(corner_angles(mesh)).tolist() == [[0, 180, 0], [0, 0, 0], [0, 0, 0]]


@over("angle", [1e-7, 0.3, 90, 179.9999])
def test_angles_are_accurate_even_where_they_are_extreme(angle):
    turn = np.radians(angle)
    verts = np.array([[0.0, 0, 0], [1, 0, 0], [np.cos(turn), np.sin(turn), 0]])
    assert corner_angles(Mesh(verts, RIGHT.faces))[0, 0] == pytest.approx(turn, rel=1e-9)


@every_shape
def test_angles_of_a_triangle_sum_to_half_a_turn(shape):
    assert np.allclose(corner_angles(ALL[shape]()).sum(axis=1), np.pi)


@every_shape
def test_areas_agree_with_heron(shape):
    mesh = ALL[shape]()
    corners = mesh.verts[mesh.faces]
    a, b, c = (np.linalg.norm(corners[:, i] - corners[:, (i + 1) % 3], axis=1) for i in range(3))
    s = (a + b + c) / 2
    assert np.allclose(face_areas(mesh), np.sqrt(s * (s - a) * (s - b) * (s - c)), atol=1e-9)


@every_shape
def test_normals_are_unit_and_stand_on_their_faces(shape):
    mesh = ALL[shape]()
    corners, normals = mesh.verts[mesh.faces], face_normals(mesh)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    for i in range(3):
        assert np.allclose(((corners[:, i] - corners[:, i - 1]) * normals).sum(axis=1), 0)


@over("shape", CLOSED)
def test_area_vectors_of_a_closed_surface_sum_to_0(shape):
    assert np.allclose(area_vectors(CLOSED[shape]()).sum(axis=0), 0)


def test_bounding_box():
    low, high = bounding_box(RIGHT.verts)
    assert (low.tolist(), high.tolist()) == ([0, 0, 0], [3, 4, 0])
    assert bounding_box_diagonal(RIGHT.verts) == 5


def test_rows_of_length_0_stay_0():
    assert unit_vectors(np.array([[0.0, 0, 0], [0, -2, 0]])).tolist() == [[0, 0, 0], [0, -1, 0]]
