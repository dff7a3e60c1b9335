"""Shapes between two: exact ends, rigid motions stay rigid, bends keep lengths, and the way back is the same."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import meshfit
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology


def bar(levels=3):
    """Return a square bar along y, of length 5.8 and width 0.17."""
    mesh = meshfit.subdivide(meshfit.as_mesh("cube", triangles=True), "midpoint", levels=levels)
    return mesh.with_verts(mesh.verts * [0.15, 5.0, 0.15])


def bent(mesh, degrees):
    """Return a bar bent to an arc; lengths on its middle line stay."""
    x, y, z = mesh.verts.T
    radius = np.ptp(y) / np.radians(degrees)
    turn = y / radius
    return mesh.with_verts(np.stack([radius - (radius - x) * np.cos(turn), (radius - x) * np.sin(turn), z], axis=1))


def twisted(mesh, degrees):
    turns = np.radians(degrees) * mesh.verts[:, 1:2] / np.ptp(mesh.verts[:, 1]) * [[0, 1, 0]]
    return mesh.with_verts(Rotation.from_rotvec(turns).apply(mesh.verts.copy()))


def lengths(mesh):
    ends = mesh.verts[Topology.of(mesh).edges]
    return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)


def with_lone_vertex_and_second_piece(mesh):
    verts = np.vstack([mesh.verts, mesh.verts + np.array([2.0, 0, 0]), [0.3, 0.2, 0.1]])
    return Mesh(verts, np.concatenate([mesh.faces, mesh.faces + mesh.num_verts]))


def test_rigid_motions_stay_rigid_and_ends_are_exact():
    shape = with_lone_vertex_and_second_piece(bar(2))
    for angle in [0, 30, 150, 179]:
        axis = np.array([1.0, 2.0, 0.5]) / np.linalg.norm([1.0, 2.0, 0.5])
        turn = Rotation.from_rotvec(np.radians(angle) * axis)
        centre = shape.verts.mean(axis=0)
        moved = shape.with_verts(turn.apply(shape.verts - centre) + centre + [3.0, -1.0, 0.5])
        first, third, last = meshfit.interpolate_shapes(shape, moved, [0, 0.3, 1])
        assert first.verts.tobytes() == shape.verts.tobytes()
        assert last.verts.tobytes() == moved.verts.tobytes()
        part = Rotation.from_rotvec(0.3 * np.radians(angle) * axis)
        expected = part.apply(shape.verts - centre) + centre + np.array([0.9, -0.3, 0.15])
        assert np.allclose(third.verts, expected, atol=1e-9)


def test_similar_shapes_are_similar_in_between():
    shape = bar(1)
    (half,) = meshfit.interpolate_shapes(shape, shape.with_verts(3 * shape.verts), [0.5])
    assert np.allclose(half.verts, 2 * shape.verts, atol=1e-12)


def test_bends_keep_lengths_where_straight_lines_shorten_them():
    shape = bar()
    for degrees in [90, 150, 300]:
        end = bent(shape, degrees)
        (half,) = meshfit.interpolate_shapes(shape, end, [0.5])
        straight = shape.with_verts((shape.verts + end.verts) / 2)
        expected = lengths(bent(shape, degrees / 2))
        assert np.abs(lengths(half) / expected - 1).max() < 0.06
        assert (lengths(straight) / expected).min() < {90: 0.93, 150: 0.8, 300: 0.3}[degrees]


def test_turns_go_on_beyond_half_a_turn_of_neighbours():
    shape = bar()
    for degrees in [300, 420]:
        (half,) = meshfit.interpolate_shapes(shape, twisted(shape, degrees), [0.5])
        assert np.abs(lengths(half) / lengths(twisted(shape, degrees / 2)) - 1).max() < 0.25
    (half,) = meshfit.interpolate_shapes(shape, bent(shape, 540), [0.5])
    assert np.abs(lengths(half) / lengths(bent(shape, 270)) - 1).max() < 0.3


def test_the_way_back_is_the_same_and_steps_are_small():
    shape, end = bar(2), twisted(bent(bar(2), 150), 60)
    shares = np.linspace(0, 1, 21)
    there = [mesh.verts for mesh in meshfit.interpolate_shapes(shape, end, shares)]
    back = [mesh.verts for mesh in meshfit.interpolate_shapes(end, shape, 1 - shares)]
    assert all(np.allclose(one, other, atol=1e-9) for one, other in zip(there, back, strict=True))
    steps = [np.abs(after - before).max() for before, after in pairwise(there)]
    assert max(steps) < 3 * np.abs(end.verts - shape.verts).max() / 20


def test_faces_without_area_and_polygons_are_interpolated():
    shape = bar(2)
    flat = shape.verts.copy()
    flat[shape.faces[10, 0]] = flat[shape.faces[10, 1]]
    flat[shape.faces[40, 0]] = flat[shape.faces[40, 1:]].mean(axis=0)
    start = shape.with_verts(flat)
    (half,) = meshfit.interpolate_shapes(start, bent(start, 150), [0.5])
    assert np.abs(half.verts - bent(start, 75).verts + bent(start, 75).verts.mean(0) - half.verts.mean(0)).max() < 2
    assert np.isfinite(half.verts).all()
    cube = meshfit.as_mesh("cube")
    (middle,) = meshfit.interpolate_shapes(cube, cube.with_verts(3 * cube.verts), [0.5])
    assert isinstance(middle, meshfit.PolygonMesh)
    assert np.allclose(middle.verts, 2 * cube.verts)


def test_unequal_faces_and_shares_beyond_the_ends_are_refused():
    shape = bar(1)
    turned = Mesh(shape.verts, np.roll(shape.faces, 1, axis=0))
    broken = shape.with_verts(np.where(np.arange(shape.num_verts)[:, None] == 3, np.nan, shape.verts))
    for other, words in [
        (bar(2), "first and second: 26 and 98 vertices"),
        (turned, "first and second: face 0 has other vertices"),
        ("cube", "first and second: 26 and 8 vertices"),
        (broken, "second: vertex 3 has a coordinate that is not finite"),
    ]:
        with pytest.raises(meshfit.MeshfitError, match=words):
            meshfit.interpolate_shapes(shape, other)
    for shares in [[1.5], ["half"], [True]]:
        with pytest.raises(meshfit.MeshfitError, match="shares: expected numbers from 0 to 1"):
            meshfit.interpolate_shapes(shape, shape, shares)
