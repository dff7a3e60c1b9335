"""Poses: rotations, translations and scales from which a template may start, by trimmed symmetric ICP."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from meshfit.fitting.registration.deformation_graph import cross_matrices
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.pairs import geman_mcclure
from meshfit.mesh.geometry import unit_vectors
from meshfit.mesh.mesh import Verts

_SAMPLES, _ROUNDS = 800, 25
# Of many starts, those that are best after a few rounds with few samples go on; the pose that is chosen ends with many.
_FEW_SAMPLES, _FEW_ROUNDS, _GO_ON = 300, 4, 6
_MANY_SAMPLES, _MANY_ROUNDS = 5000, 12
# Starts that are poses without ICP, too.
_UNMOVED = 2
# Pairs farther apart than this quantile are left out; the others have robust weights of half its width.
_TRIM = 0.8
# Normals in the search for nearest points, and the largest distance that counts, relative to the target's diagonal.
_NORMALS, _CAP = 0.1, 0.15
# Distance that a difference of 1 in remoteness is worth in the second ranking of poses.
_REMOTENESS = 0.3
_POINT_WEIGHT = 0.1
# A turn and a move below which rounds end.
_SETTLED = 1e-3
# Turns of the start as given, about each axis, besides those of the principal axes.
_TURNS = (np.pi / 4, -np.pi / 4)
# Angle below which two poses are the same.
_DISTINCT = 0.35


@dataclass(frozen=True, eq=False)
class Pose:
    """A similarity x ↦ s R x + t.

    Attributes:
        rotation: (3, 3).
        translation: (3,).
        scale: s.
        score: root mean square of capped distances both ways, in positions and normals, relative to the diagonal.
    """

    rotation: Float64[np.ndarray, "3 3"]
    translation: Float64[np.ndarray, "3"]
    scale: float = 1.0
    score: float = np.inf

    @classmethod
    def identity(cls) -> "Pose":
        """Return the pose as given."""
        return cls(np.eye(3), np.zeros(3))

    def applied(self, points: Verts) -> Verts:
        """Return points in this pose."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def angle_to(self, other: "Pose") -> float:
        """Return the angle between two rotations."""
        return float(np.arccos(np.clip((np.trace(self.rotation.T @ other.rotation) - 1) / 2, -1, 1)))


def candidate_poses(
    source: OrientedPoints, target: OrientedPoints, *, similarity: bool, most: int, seed: int
) -> list[Pose]:
    """Return the pose as given, then others by ICP that differ from each other, best score first.

    ICP starts from the pose as given, that turned by ±45° about each axis, and the 24 proper turns that take principal
    axes to principal axes. A score does not choose: of articulated bodies they lie close together, and the best may be
    wrong. Scores with and without remoteness take turns, as limbs may be held in another way, or be missing.

    Args:
        source: vertices of the template.
        target: points of the target.
        similarity: whether the scale is to be found, too.
        most: largest number of poses.
        seed: of the samples.
    """
    generator = np.random.default_rng(seed)
    few, search = (
        _search(source, target, count, generator, similarity=similarity) for count in (_FEW_SAMPLES, _SAMPLES)
    )
    some = [few.settled(start, _FEW_ROUNDS) for start in search.starts()]
    chosen = dict.fromkeys([0, *_ranked(some, few)[:_GO_ON]])
    found = [search.settled(some[number], _ROUNDS) for number in chosen]
    given = Pose.identity()
    poses = [Pose(given.rotation, given.translation, 1.0, search.score(given))]
    starts = [replace(start, score=search.score(start)) for start in search.starts()[1:]]
    # ICP turns bodies whose limbs have moved; the principal axes may well be nearer.
    poses += [starts[number] for number in _ranked(starts, search)[:_UNMOVED]]
    for number in _ranked(found, search):
        if len(poses) == most:
            break
        if all(found[number].angle_to(other) > _DISTINCT for other in poses[1 + _UNMOVED :]):
            poses.append(found[number])
    return poses


def polished(
    pose: Pose,
    source: OrientedPoints,
    target: OrientedPoints,
    *,
    similarity: bool,
    seed: int,
    rounds: int = _MANY_ROUNDS,
) -> Pose:
    """Return a pose after ICP with many points."""
    search = _search(source, target, _MANY_SAMPLES, np.random.default_rng(seed), similarity=similarity)
    return search.settled(pose, rounds)


def nearest_pose(points: Verts, goals: Verts, weights: Float64[np.ndarray, " L"], *, similarity: bool) -> Pose:
    """Return the similarity or rigid motion of least weighted squared distance (Umeyama 1991)."""
    weights = weights / weights.sum()
    centre, goal = weights @ points, weights @ goals
    p, q = points - centre, goals - goal
    left, values, right = np.linalg.svd(q.T @ (p * weights[:, None]))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ np.diag(signs) @ right
    scale = float((values * signs).sum() / max(weights @ (p**2).sum(axis=1), 1e-300)) if similarity else 1.0
    return Pose(rotation, goal - scale * rotation @ centre, scale)


def _search(
    source: OrientedPoints, target: OrientedPoints, count: int, generator: np.random.Generator, *, similarity: bool
) -> "_Search":
    p, q = (points.subset(points.draw(count, generator)) for points in (source, target))
    diagonal = float(np.linalg.norm(np.ptp(target.points, axis=0)))
    return _Search(p, q, diagonal, similarity=similarity)


