"""Alignment of a source with its target before a fit: by centroids, boxes, principal axes, or ICP."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.poses import Pose, PoseSearch, principal_turns
from meshfit.mesh.geometry import bounding_box, bounding_box_diagonal, face_normals
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.placing_options import Alignment
from meshfit.mesh.point_cloud import PointCloud, sampled_areas
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.sampling import sample_surface

_POINTS = 5000
# Points and rounds of ICP: of every start, of those that go on, and of the pose that is chosen.
_FEW, _FEW_ROUNDS, _GO_ON = 300, 6, 6
_SOME, _SOME_ROUNDS = 600, 20
_MANY, _MANY_ROUNDS = 3000, 12
_JUDGES = 1000
# Distances count up to this share of the target's diagonal. The larger of the two mean distances has this weight, as
# one side may show a part of the other.
_CAP, _LARGER = 0.15, 0.15
# Rotations that differ by less than the first angle are one pose; of those closer than the second, one goes on.
_DISTINCT, _ALIKE = 0.6, 0.2
# A pose with a larger turn has to be better by this factor, and by this share of the diagonal.
_CLEARLY, _LEAST = 1.5, 0.002


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
        other_distance: the distance of that one.
    """

    mesh: Mesh
    turn: float = 0.0
    scale: float = 1.0
    distance: float | None = None
    other_turn: float | None = None
    other_distance: float | None = None

    @property
    def is_doubtful(self) -> bool:
        """Whether another pose serves about as well."""
        if self.distance is None or self.other_distance is None:
            return False
        return not _is_clearly_better(self.distance, self.other_distance)

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
        distances = f"distances {self.other_distance:.2g} and {self.distance:.2g} of the diagonal"
        return f"another pose, turned from this one by {self.other_turn:.0f}°, lies about as well ({distances})"

    @property
    def record(self) -> dict[str, float | None]:
        """The values as plain data."""
        values = {"turn_degrees": self.turn, "scale": self.scale, "distance": self.distance}
        return values | {"other_turn_degrees": self.other_turn, "other_distance": self.other_distance}


