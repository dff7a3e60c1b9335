"""Closeness of a surface to the target: whether a fit may skip the search for the rough shape, and how it ended."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float64
from torch import Generator

from meshfit.fitting.gauss_newton.correspondences import find_correspondences
from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.mesh.geometry import bounding_box_diagonal, face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.proximity import is_inside, point_distances
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import Topology
from meshfit.remeshing.triangle_geometry import length_of

# A surface is near if its mean distance from the target is below this share of its mean edge length, and of the
# target's diagonal; if this share of its points is matched; and if nearly all points are within so many edge lengths.
# Decimated targets measured 0.03 to 0.56 edge lengths, spheres 5.8 to 9.9.
_NEAR_EDGES, _NEAR_DIAGONAL = 0.5, 0.02
_NEAR_MATCHED = 0.9
_NEARLY_ALL, _FAR_EDGES = 0.98, 2.0
# Or if this share is matched, and no point is farther than this share of the diagonal.
_LEAST_MATCHED = 0.4
# Samples of each surface that distances are measured from; about as many vertices are added.
_SAMPLES = 20_000
# Samples of the target that are tested for whether they are hidden, and their distance from it in diagonals.
_HIDDEN_SAMPLES, _OFF = 5000, 0.002
# A surface has lost its shape if its root mean square distance, or its largest one, is so many times as large, and the
# largest one more than this share of the diagonal.
_LOST, _LOST_MAX, _LOST_DIAGONAL = 1.2, 2.0, 0.02
# A fit ends worse than it began if its root mean square distance is larger, and more than this share of the diagonal;
# or if its largest one is so many times as large, and more than that share, or where the other is less than half, than
# that of a lost shape: a corner of a rim that is cut off does not outweigh a surface that is much nearer.
_WORSE_RMS, _FAR_RMS = 1.02, 1e-4
_WORSE_MAX, _FAR_DIAGONAL, _MUCH_NEARER = 1.5, 0.005, 0.5
# Its largest distance has grown if it is so many times as large, and more than this share of the diagonal. That is the
# price of a better surface only where the root mean square distance fell below this share.
_GROWN, _GROWN_DIAGONAL, _MUCH_BETTER = 1.1, 0.01, 0.7


@dataclass(frozen=True)
class Closeness:
    """Distances between a surface and the target, in both directions.

    Attributes:
        rms: root mean square distance.
        worst: largest distance.
        diagonal: of the target's bounding box.
    """

    rms: float
    worst: float
    diagonal: float

    @classmethod
    def of(cls, surface: Mesh, target: Mesh) -> "Closeness":
        """Measure a surface, exactly at the same points every time; corners, which are lost first, are among them."""
        ways = [_distances(*pair) for pair in ((surface, target), (target, surface))]
        square = sum(float(np.square(way[:_SAMPLES]).mean()) for way in ways) / len(ways)
        return cls(math.sqrt(square), max(float(way.max()) for way in ways), bounding_box_diagonal(target.verts))

    def is_worse_than(self, other: "Closeness") -> bool:
        """Return whether a fit that ends so has lost what it began with."""
        far = _LOST_DIAGONAL if self.rms < _MUCH_NEARER * other.rms else _FAR_DIAGONAL
        farther = self.worst > max(_WORSE_MAX * other.worst, far * self.diagonal)
        no_gain = self.has_grown(other) and self.rms > _MUCH_BETTER * other.rms
        return self.rms > max(_WORSE_RMS * other.rms, _FAR_RMS * self.diagonal) or farther or no_gain

    def has_grown(self, other: "Closeness") -> bool:
        """Return whether the largest distance is larger than that of the beginning."""
        return self.worst > max(_GROWN * other.worst, _GROWN_DIAGONAL * self.diagonal)

    def has_lost(self, other: "Closeness") -> bool:
        """Return whether a fit that ends so has lost the shape that it began with."""
        lost = self.rms > _LOST * other.rms or self.worst > _LOST_MAX * other.worst
        return lost and self.worst > _LOST_DIAGONAL * self.diagonal

    def growth_text(self, other: "Closeness") -> str:
        """Return in words how much the largest distance has grown."""
        before, after = (100 * each.worst / each.diagonal for each in (other, self))
        return f"the largest distance grew from {before:.2g} % to {after:.2g} % of the diagonal"


@lru_cache(maxsize=8)
def hidden_share(target: Mesh | PointCloud) -> float:
    """Return the share of a closed target's area that lies inside other parts of it; 0 for any other target."""
    if isinstance(target, PointCloud) or not Topology.of(target).is_watertight:
        return 0.0
    samples = sample_surface(target, _HIDDEN_SAMPLES, np.random.default_rng(0))
    off = _OFF * bounding_box_diagonal(target.verts)
    points = samples.points + off * face_normals(target)[samples.faces]
    # The exact winding number is not needed so far from where it changes.
    return float(is_inside(target, points, np.full(len(points), np.inf)).mean())


def _distances(origin: Mesh, surface: Mesh) -> Float64[np.ndarray, " N"]:
    """Return the distances of samples of a mesh, then of its vertices, from a surface."""
    verts = origin.verts[:: max(1, origin.num_verts // _SAMPLES)]
    points = sample_surface(origin, _SAMPLES, np.random.default_rng(0)).points
    return point_distances(surface, np.concatenate([points, verts]))


def is_near(shape: Shape, target: TargetCloud, goal: Mesh | PointCloud) -> tuple[bool, float]:
    """Return whether a surface is so near to the target that only details are missing, and its distance from it.

    Args:
        shape: the surface.
        target: points of the target.
        goal: the target itself.
    """
    pairs = find_correspondences(shape, target, Generator().manual_seed(0))
    if not len(pairs.residuals):
        return False, pairs.distance
    lengths = pairs.residuals.square().sum(1).sqrt()
    mean = float((pairs.weights * lengths).sum() / pairs.weights.sum())
    nearly_all = float(lengths.kthvalue(math.ceil(_NEARLY_ALL * len(lengths))).values)
    edge = float(shape.edge_lengths.mean())
    diagonal = float((target.points.amax(0) - target.points.amin(0)).square().sum().sqrt())
    small = mean < min(_NEAR_EDGES * edge, _NEAR_DIAGONAL * diagonal) and nearly_all < _FAR_EDGES * edge
    if small and pairs.matched > _NEAR_MATCHED:
        return True, pairs.distance
    if pairs.matched < _LEAST_MATCHED or not math.isfinite(diagonal):
        return False, pairs.distance
    # Between the two sides of a thin plate, the nearest point is often on the other side, and its faces may be needles.
    away = length_of(shape.verts - target.points[target.nearest(shape.verts)])
    if isinstance(goal, PointCloud) or float(away.quantile(_NEARLY_ALL)) > _NEAR_DIAGONAL * diagonal:
        return False, pairs.distance
    return Closeness.of(shape.connectivity.mesh(shape.verts), goal).worst < _NEAR_DIAGONAL * diagonal, pairs.distance
