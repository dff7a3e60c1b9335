"""MeshLab filters: the behaviour we rely on, and the defaults we avoid."""

import warnings

import numpy as np
import pytest

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.manifold import euler_number
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import alpha_wrap, decimate, refine_long_edges, self_intersecting_faces
from meshfit.mesh.solids import cube
from meshfit.mesh.targets import load_target
from meshfit.mesh.topology import Topology
from tests.loops import over


def triangles(verts, faces):
    return Mesh(np.array(verts, dtype=np.float64), np.array(faces, dtype=np.int64))


def load_bone():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)
        return load_target("bone")


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
    assert topology.is_watertight
    assert euler_number(topology) == euler_number(Topology.of(bone))


def test_decimation_is_the_same_each_time():
    """MeshLab keeps what a filter was called with, so that other calls come in between."""
    first = decimate(load_bone(), 700)
    refine_long_edges(decimate(load_bone(), 60), 0.1)
    alpha_wrap(cube(), 0.2, 0.01)
    second = decimate(load_bone(), 700)
    assert np.array_equal(first.verts, second.verts)
    assert np.array_equal(first.faces, second.faces)


def test_decimating_to_nothing_is_refused():
    with pytest.raises(MeshError, match="decimation to 0 faces left nothing of a mesh of 1"):
        decimate(triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 1]]), 0)
