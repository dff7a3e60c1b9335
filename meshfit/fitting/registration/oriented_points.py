"""Points with unit normals, and nearest neighbours among them by position and normal together."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64, Int64
from pykdtree.kdtree import KDTree

Points = Float64[np.ndarray, "N 3"]
Indices = Int64[np.ndarray, " M"]


@dataclass(frozen=True, eq=False)
class OrientedPoints:
    """Points of a surface.

    Attributes:
        points: (N, 3).
        normals: (N, 3) unit normals.
        areas: (N,) area of the surface that each stands for.
        rim: (N,) which are on a boundary of the surface.
    """

    points: Points
    normals: Points
    areas: Float64[np.ndarray, " N"]
    rim: Bool[np.ndarray, " N"]
    _trees: dict[float, KDTree] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def subset(self, rows: Indices) -> "OrientedPoints":
        """Return some of the points."""
        return OrientedPoints(self.points[rows], self.normals[rows], self.areas[rows], self.rim[rows])

    def nearest(self, points: Points, normals: Points, length: float) -> tuple[Float64[np.ndarray, " M"], Indices]:
        """Return the distance and the index of the nearest point in (position, length × normal), for each query.

        Args:
            points: (M, 3) positions.
            normals: (M, 3) unit normals.
            length: distance that two opposite normals are worth, halved.
        """
        if length not in self._trees:
            self._trees[length] = KDTree(_joined(self.points, self.normals, length), leafsize=16)
        distances, rows = self._trees[length].query(_joined(points, normals, length))
        return np.asarray(distances), np.minimum(rows.astype(np.int64), len(self) - 1)

    def draw(self, count: int, generator: np.random.Generator) -> Indices:
        """Draw different points at random, the likelier the larger the area that they stand for."""
        if count >= len(self):
            return np.arange(len(self))
        return generator.choice(len(self), count, replace=False, p=self.areas / self.areas.sum())


def _joined(points: Points, normals: Points, length: float) -> Float64[np.ndarray, "N 6"]:
    return np.ascontiguousarray(np.hstack([points, length * normals]))
