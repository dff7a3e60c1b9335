"""Fits of all vertices of a template near its target, whose displacement is kept smooth."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float64
from scipy.sparse import coo_array, csc_array, csr_array, diags_array, eye_array
from scipy.sparse.linalg import LinearOperator, cg

from meshfit.fitting.gauss_newton.step_limiting import limit_step
from meshfit.fitting.registration.graph_fit import between
from meshfit.fitting.registration.guidance import Guidance, HeldParts
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.pairs import Matching, Pairs, find_pairs, geman_mcclure
from meshfit.fitting.registration.plan import VERTEX_STEPS, Range
from meshfit.fitting.registration.template import Template
from meshfit.fitting.settings import Direction
from meshfit.mesh.mesh import Verts
from meshfit.mesh.sparse_factors import SymmetricFactors, nested_dissection
from meshfit.mesh.topology import Indices

_WIDTH: Range = (0.012, 0.006)
_FAIRNESS: Range = (1.0, 0.2)
_POINT_WEIGHT, _NORMAL_LENGTH = 0.01, 0.02
# Weight of a landmark, where that of a vertex is about 1, and the distance at which a quarter of it is left.
_LANDMARK_WEIGHT = 10.0
_LANDMARK_WIDTH: Range = (0.02, 0.01)
_LARGE = 1e9
_DAMPING, _TOLERANCE, _MOST_ITERATIONS = 1e-6, 1e-4, 30
# Attempts to find a step in which a surface stays symmetric and no faces come to cross.
_SYMMETRIC_ATTEMPTS = 6


@dataclass(frozen=True, eq=False)
class VertexFit:
    """Moves every vertex to the target; the displacement from the start is smooth, by the squared uniform Laplacian.

    No step makes faces cross that did not.

    Attributes:
        template: the template.
        target: points of the target.
        start: (V, 3) positions that displacements count from.
        direction: of the pairs.
        diagonal: of the target.
        guidance: landmarks and weights.
        held: vertices that stay, and rigid parts.
    """

    template: Template
    target: OrientedPoints
    start: Verts
    direction: Direction
    diagonal: float
    guidance: Guidance
    held: HeldParts

    @cached_property
    def _laplacian(self) -> csc_array:
        adjacency = self.template.adjacency
        return csc_array(diags_array(adjacency.sum(axis=1)) - adjacency)

    @cached_property
    def _order(self) -> Indices:
        links = csr_array(self._laplacian + eye_array(len(self.start)))
        return nested_dissection(links, self.template.mesh.verts)

    @cached_property
    def _bending(self) -> csc_array:
        valence = np.maximum(self.template.adjacency.sum(axis=1), 1)
        return csc_array(self._laplacian @ diags_array(1 / valence) @ self._laplacian)

    def step(self, verts: Verts, number: int) -> tuple[Verts, Pairs]:
        """Return the vertices after one step, and its pairs."""
        share = number / max(VERTEX_STEPS - 1, 1)
        matching = Matching(between(_WIDTH, share) * self.diagonal, _NORMAL_LENGTH * self.diagonal, self.direction)
        template, count = self.template.points_at(verts), len(verts)
        pairs = find_pairs(template, self.target, np.arange(count), np.arange(len(self.target)), matching)
        pairs = pairs.weighted(self.guidance.weights)
        weights = pairs.weights * count / 2
        metric = pairs.normals[:, :, None] * pairs.normals[:, None, :] + _POINT_WEIGHT * np.eye(3)
        metric = weights[:, None, None] * metric
        pull = np.einsum("nij,nj->ni", metric, pairs.goals)
        blocks = _summed(pairs.verts, metric.reshape(-1, 9), count).reshape(-1, 3, 3)
        fairness = between(_FAIRNESS, share)
        right = _summed(pairs.verts, pull, count) + fairness * (self._bending @ self.start) + _DAMPING * verts
        rows = self._rows_of_landmarks(verts, share)
        right = right if rows is None else right + rows[1]
        square = fairness * self._bending if rows is None else csc_array(fairness * self._bending + rows[0])
        free = np.ones(count, dtype=bool)
        free[self.held.fixed] = False
        solved = self._solved(verts, blocks, right, square, fairness, free)
        if self.held.parts:  # what is around them follows where they go
            solved, free = self.held.applied(solved), ~self.held.mask
            solved = self._solved(solved, blocks, right, square, fairness, free)
        return self._moved(verts, self.held.applied(solved)), pairs

    def _rows_of_landmarks(self, verts: Verts, share: float) -> tuple[csc_array, Float64[np.ndarray, "V 3"]] | None:
        """Return the square and the right side of the rows of landmarks, with robust weights."""
        landmarks = self.guidance.used_landmarks
        if landmarks is None:
            return None
        weights = _LANDMARK_WEIGHT * geman_mcclure(
            landmarks.errors(verts), between(_LANDMARK_WIDTH, share) * self.diagonal
        )
        number = np.arange(len(landmarks)).repeat(3)
        matrix = csr_array(
            coo_array(
                (landmarks.shares.ravel(), (number, landmarks.corners.ravel())), shape=(len(landmarks), len(verts))
            )
        )
        scaled = diags_array(weights) @ matrix
        return csc_array(matrix.T @ scaled), scaled.T @ landmarks.goals

    def _solved(
        self,
        verts: Verts,
        blocks: Float64[np.ndarray, "V 3 3"],
        right: Float64[np.ndarray, "V 3"],
        bending: csc_array,
        fairness: float,
        free: Bool[np.ndarray, " V"],
    ) -> Verts:
        """Solve for the free vertices; the others stay where they are."""
        mean = np.trace(blocks, axis1=1, axis2=2) / 3 + _DAMPING + np.where(free, 0.0, _LARGE)
        inverse_of = self._root_inverse(fairness, mean)

        def product(x: Float64[np.ndarray, "V 3"]) -> Float64[np.ndarray, "V 3"]:
            return np.asarray(bending @ x + np.einsum("nij,nj->ni", blocks, x) + _DAMPING * x)

        if not free.all():
            start = np.where(free[:, None], 0.0, verts)
            right = np.where(free[:, None], right - product(start), 0.0)

        def times(flat: Float64[np.ndarray, " N"]) -> Float64[np.ndarray, " N"]:
            x = flat.reshape(-1, 3)
            return np.asarray(np.where(free[:, None], product(np.where(free[:, None], x, 0.0)), x).ravel())

        def preconditioned(flat: Float64[np.ndarray, " N"]) -> Float64[np.ndarray, " N"]:
            return inverse_of(flat.reshape(-1, 3)).ravel()

        shape = (verts.size, verts.size)
        operator, inverse = (LinearOperator(shape, function, dtype=np.float64) for function in (times, preconditioned))
        first = np.where(free[:, None], verts, 0.0)
        flat, _ = cg(operator, right.ravel(), first.ravel(), M=inverse, rtol=_TOLERANCE, maxiter=_MOST_ITERATIONS)
        return np.asarray(np.where(free[:, None], flat.reshape(-1, 3), verts))

    def _root_inverse(
        self, fairness: float, mean: Float64[np.ndarray, " V"]
    ) -> Callable[[Float64[np.ndarray, "V 3"]], Float64[np.ndarray, "V 3"]]:
        """Return the inverse of B D⁻¹ B, where D are valences and B is √f L + √(m D), by factors of B.

        It is within a factor of about 2 of that of f L D⁻¹ L + m, whose own factors have many times the entries.
        """
        valence = np.maximum(self.template.adjacency.sum(axis=1), 1)
        root = csr_array(np.sqrt(fairness) * self._laplacian + diags_array(np.sqrt(mean * valence)))
        factors = SymmetricFactors(root, self._order)
        return lambda x: factors.solve(valence[:, None] * factors.solve(x))

    def _moved(self, verts: Verts, goals: Verts) -> Verts:
        """Move the vertices as far as no faces come to cross, with what is held in its place."""
        for _ in range(_SYMMETRIC_ATTEMPTS):
            limited, held_back = limit_step(self.template.connectivity, torch.tensor(verts), torch.tensor(goals))
            moved = self.held.applied(np.asarray(limited.numpy()))
            if self.held.mirror is None or not held_back.any():
                return moved
            # The mirror images of vertices that were held back are drawn back, too, and have not been looked at.
            goals = moved
        return verts


def _summed(rows: np.ndarray, values: Float64[np.ndarray, "M N"], count: int) -> Float64[np.ndarray, "V N"]:
    columns = [np.bincount(rows, values[:, k], count) for k in range(values.shape[1])]
    return np.stack(columns, axis=1)
