"""Decimation by quadrics: it keeps topology and soundness, and puts vertices where the surface bends."""

import math
from functools import cache

import numpy as np
import pytest
import torch

from meshfit.mesh.manifold import euler_number, num_components
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron
from meshfit.mesh.topology import Topology
from meshfit.remeshing.decimate import decimate
from meshfit.remeshing.self_intersections import intersecting_faces
from meshfit.subdivision.refine import subdivide
from tests.loops import over
from tests.shapes import torus


def reduced(mesh, count, dtype=torch.float64, **options):
    verts, faces = decimate(torch.tensor(mesh.verts, dtype=dtype), torch.tensor(mesh.faces), count, **options)
    return Mesh(verts.double().numpy(), faces.numpy())


def angles(mesh):
    a, b, c = (mesh.verts[mesh.faces[:, k]] for k in range(3))
    sides = [np.linalg.norm(q - p, axis=1) for p, q in ((b, c), (c, a), (a, b))]
    x, y, z = sides
    cosines = [(p**2 + q**2 - r**2) / (2 * p * q) for p, q, r in ((y, z, x), (z, x, y), (x, y, z))]
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


@cache
def ellipsoid():
    ball = subdivide(icosahedron(), "midpoint", 4)
    return Mesh(ball.verts / np.linalg.norm(ball.verts, axis=1, keepdims=True) * [1.0, 0.5, 0.4], ball.faces)


def sheet(count):
    x, y = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    corner = (x * count + y)[:-1, :-1].ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + count, corner + count + 1], 1),
            np.stack([corner, corner + count + 1, corner + 1], 1),
        ]
    )
    return Mesh(np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], 1) / (count - 1), faces)


SHAPES = [ellipsoid(), torus(30, 20), subdivide(cube(), "midpoint", 3), sheet(20)]


@over("mesh", SHAPES)
@over("dtype", [torch.float32, torch.float64])
def test_the_number_is_reached_and_topology_and_soundness_are_kept(mesh, dtype):
    count = mesh.num_verts // 3
    result = reduced(mesh, count, dtype)
    assert result.num_verts == count
    before, after = Topology.of(mesh), Topology.of(result)
    assert euler_number(after) == euler_number(before)
    assert num_components(after) == num_components(before)
    assert not intersecting_faces(torch.tensor(result.verts), torch.tensor(result.faces)).any()
    assert angles(result).min() > 7.9


def test_flat_sides_and_straight_edges_of_a_cube_cost_nothing():
    result = reduced(subdivide(cube(), "midpoint", 4), 200)
    box = np.abs(cube().verts).max()
    distance = np.abs(np.abs(result.verts).max(axis=1) - box)
    assert distance.max() < 1e-4 * box
    corners = np.abs(result.verts[:, None] - cube().verts[None]).max(axis=2).min(axis=0)
    assert corners.max() < 1e-4 * box


def test_a_flat_sheet_keeps_its_outline():
    result = reduced(sheet(30), 200)
    a, b, c = (result.verts[result.faces[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(1.0, abs=1e-4)


def test_vertices_stay_near_the_surface_even_where_it_bends_most():
    """A chord of an ellipsoid of largest curvature 6.25 (1/0.4² along the longest axis) is at most κ h² / 8 off."""
    result = reduced(ellipsoid(), 400)
    radius = np.linalg.norm(result.verts / [1.0, 0.5, 0.4], axis=1)
    assert np.abs(radius - 1).max() < 0.02


def test_thin_walls_are_not_pushed_through_each_other():
    """Two nested spheres, nearer to each other than their edges become long, stay apart where that is asked for."""
    ball = subdivide(icosahedron(), "midpoint", 4)
    unit = ball.verts / np.linalg.norm(ball.verts, axis=1, keepdims=True)
    mesh = Mesh(
        np.concatenate([unit, 0.985 * unit]), np.concatenate([ball.faces, ball.faces[:, ::-1] + ball.num_verts])
    )
    result = reduced(mesh, 1500, without_crossings=True)
    assert not intersecting_faces(torch.tensor(result.verts), torch.tensor(result.faces)).any()
    assert result.num_verts >= 1500


def test_as_many_vertices_as_there_are_change_nothing():
    result = reduced(ellipsoid(), ellipsoid().num_verts)
    np.testing.assert_array_equal(result.verts, ellipsoid().verts)
    np.testing.assert_array_equal(result.faces, ellipsoid().faces)
    assert math.isclose(angles(result).sum(), 180 * result.num_faces)
