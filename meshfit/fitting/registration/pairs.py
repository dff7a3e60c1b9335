"""Pairs of points that registration brings together, with robust weights and symmetric normals."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.settings import Direction
from meshfit.mesh.geometry import unit_vectors

# The weight of a pair falls to 0 with the cosine between its normals, from 1 to this.
_LEAST_COSINE = 0.3
# Weights below which a pair is left out.
_NEGLIGIBLE = 1e-9


@dataclass(frozen=True, eq=False)
class Pairs:
    """Vertices, and where they should go.

    Attributes:
        verts: (M,) vertices of the template.
        goals: (M, 3) points of the target.
        normals: (M, 3) unit vectors halfway between the two normals (Rusinkiewicz 2019).
        weights: (M,) with a sum of at most 1 in each direction.
        matched: share of the pairs whose weight is not negligible.
        distance: root of their weighted mean squared distance.
    """

    verts: Int64[np.ndarray, " M"]
    goals: Float64[np.ndarray, "M 3"]
    normals: Float64[np.ndarray, "M 3"]
    weights: Float64[np.ndarray, " M"]
    matched: float
    distance: float

    def weighted(self, confidence: Float64[np.ndarray, " V"] | None) -> "Pairs":
        """Return the pairs with their weights times the confidence in the data at their vertices."""
        if confidence is None:
            return self
        return replace(self, weights=self.weights * confidence[self.verts])


@dataclass(frozen=True)
class Matching:
    """Settings by which pairs are found and weighed.

    Attributes:
        width: distance at which a pair has a quarter of the weight of one at 0 (Geman and McClure).
        normal_length: distance that two opposite normals are worth, halved.
        direction: pairs to find.
        remoteness_length: distance that a difference of 1 in remoteness is worth.
    """

    width: float
    normal_length: float
    direction: Direction = "both"
    remoteness_length: float = 0.0


def find_pairs(
    template: OrientedPoints,
    target: OrientedPoints,
    verts: Int64[np.ndarray, " A"],
    points: Int64[np.ndarray, " B"],
    matching: Matching,
) -> Pairs:
    """Pair vertices with the nearest points of the target in position and normal, and points with the nearest vertices.

    Pairs that end on a rim are left out: beyond it, nothing is known.

    Args:
        template: all vertices at their present positions.
        target: all points of the target.
        verts: vertices to pair.
        points: points of the target to pair.
        matching: widths and direction.
    """
    lengths = matching.normal_length, matching.remoteness_length
    found = list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    if matching.direction != "to-source":
        _, hit = target.nearest(template.subset(verts), *lengths)
        found.append((verts, hit, ~target.rim[hit] / max(len(verts), 1)))
    if matching.direction != "to-target":
        _, hit = template.nearest(target.subset(points), *lengths)
        found.append((hit, points, ~template.rim[hit] / max(len(points), 1)))
    vert, goal, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    normals, goal_normals = template.normals[vert], target.normals[goal]
    cosines = (normals * goal_normals).sum(axis=1)
    distances = np.linalg.norm(template.points[vert] - target.points[goal], axis=1)
    facing = np.clip((cosines - _LEAST_COSINE) / (1 - _LEAST_COSINE), 0, 1)
    weights = weights * facing * geman_mcclure(distances, matching.width)
    kept = weights > _NEGLIGIBLE
    halfway = unit_vectors(normals + goal_normals)
    weights = weights[kept]
    distance = float(np.sqrt(weights @ distances[kept] ** 2 / max(float(weights.sum()), 1e-300)))
    return Pairs(vert[kept], target.points[goal[kept]], halfway[kept], weights, float(kept.mean()), distance)


def geman_mcclure(
    distances: Float64[np.ndarray, " M"], width: float | Float64[np.ndarray, " M"]
) -> Float64[np.ndarray, " M"]:
    """Return the weights (1 + r² / width²)⁻² of the robust estimator of Geman and McClure."""
    return np.asarray(1 / (1 + (distances / width) ** 2) ** 2)


def metric_roots(
    normals: Float64[np.ndarray, "M 3"], weights: Float64[np.ndarray, " M"], point_weight: float
) -> Float64[np.ndarray, "M 3 3"]:
    """Return symmetric L with Lᵀ L = w (n nᵀ + μ I)."""
    along = np.sqrt(weights * point_weight)[:, None, None] * np.eye(3)
    across = np.sqrt(weights) * (np.sqrt(1 + point_weight) - np.sqrt(point_weight))
    return np.asarray(along + across[:, None, None] * (normals[:, :, None] * normals[:, None, :]))
