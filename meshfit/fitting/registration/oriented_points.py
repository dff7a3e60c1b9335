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
        remoteness: (N,) mean distance from the rest of the surface along it, relative to the mean of all; or zeros.
    """

    points: Points
    normals: Points
    areas: Float64[np.ndarray, " N"]
    rim: Bool[np.ndarray, " N"]
    remoteness: Float64[np.ndarray, " N"]
    _trees: dict[tuple[float, float], KDTree] = field(default_factory=dict, repr=False)
    _thinned: dict[int, "OrientedPoints"] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def lifted(self, offset: float) -> "OrientedPoints":
        """Return the points moved along their normals."""
        parts = self.normals, self.areas, self.rim, self.remoteness
        return OrientedPoints(self.points + offset * self.normals, *parts)

    def subset(self, rows: Indices) -> "OrientedPoints":
        """Return some of the points."""
        parts = self.points, self.normals, self.areas, self.rim, self.remoteness
        return OrientedPoints(*(part[rows] for part in parts))

    def thinned(self, most: int) -> "OrientedPoints":
        """Return at most so many of the points, always the same ones."""
        if most >= len(self):
            return self
        if most not in self._thinned:
            self._thinned[most] = self.subset(some_of(len(self), most))
        return self._thinned[most]

    def nearest(
        self, queries: "OrientedPoints", normal_length: float, remoteness_length: float = 0.0
    ) -> tuple[Float64[np.ndarray, " M"], Indices]:
        """Return the distance and the index of the nearest point in position, normal and remoteness, for each query.

        Args:
            queries: M points.
            normal_length: distance that two opposite normals are worth, halved.
            remoteness_length: distance that a remoteness of 1 is worth.
        """
        lengths = normal_length, remoteness_length
        if lengths not in self._trees:
            self._trees.clear()  # lengths change from step to step
            self._trees[lengths] = KDTree(self.coordinates(*lengths), leafsize=16)
        distances, rows = self._trees[lengths].query(queries.coordinates(*lengths))
        return np.asarray(distances), np.minimum(rows.astype(np.int64), len(self) - 1)

    def coordinates(self, normal_length: float, remoteness_length: float) -> Float64[np.ndarray, "N D"]:
        """Return positions, normals and remoteness as coordinates of one space, as `nearest` measures it."""
        parts = [self.points, normal_length * self.normals]
        if remoteness_length:
            parts.append(remoteness_length * self.remoteness[:, None])
        return np.ascontiguousarray(np.hstack(parts))

    def draw(self, count: int, generator: np.random.Generator) -> Indices:
        """Draw different points at random, the likelier the larger the area that they stand for."""
        if count >= len(self):
            return np.arange(len(self))
        return generator.choice(len(self), count, replace=False, p=self.areas / self.areas.sum())


def some_of(count: int, most: int) -> Indices:
    """Return at most so many of the numbers below a count, in order; the same ones each time, and at random."""
    if most >= count:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))
