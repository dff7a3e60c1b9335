"""Alignment of a source with its target before a fit: by centroids, boxes, principal axes, or ICP."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.pose_search import PoseSearch
from meshfit.fitting.registration.poses import Pose, principal_turns
from meshfit.mesh.geometry import bounding_box, bounding_box_diagonal, face_normals
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.placing_options import Alignment
from meshfit.mesh.point_cloud import PointCloud, plane_normals, sampled_areas
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.sampling import sample_surface

Distances = Float64[np.ndarray, " N"]

_POINTS = 5000
# Points that judge poses, and those that compare them. The way with the larger distances has the weight, as one surface
# may show a part of the other.
_JUDGES, _FEW, _LARGER = 1000, 100, 0.1
# Width beyond which distances count alike: relative to the least median of all poses, within shares of the diagonal.
_WIDTH, _LEAST_WIDTH, _MOST_WIDTH = 3.0, 0.003, 0.05
# Change of scale of another pose that is named.
_SCALED = 0.1
# Poses between which the source moves by a smaller share of its diagonal are alike.
_ALIKE = 0.1
# A pose with a larger turn has to be better by the first factor and share of the diagonal; one that is not worse by the
# second is named.
_BETTER, _CLOSE = (1.1, 2e-4), (1.2, 5e-4)
# Root mean square distance both ways, relative to the diagonal, of a pose that needs no search; distances count up to
# the cap.
_LIES_WELL, _CAP = 0.01, 0.15
# Points of either surface that lie on the other: nearer than so many widths.
_SHARED, _ALL_SHARED = 3.0, 0.97


@dataclass(frozen=True, eq=False)
class Aligned:
    """A source that was aligned with a target.

    Attributes:
        mesh: the source in its place.
        turn: angle in degrees by which it was turned.
        scale: factor by which it was scaled; of `box`, the geometric mean of those of the axes.
        distance: distance by which the pose, after ICP, was chosen among others, relative to the target's diagonal;
            None if there were no others.
        other_turn: angle in degrees between the pose and the best other one; None if there is no other.
        other_scale: factor by which that one scales the source.
        other_distance: the distance of that one.
    """

    mesh: Mesh
    turn: float = 0.0
    scale: float = 1.0
    distance: float | None = None
    other_turn: float | None = None
    other_scale: float | None = None
    other_distance: float | None = None

    @property
    def is_doubtful(self) -> bool:
        """Whether another pose serves about as well."""
        if self.distance is None or self.other_distance is None:
            return False
        return self.other_distance < _CLOSE[0] * self.distance + _CLOSE[1]

    @property
    def line(self) -> str:
        """The turn and the scale, in words."""
        return f"turned by {self.turn:.3g}°, scaled by {self.scale:.4g}"

    @property
    def doubt(self) -> str:
        """The other pose that serves about as well, in words; empty if there is none."""
        if not self.is_doubtful:
            return ""
        assert self.distance is not None  # noqa: S101  of doubtful ones
        assert self.other_scale is not None  # noqa: S101  of doubtful ones
        changed = abs(np.log(self.other_scale / self.scale)) > _SCALED
        scaled = f", and scaled by {self.other_scale:.3g}" if changed else ""
        distances = f"distances {self.other_distance:.2g} and {self.distance:.2g} of the diagonal"
        return f"another pose, turned from this one by {self.other_turn:.0f}°{scaled}, lies about as well ({distances})"

    @property
    def record(self) -> dict[str, float | None]:
        """The values as plain data."""
        values = {"turn_degrees": self.turn, "scale": self.scale, "distance": self.distance}
        other = {"other_turn_degrees": self.other_turn, "other_scale": self.other_scale}
        return values | other | {"other_distance": self.other_distance}


def align(source: Mesh, target: Mesh | PointCloud, how: Alignment) -> Aligned:
    """Align the source with the target.

    `box` moves the bounding box of the source onto that of the target, and stretches it along each axis. `center` makes
    the centroids of the surfaces coincide. `pca` and `icp` look for poses by trimmed ICP from the pose as given, from
    turns of principal axes, and, unless one of these lies well on all of both, from a grid of rotations (`PoseSearch`).
    Poses are judged by distances both ways, mostly by the better one, as one surface may show a part of the other.
    The least turn is taken unless another pose is clearly better. `icp` returns that pose. `pca` makes centroids,
    principal axes and sizes of what the two share in it coincide, or keeps the pose as given if that is nearer.

    Args:
        source: the mesh to move.
        target: the mesh, or the points of a scan, to align it with.
        how: `none`, `center`, `box`, `pca` or `icp`.

    Raises:
        MeshError: a surface without extent.
    """
    if how == "none":
        return Aligned(source)
    if how == "box":
        verts, scale = _into_box(source.verts, target.verts)
        return Aligned(source.with_verts(verts), scale=scale)
    p, q = _sampled(source, "source"), _sampled(target, "target")
    if how == "center":
        return Aligned(source.with_verts(source.verts - p.points.mean(0) + q.points.mean(0)))
    return _Candidates(source, target, p, q).best(refined=how == "icp")


@dataclass(frozen=True, eq=False)
class _Candidates:
    source: Mesh
    target: Mesh | PointCloud
    source_points: OrientedPoints
    target_points: OrientedPoints

    def best(self, *, refined: bool) -> Aligned:
        """Return the source in the best pose."""
        p, q = self.source_points, self.target_points
        search = PoseSearch(p.points, q.points, (p.normals, q.normals))
        poses = [Pose.identity(), *search.from_axes()]
        ways = [self._distances_of(pose) for pose in poses]
        if min(_capped_distance(both) for both in ways) > _LIES_WELL:
            more = search.from_grid()
            poses, ways = [*poses, *more], [*ways, *map(self._distances_of, more)]
        width = _WIDTH * min(float(np.median(way)) for both in ways for way in both)
        width = float(np.clip(width, _LEAST_WIDTH, _MOST_WIDTH))
        judged = [replace(pose, score=_robust_distance(both, width)) for pose, both in zip(poses, ways, strict=True)]
        least = min(pose.score for pose in judged)
        good = [pose for pose in judged if pose.score <= _BETTER[0] * least + _BETTER[1]]
        turned_least = min(good, key=lambda pose: (pose.angle_to(judged[0]), pose.score))
        best = min((pose for pose in judged if self._are_alike(pose, turned_least)), key=lambda pose: pose.score)
        others = [pose for pose in judged if not self._are_alike(pose, best)]
        other = min(others, key=lambda pose: pose.score, default=None)
        pose = best if refined else self._by_axes(best, width)
        return Aligned(
            self.source.with_verts(pose.applied(self.source.verts)),
            float(np.degrees(pose.angle_to(judged[0]))),
            pose.scale,
            best.score,
            None if other is None else float(np.degrees(other.angle_to(best))),
            None if other is None else other.scale,
            None if other is None else other.score,
        )

    def _by_axes(self, settled: Pose, width: float) -> Pose:
        """Return whichever is nearest to a settled pose: the pose as given, or one by centroids, axes and sizes.

        They are those of the parts that the two share in the settled pose; of all, where they share nearly all.
        """
        p, q = self.source_points.points, self.target_points.points
        limit = _SHARED * width * bounding_box_diagonal(self.target.verts)
        shared = [way < limit for way in self._ways(settled, p, q)]
        if min(each.mean() for each in shared) >= _ALL_SHARED or min(each.sum() for each in shared) < _JUDGES // 10:
            shared = [np.ones(len(points), dtype=bool) for points in (p, q)]
        starts = _starts(p[shared[0]], q[shared[1]], settled)
        return min([Pose.identity(), *starts], key=lambda pose: self._apart(pose, settled))

    def _are_alike(self, pose: Pose, other: Pose) -> bool:
        smaller = min(pose.scale, other.scale) * bounding_box_diagonal(self.source.verts)
        return self._apart(pose, other) <= _ALIKE * smaller

    def _apart(self, pose: Pose, other: Pose) -> float:
        """Return the root mean square distance that points of the source have in two poses."""
        points = self.source_points.thinned(_FEW).points
        return float(np.sqrt(((pose.applied(points) - other.applied(points)) ** 2).sum(axis=1).mean()))

    def _distances_of(self, pose: Pose) -> tuple[Distances, Distances]:
        """Return distances of some points of either surface from the other, relative to the target's diagonal."""
        p, q = (side.thinned(_JUDGES).points for side in (self.source_points, self.target_points))
        diagonal = bounding_box_diagonal(self.target.verts)
        forth, back = self._ways(pose, p, q)
        return forth / diagonal, back / diagonal

    def _ways(self, pose: Pose, p: Verts, q: Verts) -> tuple[Distances, Distances]:
        back = (q - pose.translation) @ pose.rotation / pose.scale
        return _distances(self.target, pose.applied(p)), _distances(self.source, back) * pose.scale


