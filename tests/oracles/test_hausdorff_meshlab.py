"""Hausdorff distances, next to those of MeshLab's filter on the same points."""

import numpy as np
import pymeshlab
import pytest

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.solids import icosahedron, octahedron
from meshfit.subdivision.refine import subdivide
from tests.loops import over


def by_meshlab(points, surface):
    """The largest and the mean distance from points to a surface."""
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(np.array(points)))
    meshes.add_mesh(pymeshlab.Mesh(np.array(surface.verts), np.array(surface.faces)))
    found = meshes.get_hausdorff_distance(
        sampledmesh=0,
        targetmesh=1,
        samplevert=True,
        sampleedge=False,
        sampleface=False,
        samplenum=len(points),
        maxdist=pymeshlab.PureValue(100.0),
    )
    assert found["n_samples"] == len(points)
    return found["max"], found["mean"]


@over("seed", range(3))
@over("make", [icosahedron, octahedron])
def test_distances_are_those_of_meshlab(seed, make):
    generator = np.random.default_rng(seed)
    ball = subdivide(make(), "loop", 3)
    surface = Mesh(ball.verts * [1.0, 0.9, 0.8], ball.faces)
    points = generator.standard_normal((2000, 3))
    distances = point_distances(surface, points)
    largest, mean = by_meshlab(points, surface)
    assert distances.max() == pytest.approx(largest, rel=1e-6)
    assert distances.mean() == pytest.approx(mean, rel=1e-6)
