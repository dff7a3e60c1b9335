"""MeshLab filters: the behaviour we rely on, and the defaults we avoid."""

import warnings

import numpy as np
import pytest

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.manifold import euler_number, is_watertight
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate, point_to_surface, self_intersecting_faces
from meshfit.mesh.solids import cube
from meshfit.mesh.targets import load_target
from meshfit.mesh.topology import Topology
from tests.loops import over


def triangles(verts, faces):
    return Mesh(np.array(verts, dtype=np.float64), np.array(faces, dtype=np.int64))


FLOOR = triangles([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])


def load_bone():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)
        return load_target("bone")


def test_distances_of_points_above_a_floor_are_their_heights():
    heights = np.array([0.0, 1.0, 2.0, 5.0])
    points = np.column_stack([np.arange(4), np.arange(4), heights])
    found = point_to_surface(points, FLOOR)
    assert found.count == 4
    assert found.largest == pytest.approx(5)
    assert found.mean == pytest.approx(heights.mean())
    assert found.rms == pytest.approx(np.sqrt((heights**2).mean()))


@over("height", [1e-6, 1.0, 1e3, 1e6])
def test_no_point_is_too_far_to_count(height):
    """By default the filter leaves out what is beyond half a diagonal, and reports 0 for a total failure."""
    found = point_to_surface(np.array([[0.0, 0.0, height]]), FLOOR)
    assert (found.count, found.largest) == (1, pytest.approx(height, rel=2e-7))


def test_each_point_counts_once_however_few_verts_the_surface_has():
    points = np.random.default_rng(0).random((5000, 3))
    found = point_to_surface(points, FLOOR)
    assert found.count == 5000
    assert found.mean == pytest.approx(points[:, 2].mean(), rel=2e-7)
    assert found.largest == pytest.approx(points[:, 2].max(), rel=2e-7)


def test_verts_without_faces_are_no_surface():
    littered = Mesh(np.concatenate([FLOOR.verts, [[0, 0, 4.0]]]), FLOOR.faces)
    assert point_to_surface(np.array([[0.0, 0.0, 4.0]]), littered).largest == pytest.approx(4)


def test_faces_without_area_do_no_harm():
    points = np.random.default_rng(0).random((500, 3))
    broken = Mesh(FLOOR.verts, np.concatenate([FLOOR.faces, [[0, 0, 1], [2, 2, 2]]]))
    assert point_to_surface(points, broken) == point_to_surface(points, FLOOR)


def test_many_calls_in_one_process():
    """Releases before 2025.7 crashed after about a hundred MeshSets."""
    point = np.array([[0.0, 0.0, 1.0]])
    assert {point_to_surface(point, FLOOR).largest for _ in range(300)} == {1.0}


def test_self_intersections_are_found_on_both_faces():
    verts = [
        [0, 0, 0],
        [1, 0, 0],
        [0, 1, 0],
        [0.2, 0.2, -1],
        [0.3, 0.2, 1],
        [0.2, 0.3, 1],
        [5, 5, 5],
        [6, 5, 5],
        [5, 6, 5],
    ]
    assert self_intersecting_faces(triangles(verts, [[0, 1, 2], [6, 7, 8], [3, 4, 5]])).tolist() == [True, False, True]
    assert not self_intersecting_faces(cube()).any()


@over("num_faces", [2000, 500])
def test_decimation_reaches_its_count_and_keeps_the_topology(num_faces):
    bone = load_bone()
    reduced = decimate(bone, num_faces)
    assert abs(reduced.num_faces - num_faces) <= 2
    topology = Topology.of(reduced)
    assert is_watertight(topology)
    assert euler_number(topology) == euler_number(Topology.of(bone))


def test_decimation_is_the_same_each_time():
    first, second = (decimate(load_bone(), 700) for _ in range(2))
    assert np.array_equal(first.verts, second.verts)
    assert np.array_equal(first.faces, second.faces)


def test_decimating_to_nothing_is_refused():
    with pytest.raises(MeshError, match="decimation to 0 faces left nothing of a mesh of 1"):
        decimate(triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 1]]), 0)