def _capped_distance(ways: tuple[Distances, Distances]) -> float:
    """Return the root mean square distance of the farther way."""
    return max(float(np.sqrt((np.minimum(way, _CAP) ** 2).mean())) for way in ways)


def _robust_distance(ways: tuple[Distances, Distances], width: float) -> float:
    """Return the root mean square distance of the nearer way, and a little of the other.

    Of distances far beyond the width, each counts as the width (Geman & McClure 1987).
    """
    nearer, farther = sorted(float((width**2 * way**2 / (width**2 + way**2)).mean()) for way in ways)
    return float(np.sqrt(nearer + _LARGER * farther))


def _starts(source: Verts, target: Float64[np.ndarray, "N 3"], near: Pose) -> list[Pose]:
    """Return poses with coinciding centroids: by turns of principal axes and by a turn as given, with both sizes.

    Sizes are made equal, or kept where those of the pose nearby are.
    """
    centre, goal = source.mean(axis=0), target.mean(axis=0)
    scale = float(np.sqrt((target - goal).var(0).sum() / (source - centre).var(0).sum()))
    rotations = [np.eye(3), *principal_turns(source, target)]
    scales = [1.0, scale] if near.scale == 1 else [scale]
    return [Pose(turn, goal - scale * turn @ centre, scale) for turn in rotations for scale in scales]


