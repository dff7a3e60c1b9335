"""Poses: rotations, translations and scales from which a template may start, by trimmed symmetric ICP."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from meshfit.fitting.registration.deformation_graph import cross_matrices
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.pairs import geman_mcclure
from meshfit.mesh.geometry import unit_vectors
from meshfit.mesh.mesh import Verts

_SAMPLES, _ROUNDS = 800, 25
# Pairs farther apart than this quantile are left out; the others have robust weights of half its width.
_TRIM = 0.8
# Normals in the search for nearest points, and the largest distance that counts, relative to the target's diagonal.
_NORMALS, _CAP = 0.1, 0.15
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

    ICP starts from the pose as given, that turned by ±45° about each axis, and the four proper turns of the principal
    axes. A score does not choose: of articulated bodies they lie close together, and the best may be wrong.

    Args:
        source: vertices of the template.
        target: points of the target.
        similarity: whether the scale is to be found, too.
        most: largest number of poses.
        seed: of the samples.
    """
    generator = np.random.default_rng(seed)
    p, q = (points.subset(points.draw(_SAMPLES, generator)) for points in (source, target))
    diagonal = float(np.linalg.norm(np.ptp(target.points, axis=0)))
    search = _Search(p, q, diagonal, similarity=similarity)
    found = sorted((search.settled(start) for start in search.starts()), key=lambda pose: pose.score)
    given = Pose.identity()
    poses = [Pose(given.rotation, given.translation, 1.0, search.score(given))]
    for pose in found:
        if len(poses) == most:
            break
        if all(pose.angle_to(other) > _DISTINCT for other in poses[1:]):
            poses.append(pose)
    return poses


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
        own, other = (_principal_axes(points) for points in (self.source.points, self.target.points))
        signs = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))
        rotations = [np.eye(3), *(other @ np.diag(sign) @ own.T for sign in signs)]
        rotations += [Rotation.from_rotvec(axis * turn).as_matrix() for axis in np.eye(3) for turn in _TURNS]
        return [Pose(rotation, goal - scale * rotation @ centre, scale) for rotation in rotations]

    def settled(self, pose: Pose) -> Pose:
        """Return a pose after ICP."""
        for _ in range(_ROUNDS):
            pose, change = self._round(pose)
            if change < _SETTLED:
                break
        return Pose(pose.rotation, pose.translation, pose.scale, self.score(pose))

    def score(self, pose: Pose) -> float:
        """Return how far the two are from each other."""
        moved, length, cap = self._moved(pose), _NORMALS * self.diagonal, _CAP * self.diagonal
        ways = (
            self.target.nearest(moved, length)[0],
            moved.nearest(self.target, length)[0],
        )
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


def _principal_axes(points: Verts) -> Float64[np.ndarray, "3 3"]:
    """Return the principal axes as columns of a rotation, the longest first."""
    axes = np.linalg.eigh(np.cov((points - points.mean(axis=0)).T))[1][:, ::-1].copy()
    if np.linalg.det(axes) < 0:
        axes[:, 2] *= -1
    return axes
