"""Nearest points on surfaces and segments against the definition, in NumPy, and sides against known shapes."""

import numpy as np

from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import is_inside, nearest_on_surface, point_distances, segment_distances
from meshfit.mesh.solids import cube, icosahedron
from tests.loops import over


def inside(surface, points):
    return is_inside(surface, points, point_distances(surface, points))


def to_segments(points, ends):
    """(N,) distance to the nearest segment, by the foot of the perpendicular on each."""
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    share = ((points[:, None] - start) * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-300)
    feet = start + share.clip(0, 1)[:, :, None] * along
    return np.linalg.norm(points[:, None] - feet, axis=2).min(axis=1)


def to_triangles(points, corners):
    """(N,) distance to the nearest triangle: that to its plane where the foot is inside, or that to its sides."""
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    nearest = to_segments(points, sides)
    for a, b, c in corners:
        normal = np.cross(b - a, c - a)
        if not normal.any():
            continue
        normal /= np.linalg.norm(normal)
        height = (points - a) @ normal
        foot = points - height[:, None] * normal
        covered = np.all([np.cross(q - p, foot - p) @ normal >= 0 for p, q in ((a, b), (b, c), (c, a))], axis=0)
        nearest = np.where(covered, np.minimum(nearest, np.abs(height)), nearest)
    return nearest


@over("seed", range(4))
def test_distances_are_exact_to_1e_12_of_the_diagonal(seed):
    """Faces of any shape: slivers, and some without area."""
    generator = np.random.default_rng(seed)
    verts = generator.normal(size=(90, 3)) * [1, 1, [1, 1e-3, 1, 5][seed]]
    faces = np.concatenate([np.arange(90).reshape(-1, 3), [[0, 0, 1], [2, 2, 2]]])
    surface, points = Mesh(verts, faces), generator.normal(size=(300, 3)) * generator.choice([0.1, 1, 50], (300, 1))
    found = nearest_on_surface(surface, points)
    tolerance = 1e-12 * max(bounding_box_diagonal(verts), bounding_box_diagonal(points))
    assert np.abs(found.distances - to_triangles(points, verts[faces])).max() <= tolerance
    assert np.abs(found.distances - np.linalg.norm(points - found.points, axis=1)).max() <= tolerance
    for point, face in zip(found.points[:30], found.faces[:30], strict=True):
        assert to_triangles(point[None], verts[faces[[face]]]) <= tolerance
    ends = verts.reshape(-1, 2, 3)
    assert np.abs(segment_distances(ends, points) - to_segments(points, ends)).max() <= tolerance


def test_sides_do_not_depend_on_orientation_and_hold_where_a_surface_crosses_itself():
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    half = np.abs(cube().verts).max()
    expected = (np.abs(points) < half).all(axis=1)
    assert np.array_equal(inside(cube(), points), expected)
    assert np.array_equal(inside(Mesh(cube().verts, cube().faces[:, ::-1]), points), expected)
    shift = np.array([0.3, 0.2, 0.1])
    shifted = cube().verts + shift
    both = Mesh(np.concatenate([cube().verts, shifted]), np.concatenate([cube().faces, cube().faces + 8]))
    union = expected | (np.abs(points - shift) < half).all(axis=1)
    assert np.array_equal(inside(both, points), union)
    assert inside(icosahedron(), np.zeros((1, 3))).all()


def test_points_near_a_surface_are_on_the_right_side():
    centres = icosahedron().verts[icosahedron().faces].mean(axis=1)
    for step in (1e-12, 1e-7, 1e-3):
        assert inside(icosahedron(), (1 - step) * centres).all()
        assert not inside(icosahedron(), (1 + step) * centres).any()
    assert not inside(icosahedron(), 1.001 * icosahedron().verts).any()