def _ranked(poses: list[Pose], search: "_Search") -> list[int]:
    """Return the numbers of poses, the best first, alternately by the score and by the score with remoteness."""
    with_remoteness = [search.score(pose, _REMOTENESS) for pose in poses]
    orders = np.argsort([pose.score for pose in poses], kind="stable"), np.argsort(with_remoteness, kind="stable")
    return list(dict.fromkeys(int(number) for pair in zip(*orders, strict=True) for number in pair))


@dataclass(frozen=True, eq=False)
class _Search:
    source: OrientedPoints
    target: OrientedPoints
    diagonal: float
    similarity: bool

    def starts(self) -> list[Pose]:
        """Return the poses that ICP starts from, with coinciding centroids."""
        centre, goal = self.source.points.mean(axis=0), self.target.points.mean(axis=0)
        scale = 1.0
        if self.similarity:
            spreads = [
                np.linalg.norm(points - points.mean(axis=0)) for points in (self.target.points, self.source.points)
            ]
            scale = float(spreads[0] / spreads[1])
        rotations = [np.eye(3), *principal_turns(self.source.points, self.target.points)]
        rotations += [Rotation.from_rotvec(axis * turn).as_matrix() for axis in np.eye(3) for turn in _TURNS]
        return [Pose(rotation, goal - scale * rotation @ centre, scale) for rotation in rotations]

    def settled(self, pose: Pose, rounds: int) -> Pose:
        """Return a pose after ICP of so many rounds, or fewer if it does not change any more."""
        for _ in range(rounds):
            pose, change = self._round(pose)
            if change < _SETTLED:
                break
        return Pose(pose.rotation, pose.translation, pose.scale, self.score(pose))

    def score(self, pose: Pose, remoteness: float = 0.0) -> float:
        """Return how far the two are from each other."""
        moved, cap = self._moved(pose), _CAP * self.diagonal
        lengths = _NORMALS * self.diagonal, remoteness * self.diagonal
        ways = self.target.nearest(moved, *lengths)[0], moved.nearest(self.target, *lengths)[0]
        return float(np.sqrt(sum((np.minimum(way, cap) ** 2).mean() for way in ways)) / self.diagonal)

    def _moved(self, pose: Pose) -> OrientedPoints:
        source = self.source
        normals = source.normals @ pose.rotation.T
        return OrientedPoints(pose.applied(source.points), normals, source.areas, source.rim, source.remoteness)

    def _round(self, pose: Pose) -> tuple[Pose, float]:
        """Make one round of ICP: a small similarity that reduces distances to planes, and a little to points."""
        moved, length = self._moved(pose), _NORMALS * self.diagonal
        there = self.target.nearest(moved, length)[1]
        back = moved.nearest(self.target, length)[1]
        start = np.concatenate([moved.points, moved.points[back]])
        goal = np.concatenate([self.target.points[there], self.target.points])
        own = np.concatenate([moved.normals, moved.normals[back]])
        normals = unit_vectors(own + np.concatenate([self.target.normals[there], self.target.normals]))
        distances = np.linalg.norm(goal - start, axis=1)
        width = float(np.quantile(distances, _TRIM)) + 1e-12
        weights = geman_mcclure(distances, width / 2) * (distances <= width)
        centre = weights @ start / weights.sum()
        arms = start - centre
        points = np.concatenate(
            [-cross_matrices(arms), np.broadcast_to(np.eye(3), (len(arms), 3, 3)), arms[:, :, None]], 2
        )
        points = points if self.similarity else points[:, :, :6]
        planes = np.einsum("ni,nij->nj", normals, points)
        square = np.einsum("n,ni,nj->ij", weights, planes, planes)
        square += _POINT_WEIGHT * np.einsum("n,nki,nkj->ij", weights, points, points)
        right = planes.T @ (weights * ((goal - start) * normals).sum(axis=1))
        right += _POINT_WEIGHT * np.einsum("n,nki,nk->i", weights, points, goal - start)
        step = np.linalg.solve(square + 1e-9 * np.eye(len(right)), right)
        turn, growth = Rotation.from_rotvec(step[:3]).as_matrix(), float(np.exp(step[6])) if self.similarity else 1.0
        translation = growth * turn @ (pose.translation - centre) + centre + step[3:6]
        change = max(np.linalg.norm(step[:3]), np.linalg.norm(step[3:6]) / self.diagonal, abs(np.log(growth)))
        return Pose(turn @ pose.rotation, translation, pose.scale * growth), float(change)


def principal_turns(source: Verts, target: Float64[np.ndarray, "N 3"]) -> list[Float64[np.ndarray, "3 3"]]:
    """Return the 24 rotations that take principal axes of some points to principal axes of others."""
    own, other = _principal_axes(source), _principal_axes(target)
    return [other @ turn @ own.T for turn in Rotation.create_group("O").as_matrix()]


def _principal_axes(points: Verts) -> Float64[np.ndarray, "3 3"]:
    """Return the principal axes as columns of a rotation, the longest first."""
    axes = np.linalg.eigh(np.cov((points - points.mean(axis=0)).T))[1][:, ::-1].copy()
    if np.linalg.det(axes) < 0:
        axes[:, 2] *= -1
    return axes
