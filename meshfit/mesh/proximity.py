"""Nearest points, winding numbers, lines of sight, cuts along crossings and level sets, by libigl.

No other module imports it.

The trees of libigl work in double precision, handle faces of any shape, and take about a microsecond per point whether
it is near the surface or a diagonal away.
"""

import atexit
from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import igl
import numpy as np
from jaxtyping import Bool, Float64, Int64

from meshfit.mesh.geometry import bounding_box_diagonal, signed_volume
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import spatial_order

# Shares of the diagonal of the bounding box.
_NEAR = 1e-5
_IN_SIGHT = 1e-4
# Trees of up to so many faces are kept as long as their meshes; they take some 200 bytes per face.
_MOST_KEPT = 1_000_000
# Least distance of a level set from a corner of its grid, in cells.
_LEAST_OFF = 1e-3

Points = Float64[np.ndarray, "N 3"]
Distances = Float64[np.ndarray, " N"]


@dataclass(frozen=True, eq=False)
class NearestPoints:
    """Nearest points on a surface.

    Attributes:
        distances: (N,) distance of each query.
        points: (N, 3) the nearest points.
        faces: (N,) a face with the nearest point.
    """

    distances: Distances
    points: Points
    faces: Int64[np.ndarray, " N"]


def nearest_on_surface(surface: Mesh, points: Points) -> NearestPoints:
    """Return the nearest point on a surface to each point.

    Args:
        surface: with at least one face and finite coordinates.
        points: (N, 3), at least one, finite.
    """
    order = spatial_order(points)  # queries that are close to each other find the same parts of the tree in the cache
    found = _tree(surface).squared_distance(surface.verts, surface.faces, points[order])
    number = len(points)
    squared, faces, nearest = np.empty(number), np.empty(number, dtype=np.int64), np.empty((number, 3))
    squared[order], faces[order], nearest[order] = found
    return NearestPoints(np.sqrt(squared), nearest, faces)


_trees = WeakKeyDictionary[Mesh, igl.AABB]()
# Meshes in caches may outlive libigl, which reports their trees as leaks when a process ends.
atexit.register(_trees.clear)


def _tree(surface: Mesh) -> igl.AABB:
    """Return the tree over the faces of a surface, which most callers use several times."""
    tree = _trees.get(surface)
    if tree is None:
        tree = igl.AABB()
        tree.init(surface.verts, surface.faces)
        if surface.num_faces <= _MOST_KEPT:
            _trees[surface] = tree
    return tree


def point_distances(surface: Mesh, points: Points) -> Distances:
    """Return (N,) the distance from each point to the nearest point on a surface; arguments as above."""
    return nearest_on_surface(surface, points).distances


def segment_distances(ends: Float64[np.ndarray, "S 2 3"], points: Points) -> Distances:
    """Return (N,) the distance from each point to the nearest of some segments.

    Args:
        ends: (S, 2, 3) the ends of at least one segment.
        points: (N, 3), at least one, finite.
    """
    segments = np.arange(2 * len(ends)).reshape(-1, 2)
    squared = igl.point_mesh_squared_distance(_contiguous(points), _contiguous(ends.reshape(-1, 3)), segments)[0]
    return np.asarray(np.sqrt(np.reshape(squared, -1)))


def is_inside(surface: Mesh, points: Points, distances: Distances) -> Bool[np.ndarray, " N"]:
    """Return (N,) which points a closed surface encloses, whichever way its normals point.

    These are the points with a winding number above 1/2 (Jacobson et al. 2013, Robust inside-outside segmentation,
    sec. 4): unlike the side of the nearest face, it holds on surfaces that cross themselves. It is approximated in
    single precision (Barill et al. 2018, Fast winding numbers) except near the surface.

    Args:
        surface: closed, with at least one face.
        points: (N, 3), at least one, finite.
        distances: (N,) of the points from the surface.
    """
    points = _contiguous(points)
    near = distances <= _NEAR * bounding_box_diagonal(surface.verts)
    winding = np.empty(len(points))
    for chosen, winding_number in ((near, igl.winding_number), (~near, igl.fast_winding_number)):
        if chosen.any():
            winding[chosen] = np.reshape(winding_number(surface.verts, surface.faces, points[chosen]), -1)
    return np.asarray(np.abs(winding) > 0.5)


