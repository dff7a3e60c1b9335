"""Distances from points to a surface: by MeshLab near it, and by libigl far from it. The one module that imports igl.

MeshLab looks for the nearest face in the cells of a uniform grid, ring by ring: microseconds for a point near the
surface, milliseconds for one that is a diagonal away, which for a result that missed its target adds up to minutes.
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

_FAR = 0.02
_PROBES = 20_000

Points = Float64[np.ndarray, "N 3"]


def distance_statistics(surface: Mesh, points: Points) -> DistanceStatistics:
    """Distances from each point to its nearest point on a surface.

    Args:
        surface: with an area, and coordinates that are finite.
        points: (N, 3), at least one.

    Raises:
        MeasureError: a point is not finite, or MeshLab left out some of the points.
    """
    far = _probe(surface, points) > _FAR * bounding_box_diagonal(surface.verts)
    parts = []
    if not far.all():
        parts.append(point_to_surface(points[~far], split_obtuse_faces(surface)))
    if far.any():
        parts.append(_by_tree(surface, points[far]))
    return _together(parts)


def point_distances(surface: Mesh, points: Points) -> Float64[np.ndarray, " N"]:
    """(N,) the distance from each point to its nearest point on a surface.

    Args:
        surface: with at least one face, and coordinates that are finite.
        points: (N, 3), at least one, likewise finite.
    """
    squared = igl.point_mesh_squared_distance(np.ascontiguousarray(points), surface.verts, surface.faces)[0]
    return np.asarray(np.sqrt(np.reshape(squared, -1)))


def _probe(surface: Mesh, points: Points) -> Float64[np.ndarray, " N"]:
    """Roughly how far the points are: the distance to the nearest of some points of the surface, never too small."""
    probes = sample_surface(surface, _PROBES, np.random.default_rng(0)).points
    return np.asarray(np.linalg.norm(points - probes[nearest_point_query(probes)(points)], axis=1))


def _by_tree(surface: Mesh, points: Points) -> DistanceStatistics:
    distance = point_distances(surface, points)
    rms = math.sqrt(float((distance**2).mean()))
    return DistanceStatistics(float(distance.max()), float(distance.mean()), rms, len(points))


def _together(parts: list[DistanceStatistics]) -> DistanceStatistics:
    count = sum(part.count for part in parts)
    mean = sum(part.mean * part.count for part in parts) / count
    square = sum(part.rms**2 * part.count for part in parts) / count
    return DistanceStatistics(max(part.largest for part in parts), mean, math.sqrt(square), count)
