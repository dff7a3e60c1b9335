"""Bridges: parts of a result that are off its target, such as the web between two legs, or a tube from tail to leg."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.noise import noise_of_mesh, noise_of_points
from meshfit.mesh.point_cloud import PointCloud, is_beyond_rim, local_areas
from meshfit.mesh.proximity import nearest_on_surface, point_distances, segment_distances
from meshfit.mesh.topology import Topology

LEAST_SHARE = 0.01
"""Share of the target's diagonal below which no part counts as off the target."""
# Nor do those within so many mean edge lengths of the result, standard deviations of the target's noise, or spacings of
# its points there.
_EDGES, _DEVIATIONS, _SPACINGS = 0.8, 6.0, 2.0
# Nearest points within this share of the diagonal of a boundary are on it.
_AT_BOUNDARY = 1e-6

Points = Float64[np.ndarray, "N 3"]
Distances = Float64[np.ndarray, " R"]
Rows = Int64[np.ndarray, " R"]


@dataclass(frozen=True)
class Bridge:
    """The place of a result that is farthest off its target.

    Attributes:
        distance: from the target.
        share: of the target's diagonal.
        edges: mean edge lengths of the result.
    """

    distance: float
    share: float
    edges: float


def farthest_bridge(
    result: Mesh, target: Mesh | PointCloud, least_share: float = LEAST_SHARE, filled: Mesh | None = None
) -> Bridge | None:
    """Return the place that is farthest off the target, if no sound fit with such edges would be as far.

    Triangles inscribed in a smooth surface lie within a tenth of an edge of it, and within 0.3 edges at sharp edges
    that run across them; measured fits had up to 0.1 edges on animals. Webs and tubes, which faces span with nothing
    of the target beneath, had 0.9 to 7. Below 1 % of the diagonal nobody sees them, and fits with many vertices end
    there by other errors as well. Noise reaches 4 standard deviations at 10,000 vertices. Where the target ends, at a
    boundary or the rim of a cloud, a result may go on.

    Args:
        result: a surface.
        target: what it was fitted to.
        least_share: of the target's diagonal, below which nothing counts.
        filled: the target with its holes filled, if the result may fill them.
    """
    if not result.num_faces or not target.num_verts:
        return None
    points = np.concatenate([result.verts[np.unique(result.faces)], result.verts[result.faces].mean(axis=1)])
    edges = Topology.of(result).edges
    edge = float(np.linalg.norm(result.verts[edges[:, 0]] - result.verts[edges[:, 1]], axis=1).mean())
    diagonal = bounding_box_diagonal(target.verts)
    least = max(_EDGES * edge, least_share * diagonal)
    if isinstance(target, PointCloud):
        distances = _off_points(target, points, least)
    else:
        rows, distances = _off(target, points, least)
        if filled is not None and len(rows):
            distances = distances[~is_filling(points[rows], target, filled, least)]
    farthest = float(distances.max(initial=0.0))
    return Bridge(farthest, farthest / diagonal, farthest / edge) if farthest > 0 else None


def _off(target: Mesh, points: Points, least: float) -> tuple[Rows, Distances]:
    """Return the indices and distances of the points that are off a mesh."""
    found = nearest_on_surface(target, points)
    least = max(least, _DEVIATIONS * noise_of_mesh(target)) if (found.distances > least).any() else least
    rows = np.flatnonzero(found.distances > least)
    topology = Topology.of(target)
    ends = target.verts[topology.edges[topology.faces_per_edge == 1]]
    if len(rows) and len(ends):
        at_boundary = segment_distances(ends, found.points[rows]) <= _AT_BOUNDARY * bounding_box_diagonal(target.verts)
        rows = rows[~at_boundary]
    return rows, found.distances[rows]


def _off_points(cloud: PointCloud, points: Points, least: float) -> Distances:
    """Return the distances of the points that are off a cloud."""
    nearest = nearest_point_query(cloud.verts)(points)
    distances = np.linalg.norm(points - cloud.verts[nearest], axis=1)
    rows = np.flatnonzero(distances > least)
    if len(rows):
        spacings = np.sqrt(local_areas(cloud.verts))
        limits = np.maximum(_DEVIATIONS * noise_of_points(cloud.verts), _SPACINGS * spacings)
        rows = rows[distances[rows] > limits[nearest[rows]]]
    if len(rows):
        rows = rows[~is_beyond_rim(cloud.verts, nearest[rows], points[rows])]
    return np.asarray(distances[rows])


def is_filling(points: Points, target: Mesh, filled: Mesh, near: float) -> Bool[np.ndarray, " N"]:
    """Return (N,) which points fill holes: near to a surface that does, or nearest to a part of it that is off.

    Args:
        points: (N, 3), off the target.
        target: with holes.
        filled: the target with its holes filled, however it is done.
        near: distance within which a point is near.
    """
    found = nearest_on_surface(filled, points)
    return np.asarray((found.distances <= near) | (point_distances(target, found.points) > near / 2))
