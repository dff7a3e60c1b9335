"""Landmarks: points of a template whose places on the target are known."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from meshfit.errors import MeshError
from meshfit.fitting.registration.pairs import geman_mcclure
from meshfit.fitting.registration.poses import Pose
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.projection import Places

_LEAST = 3
_ROUNDS, _WIDTH = 10, 2.0


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Points of a template, as vertices or within faces, and where they belong.

    Attributes:
        corners: (L, 3) vertices of the template.
        shares: (L, 3) weights of these, with a sum of 1.
        goals: (L, 3) positions on the target.
    """

    corners: Int64[np.ndarray, "L 3"]
    shares: Float64[np.ndarray, "L 3"]
    goals: Float64[np.ndarray, "L 3"]

    @classmethod
    def of(cls, source: Mesh, places: ArrayLike, goals: ArrayLike) -> "Landmarks":
        """Return the landmarks of a source.

        Args:
            source: the template.
            places: (L,) its vertices, or (L, 3) positions, whose nearest points on it count.
            goals: (L, 3) positions on the target.

        Raises:
            MeshError: fewer than three, arrays of other shapes, values that are not finite, or vertices that the source
                does not have.
        """
        where, wanted = np.asarray(places), np.asarray(goals, dtype=np.float64)
        if wanted.ndim != 2 or wanted.shape[1] != 3:
            raise MeshError(f"landmarks: expected positions on the target as rows of three, got shape {wanted.shape}")
        if len(wanted) < _LEAST:
            raise MeshError(f"landmarks: expected {_LEAST} or more, got {len(wanted)}")
        if where.shape not in ((len(wanted),), wanted.shape):
            raise MeshError(
                f"landmarks: expected {len(wanted)} vertices or points of the source, got shape {where.shape}"
            )
        if not (np.isfinite(wanted).all() and np.isfinite(where).all()):
            raise MeshError("landmarks: expected finite numbers")
        if where.ndim == 1:
            return cls._at_verts(source, where, wanted)
        nearest = Places.nearest(source, np.ascontiguousarray(where, dtype=np.float64))
        return cls(source.faces[nearest.face], nearest.weights, wanted)

    @classmethod
    def _at_verts(
        cls, source: Mesh, verts: Float64[np.ndarray, " L"], goals: Float64[np.ndarray, "L 3"]
    ) -> "Landmarks":
        wrong = (verts < 0) | (verts >= source.num_verts) | (verts != np.floor(verts))
        if wrong.any():
            number = int(np.flatnonzero(wrong)[0])
            raise MeshError(f"landmark {number}: no vertex {verts[number]:g}; the source has {source.num_verts:,}")
        shares = np.tile([1.0, 0.0, 0.0], (len(verts), 1))
        return cls(verts.astype(np.int64)[:, None].repeat(3, axis=1), shares, goals)

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.goals)

    def points(self, verts: Verts) -> Float64[np.ndarray, "L 3"]:
        """Return where the landmarks are."""
        return self.points_between(verts[self.corners])

    def points_between(self, corners: Float64[np.ndarray, "L 3 3"]) -> Float64[np.ndarray, "L 3"]:
        """Return where the landmarks are, given the positions of their corners."""
        return np.asarray((corners * self.shares[:, :, None]).sum(axis=1))

    def pose(self, source: Mesh, *, similarity: bool) -> Pose:
        """Return the pose that brings the landmarks nearest to their goals, of which some may be wrong."""
        points, weights = self.points(source.verts), np.ones(len(self))
        pose = _nearest_pose(points, self.goals, weights, similarity=similarity)
        for _ in range(_ROUNDS):
            distances = np.linalg.norm(pose.applied(points) - self.goals, axis=1)
            weights = geman_mcclure(distances, _WIDTH * float(np.median(distances)) + 1e-12)
            pose = _nearest_pose(points, self.goals, weights, similarity=similarity)
        return pose

    def summed(self, rows: csr_array) -> csr_array:
        """Return the rows of the landmarks, from three rows for each of their three corners."""
        count = len(self)
        landmark, corner, axis = (grid.ravel() for grid in np.indices((count, 3, 3)))
        shares = self.shares[landmark, corner]
        gather = csr_array(
            (shares, (3 * landmark + axis, 9 * landmark + 3 * corner + axis)), shape=(3 * count, 9 * count)
        )
        return csr_array(gather @ rows)


def _nearest_pose(points: Verts, goals: Verts, weights: Float64[np.ndarray, " L"], *, similarity: bool) -> Pose:
    """Return the similarity or rigid motion of least weighted squared distance (Umeyama 1991)."""
    weights = weights / weights.sum()
    centre, goal = weights @ points, weights @ goals
    p, q = points - centre, goals - goal
    left, values, right = np.linalg.svd(q.T @ (p * weights[:, None]))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ np.diag(signs) @ right
    scale = float((values * signs).sum() / max(weights @ (p**2).sum(axis=1), 1e-300)) if similarity else 1.0
    return Pose(rotation, goal - scale * rotation @ centre, scale)