def align(source: Mesh, target: Mesh | PointCloud, how: Alignment) -> Aligned:
    """Align the source with the target.

    `box` moves the bounding box of the source onto that of the target, and stretches it along each axis. `center` makes
    the centroids of the surfaces coincide. `pca` and `icp` choose among poses: the pose as given, that with centroids
    and root mean square sizes made equal, and the 24 turns of principal axes onto principal axes. Each is refined by
    trimmed ICP (Chetverikov et al., The trimmed iterative closest point algorithm, 2002), with and without scale, and
    judged by distances both ways. The least turn is taken unless another pose is clearly better. `icp` returns
    the refined pose; `pca` the start that led to it.

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
class _Candidate:
    """A start, and the pose that ICP takes it to, with its distance as score."""

    start: Pose
    pose: Pose


@dataclass(frozen=True, eq=False)
class _Candidates:
    source: Mesh
    target: Mesh | PointCloud
    source_points: OrientedPoints
    target_points: OrientedPoints

    def best(self, *, refined: bool) -> Aligned:
        """Return the source in the best pose."""
        candidates = sorted(self._candidates(), key=lambda candidate: candidate.pose.score)
        given, least = Pose.identity(), candidates[0].pose.score
        good = [each for each in candidates if not _is_clearly_better(least, each.pose.score)]
        turned_least = min(good, key=lambda each: each.pose.angle_to(given)).pose
        alike = [each for each in candidates if each.pose.angle_to(turned_least) < _DISTINCT]
        others = [each.pose for each in candidates if each.pose.angle_to(turned_least) >= _DISTINCT]
        # A scale that ICP has not changed, unless another is clearly better: a partial target draws a source smaller.
        rigid = [each for each in alike if each.pose.scale == each.start.scale]
        best = alike[0]
        if rigid and not _is_clearly_better(best.pose.score, rigid[0].pose.score):
            best = rigid[0]
        pose = self._polished(best.pose) if refined else self._nearest_start([each.start for each in alike], best.pose)
        return Aligned(
            self.source.with_verts(pose.applied(self.source.verts)),
            float(np.degrees(pose.angle_to(given))),
            pose.scale,
            best.pose.score,
            float(np.degrees(others[0].angle_to(pose))) if others else None,
            others[0].score if others else None,
        )

    def _candidates(self) -> list[_Candidate]:
        generator = np.random.default_rng(0)
        few, some = (self._search(count, generator) for count in (_FEW, _SOME))
        given = Pose.identity()
        starts = [given, *_starts(self.source_points.points, self.target_points.points)]
        tried = [few.settled(start, _FEW_ROUNDS) for start in starts]
        scores = [self._judged(pose, some).score for pose in tried]
        chosen = list[int]()
        for row in np.argsort(scores, kind="stable").tolist():
            if len(chosen) < _GO_ON and all(tried[row].angle_to(tried[other]) > _ALIKE for other in chosen):
                chosen.append(row)
        begun = [(given, given), *((starts[row], tried[row]) for row in dict.fromkeys([1, *chosen]))]
        both = some, replace(some, similarity=False)
        found = [(start, search.settled(pose, _SOME_ROUNDS)) for start, pose in begun for search in both]
        return [_Candidate(start, self._judged(pose)) for start, pose in [*found, (given, given)]]

    def _nearest_start(self, starts: list[Pose], settled: Pose) -> Pose:
        """Return the start that lies best, of those that are hardly turned from a settled pose."""
        near = [start for start in starts if start.angle_to(settled) < _DISTINCT] or starts
        return min((self._judged(start) for start in near), key=lambda pose: pose.score)

    def _polished(self, pose: Pose) -> Pose:
        search = self._search(_MANY, np.random.default_rng(1))
        rigid = replace(search, similarity=False)
        free, kept = (self._judged(each.settled(pose, _MANY_ROUNDS)) for each in (search, rigid))
        better = free if _is_clearly_better(free.score, kept.score) else kept
        return min([pose, better], key=lambda each: each.score)

    def _search(self, count: int, generator: np.random.Generator) -> PoseSearch:
        p, q = (points.subset(points.draw(count, generator)) for points in (self.source_points, self.target_points))
        return PoseSearch(p, q, bounding_box_diagonal(self.target.verts), similarity=True, oriented=False)

    def _judged(self, pose: Pose, search: PoseSearch | None = None) -> Pose:
        """Return a pose with its distance as score: from surfaces, or between the points of a search."""
        sides = (self.source_points, self.target_points) if search is None else (search.source, search.target)
        p, q = (side.thinned(_JUDGES).points for side in sides)
        back = (q - pose.translation) @ pose.rotation / pose.scale
        forth = pose.applied(p)
        if search is None:
            ways = _distances(self.target, forth), _distances(self.source, back) * pose.scale
        else:
            ways = _point_distances(q, forth), _point_distances(p, back) * pose.scale
        diagonal = bounding_box_diagonal(self.target.verts)
        means = sorted(float((np.minimum(way / diagonal, _CAP) ** 2).mean()) for way in ways)
        return replace(pose, score=float(np.sqrt(means[0] + _LARGER**2 * means[1])))


def _is_clearly_better(distance: float, other: float) -> bool:
    return other > _CLEARLY * distance and other > distance + _LEAST


def _starts(source: Verts, target: Float64[np.ndarray, "N 3"]) -> list[Pose]:
    """Return poses with coinciding centroids and equal sizes: as given, and the turns of principal axes."""
    centre, goal = source.mean(axis=0), target.mean(axis=0)
    scale = float(np.sqrt((target - goal).var(0).sum() / (source - centre).var(0).sum()))
    rotations = [np.eye(3), *principal_turns(source, target)]
    return [Pose(rotation, goal - scale * rotation @ centre, scale) for rotation in rotations]


def _distances(surface: Mesh | PointCloud, points: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, " N"]:
    if isinstance(surface, PointCloud):
        return _point_distances(surface.verts, points)
    return np.asarray(point_distances(surface, points))


def _point_distances(points: Verts, queries: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, " N"]:
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
    """Sample points with normals; those of a cloud, whose sides are not known, have none."""
    if not np.ptp(mesh.verts, axis=0).max() > 0:
        raise MeshError(f"{role}: a surface without extent cannot be aligned")
    if isinstance(mesh, PointCloud):
        areas = sampled_areas(mesh.verts).cumsum()
        at = (np.arange(_POINTS) + 0.5) * (areas[-1] / _POINTS)
        points = mesh.verts[np.searchsorted(areas, at).clip(max=mesh.num_verts - 1)]
        normals = np.zeros_like(points)
    else:
        samples = sample_surface(mesh, _POINTS, np.random.default_rng(0))
        points, normals = samples.points, face_normals(mesh)[samples.faces]
    ones = np.ones(len(points))
    return OrientedPoints(np.asarray(points), normals, ones, np.zeros(len(points), dtype=bool), 0 * ones)