def winding_numbers(surface: Mesh, points: Points, *, exact: bool = False) -> Float64[np.ndarray, " N"]:
    """Return (N,) the generalised winding number of a surface about each point.

    It is the share of all directions in which the surface shows its back, less that in which it shows its front
    (Jacobson et al. 2013).

    Args:
        surface: with at least one face.
        points: (N, 3), at least one, finite.
        exact: take milliseconds for each point, rather than approximate it in single precision (Barill et al. 2018).
    """
    winding_number = igl.winding_number if exact else igl.fast_winding_number
    values = winding_number(surface.verts, surface.faces, _contiguous(points))
    return np.asarray(values, dtype=np.float64).reshape(-1)


def seen_from(surface: Mesh, points: Points, directions: Float64[np.ndarray, "D 3"]) -> Bool[np.ndarray, "N D"]:
    """Return (N, D) which points of a surface are seen from far away in each direction, with nothing in front of them.

    Args:
        surface: with at least one face.
        points: (N, 3) on it.
        directions: (D, 3) unit vectors.
    """
    from igl import embree

    size = bounding_box_diagonal(surface.verts)
    starts = (points[:, None] + 1.5 * size * directions).reshape(-1, 3)
    towards = np.broadcast_to(-directions, (len(points), *directions.shape)).reshape(-1, 3)
    hits = np.reshape(
        embree.line_mesh_intersection(_contiguous(starts), _contiguous(towards), surface.verts, surface.faces), (-1, 3)
    )
    first, second, third = surface.verts[surface.faces[hits[:, 0].astype(np.int64)]].transpose(1, 0, 2)
    u, v = hits[:, 1:2], hits[:, 2:3]
    away = (1 - u - v) * first + u * second + v * third - np.repeat(points, len(directions), axis=0)
    seen = (hits[:, 0] >= 0) & (np.linalg.norm(away, axis=1) < _IN_SIGHT * size)
    return np.asarray(seen.reshape(len(points), len(directions)))


def cut_where_crossing(mesh: Mesh) -> Mesh:
    """Return the same surface with its faces cut where they cross each other, by exact constructions of CGAL.

    New vertices are shared by all faces that meet there. The time grows with the number of crossings, about 2 ms each.
    """
    from igl.copyleft import cgal

    cut = cgal.remesh_self_intersections(mesh.verts, mesh.faces, stitch_all=True)
    return Mesh(cut[0], cut[1])


def zero_surface(values: Float64[np.ndarray, "X Y Z"], axes: Sequence[Float64[np.ndarray, " _"]]) -> Mesh:
    """Return the surface between positive and other values on a grid, by marching cubes; positive values are inside.

    It is closed where no value at the border of the grid is positive. Values that are almost 0 are moved away from it,
    so that no face shrinks to a point.

    Args:
        values: (X, Y, Z), at least 2 along each axis.
        axes: coordinates of the grid along each axis, increasing.
    """
    least = _LEAST_OFF * min(float(np.diff(axis).min()) for axis in axes)
    values = np.where(np.abs(values) < least, np.where(values > 0, least, -least), values)
    # libigl counts along x first.
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).transpose(2, 1, 0, 3).reshape(-1, 3)
    verts, faces, _ = igl.marching_cubes(values.transpose(2, 1, 0).ravel(), _contiguous(grid), *values.shape, 0.0)
    mesh = Mesh(verts, faces.astype(np.int64))  # of another type of the same size
    return Mesh(verts, mesh.faces[:, ::-1]) if signed_volume(mesh) < 0 else mesh


def _contiguous(points: Float64[np.ndarray, "N 3"]) -> Points:
    return np.ascontiguousarray(points)