def _distances(surface: Mesh | PointCloud, points: Float64[np.ndarray, "N 3"]) -> Distances:
    if isinstance(surface, PointCloud):
        return _point_distances(surface.verts, points)
    return np.asarray(point_distances(surface, points))


def _point_distances(points: Verts, queries: Float64[np.ndarray, "N 3"]) -> Distances:
    return np.asarray(np.linalg.norm(queries - points[nearest_point_query(points)(queries)], axis=1))


def _into_box(verts: Verts, goal: Float64[np.ndarray, "N 3"]) -> tuple[Verts, float]:
    (low, high), (goal_low, goal_high) = bounding_box(verts), bounding_box(goal)
    if not (high - low).max() > 0:
        raise MeshError("source: a surface without extent cannot be aligned")
    sides = np.where(high > low, high - low, 1.0)  # a flat source stays flat
    factors = ((goal_high - goal_low) / sides)[high > low]
    moved = np.asarray((verts - (low + high) / 2) / sides * (goal_high - goal_low) + (goal_low + goal_high) / 2)
    return moved, float(np.prod(factors) ** (1 / len(factors)))


def _sampled(mesh: Mesh | PointCloud, role: str) -> OrientedPoints:
    """Sample points with normals; those of a cloud are estimated, on either side."""
    if not np.ptp(mesh.verts, axis=0).max() > 0:
        raise MeshError(f"{role}: a surface without extent cannot be aligned")
    if isinstance(mesh, PointCloud):
        areas = sampled_areas(mesh.verts).cumsum()
        at = (np.arange(_POINTS) + 0.5) * (areas[-1] / _POINTS)
        rows, repeated = np.unique(np.searchsorted(areas, at).clip(max=mesh.num_verts - 1), return_inverse=True)
        points, normals = mesh.verts[rows][repeated], plane_normals(mesh.verts[rows])[repeated]
    else:
        samples = sample_surface(mesh, _POINTS, np.random.default_rng(0))
        points, normals = samples.points, face_normals(mesh)[samples.faces]
    ones = np.ones(len(points))
    return OrientedPoints(np.asarray(points), normals, ones, np.zeros(len(points), dtype=bool), 0 * ones)
