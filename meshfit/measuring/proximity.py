"""Distances from points to a surface: by MeshLab near it, and by libigl far from it. The one module that imports igl.

MeshLab searches for the nearest face in the cells of a uniform grid, ring by ring. That takes microseconds for a point
near the surface but milliseconds for one a diagonal away, and minutes in all for a result that missed its target.
libigl's tree costs the same everywhere and gives the same distances.
"""

import math

import igl
import numpy as np
from jaxtyping import Float64

from meshfit.measuring.surface import split_obtuse_faces
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import DistanceStatistics, point_to_surface
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.sampling import sample_surface

_FAR = 0.02  # of the diagonal of the bounding box
_PROBES = 20_000

Points = Float64[np.ndarray, "N 3"]


def distance_statistics(surface: Mesh, points: Points) -> DistanceStatistics:
    """Return statistics of the distances from points to a surface.

    Args:
        surface: with an area and finite coordinates.
        points: (N, 3), at least one.

    Raises:
        MeasureError: a point is not finite, or MeshLab left out some of the points.
    """
    far = _upper_bounds(surface, points) > _FAR * bounding_box_diagonal(surface.verts)
    parts = []
    if not far.all():
        parts.append(point_to_surface(points[~far], split_obtuse_faces(surface)))
    if far.any():
        parts.append(_by_tree(surface, points[far]))
    return _combined(parts)


def point_distances(surface: Mesh, points: Points) -> Float64[np.ndarray, " N"]:
    """Return (N,) the distance from each point to the nearest point on a surface.

    Args:
        surface: with at least one face and finite coordinates.
        points: (N, 3), at least one, finite.
    """
    squared = igl.point_mesh_squared_distance(np.ascontiguousarray(points), surface.verts, surface.faces)[0]
    return np.asarray(np.sqrt(np.reshape(squared, -1)))


def _upper_bounds(surface: Mesh, points: Points) -> Float64[np.ndarray, " N"]:
    """Return upper bounds of the distances: those to the nearest of some random points of the surface."""
    probes = sample_surface(surface, _PROBES, np.random.default_rng(0)).points
    return np.asarray(np.linalg.norm(points - probes[nearest_point_query(probes)(points)], axis=1))


def _by_tree(surface: Mesh, points: Points) -> DistanceStatistics:
    distance = point_distances(surface, points)
    rms = math.sqrt(float((distance**2).mean()))
    return DistanceStatistics(float(distance.max()), float(distance.mean()), rms, len(points))


def _combined(parts: list[DistanceStatistics]) -> DistanceStatistics:
    count = sum(part.count for part in parts)
    mean = sum(part.mean * part.count for part in parts) / count
    square = sum(part.rms**2 * part.count for part in parts) / count
    return DistanceStatistics(max(part.largest for part in parts), mean, math.sqrt(square), count)
