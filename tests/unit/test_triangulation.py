"""Triangulation of polygons: area and closedness do not depend on the first corner, nor on how the mesh lies."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import special_ortho_group

from meshfit.errors import MeshError
from meshfit.mesh.geometry import face_areas, signed_volume
from meshfit.mesh.manifold import describe_topology, require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, face_rows
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.mesh.triangulation import triangulate
from meshfit.subdivision.refine import subdivide
from tests.loops import over
from tests.quads import EVERY, VALENCE_2, merged

PLANE = {
    "L": ([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)], 5),
    "dart": ([(2, 0), (0.5, 0.5), (0, 2), (0, 0)], 1),
    "U": ([(0, 0), (5, 0), (5, 4), (4, 4), (4, 1), (1, 1), (1, 4), (0, 4)], 11),
    "square with a corner in a side": ([(0, 0), (0.5, 0), (1, 0), (1, 1), (0, 1)], 1),
    "triangle with corners in every side": ([(0, 0), (1, 0), (2, 0), (1, 1), (0, 2), (0, 1)], 2),
    "comb": ([(0, -1), (12, -1), *[(x, x % 2 * 4) for x in range(12, -1, -1)]], 36),
    "square of 12": (
        [(x, 0) for x in range(3)]
        + [(3, y) for y in range(3)]
        + [(3 - x, 3) for x in range(3)]
        + [(0, 3 - y) for y in range(3)],
        9,
    ),
}
# A square ring as one polygon: the bridge from corner 0 to corner 4 is run through twice.
RING = [(0, 0), (4, 0), (4, 4), (0, 4), (1, 1), (1, 3), (3, 3), (3, 1)]
BRIDGED = [0, 1, 2, 3, 0, 4, 5, 6, 7, 4]


def lying(points, seed):
    """Points in the plane, moved, turned and scaled in space."""
    generator = np.random.default_rng(seed)
    turn = special_ortho_group.rvs(3, random_state=seed) if seed else np.eye(3)
    scale = 10.0 ** (seed % 5 - 2) if seed else 1.0
    return np.c_[np.array(points, float), np.zeros(len(points))] @ turn.T * scale + (seed > 0) * generator.normal(
        size=3
    ), scale


def triangles_of(verts, row):
    return Mesh(verts, triangulate(verts, np.array(row), np.array([len(row)])))


def oriented(faces):
    """Triangles from their smallest vertex on."""
    return [tuple(np.roll(face, -face.argmin()).tolist()) for face in faces]


def edges(faces):
    """Directed edges that have no twin."""
    directed = [tuple(int(v) for v in (face[k], face[(k + 1) % 3])) for face in faces for k in range(3)]
    return sorted(edge for edge in directed if edge[::-1] not in directed)


@over("name", PLANE)
@over("seed", range(4))
def test_the_triangles_fill_the_polygon_from_any_first_corner(name, seed):
    points, area = PLANE[name]
    verts, scale = lying(points, seed)
    size = len(points)
    results = {triangles_of(verts, np.roll(np.arange(size), -first)).faces.tobytes() for first in range(size)}
    assert len(results) == 1
    mesh = triangles_of(verts, np.arange(size))
    areas = face_areas(mesh) / scale**2
    assert mesh.num_faces == size - 2
    assert areas.sum() == pytest.approx(area, rel=1e-8)
    assert areas.min() > 1e-3  # corners in a side get triangles with an area
    assert edges(mesh.faces.tolist()) == sorted((k, (k + 1) % size) for k in range(size))


@over("seed", range(3))
@over("first", range(10))
def test_a_bridge_to_a_hole_is_closed(seed, first):
    verts, scale = lying(RING, seed)
    mesh = triangles_of(verts, np.roll(BRIDGED, -first))
    assert face_areas(mesh).sum() / scale**2 == pytest.approx(12)
    assert len(edges(mesh.faces.tolist())) == 8
    assert np.array_equal(mesh.faces, triangles_of(verts, BRIDGED).faces)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0.1, 1), min_size=4, max_size=40), st.integers(0, 9))
def test_star_shaped_polygons_have_the_area_of_the_shoelace_formula(radii, seed):
    angle = np.arange(len(radii)) * 2 * np.pi / len(radii)
    x, y = np.array(radii) * np.cos(angle), np.array(radii) * np.sin(angle)
    verts, scale = lying(np.stack([x, y], axis=1), seed)
    mesh = triangles_of(verts, np.arange(len(radii)))
    shoelace = 0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum()
    assert face_areas(mesh).sum() / scale**2 == pytest.approx(shoelace, rel=1e-6)


@over("shape", EVERY)
def test_surfaces_keep_their_area_and_volume_under_any_first_corners(shape):
    mesh = EVERY[shape]()
    mesh = mesh.with_verts(mesh.verts + 0.01 * np.random.default_rng(1).standard_normal(mesh.verts.shape))
    generator = np.random.default_rng(2)
    rows = [np.roll(row, generator.integers(9)) for row in face_rows(mesh)]
    turned = PolygonMesh(mesh.verts, np.concatenate(rows), mesh.sizes).triangulated()
    assert oriented(turned.faces) == oriented(mesh.triangulated().faces)
    closed = Topology.of(turned).is_watertight
    if closed:
        turn = special_ortho_group.rvs(3, random_state=3)
        moved = mesh.with_verts(mesh.verts @ turn.T + 5).triangulated()
        assert signed_volume(moved) == pytest.approx(signed_volume(turned), rel=1e-9, abs=1e-12)


def flat_pillow(points):
    """Two equal polygons in the plane, glued along all sides: a closed surface."""
    size = len(points)
    rows = np.concatenate([np.arange(size), np.arange(size)[::-1]])
    return PolygonMesh(np.c_[np.array(points, float), np.zeros(size)], rows, [size, size])


@over(
    "make",
    [
        *VALENCE_2.values(),
        *(partial(merged, seed) for seed in range(4)),
        partial(flat_pillow, [(0, 0), (2, 0), (2, 1), (0, 1)]),
        *(partial(subdivide, VALENCE_2[name](), "kobbelt", 1) for name in ("pillow", "merged")),
        *(partial(subdivide, VALENCE_2[name](), "sqrt2", 1) for name in ("pillow", "merged")),
    ],
)
def test_polygons_that_share_several_sides_share_no_diagonal(make):
    """A diagonal of both would have four triangles, and the surface would be no manifold."""
    mesh = make()
    generator = np.random.default_rng(0)
    for _ in range(3):
        rows = [np.roll(row, generator.integers(9)) for row in face_rows(mesh)]
        turned = PolygonMesh(mesh.verts, np.concatenate(rows), mesh.sizes).triangulated()
        topology = Topology.of(turned)
        require_manifold(topology, "the test")
        assert describe_topology(topology) == describe_topology(PolygonTopology.of(mesh))
        assert oriented(turned.faces) == oriented(mesh.triangulated().faces)


def test_diagonals_stay_inside_where_two_polygons_have_to_share_one():
    points, area = PLANE["L"]
    assert face_areas(flat_pillow(points).triangulated()).sum() == pytest.approx(2 * area)


def test_a_quadrilateral_is_cut_along_its_shorter_diagonal_inside():
    verts = np.array([[0.0, 0, 0], [2, 0, 0], [3, 1, 0], [0, 1, 0]])
    assert sorted(triangles_of(verts, [0, 1, 2, 3]).faces[0].tolist()) == [1, 2, 3]
    dart = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 0.2, 0], [0, 1, 0]])  # the diagonal from 1 to 3 lies outside
    assert all({0, 2} < set(face) for face in triangles_of(dart, [0, 1, 2, 3]).faces.tolist())


def test_triangles_come_in_the_order_of_the_polygons_with_their_orientation():
    generator = np.random.default_rng(0)
    sizes = np.array([3, 5, 4, 30, 4, 3])
    angle = np.concatenate([np.linspace(0, 2 * np.pi, size, endpoint=False) for size in sizes])
    verts = np.stack([np.cos(angle), np.sin(angle), 0.01 * generator.random(len(angle))], axis=1)
    faces = triangulate(verts, np.arange(len(angle)), sizes)
    owner = np.repeat(np.arange(6), sizes)
    assert np.array_equal(owner[faces], np.repeat(np.arange(6), sizes - 2)[:, None] + np.zeros((1, 3), int))
    points = verts[faces]
    assert (np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])[:, 2] > 0).all()


@over(
    "points",
    [np.zeros((6, 3)), np.full((6, 3), 1e200), np.diag([np.nan] * 6)[:, :3], np.c_[np.arange(6.0), np.zeros((6, 2))]],
)
def test_polygons_without_a_plane_give_as_many_triangles(points):
    for size in (4, 5, 6):
        assert triangulate(points, np.arange(size), np.array([size])).shape == (size - 2, 3)


def test_a_vertex_that_does_not_exist_is_refused():
    with pytest.raises(MeshError, match="vertices 0 to 4, of 4 vertices"):
        triangulate(np.eye(4)[:, :3], np.array([0, 1, 2, 4]), np.array([4]))
