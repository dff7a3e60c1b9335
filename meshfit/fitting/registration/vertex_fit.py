"""Fits of all vertices of a template near its target, whose displacement is kept smooth."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float64
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import LinearOperator, cg, splu

from meshfit.fitting.gauss_newton.step_limiting import limit_step
from meshfit.fitting.registration.graph_fit import between
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.pairs import Matching, Pairs, find_pairs
from meshfit.fitting.registration.plan import VERTEX_STEPS, Range
from meshfit.fitting.registration.template import Template
from meshfit.fitting.settings import Direction
from meshfit.mesh.mesh import Verts

_WIDTH: Range = (0.012, 0.006)
_FAIRNESS: Range = (1.0, 0.2)
_POINT_WEIGHT, _NORMAL_LENGTH = 0.01, 0.02
_DAMPING, _TOLERANCE, _MOST_ITERATIONS = 1e-6, 1e-4, 30


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
    """

    template: Template
    target: OrientedPoints
    start: Verts
    direction: Direction
    diagonal: float

    @cached_property
    def _bending(self) -> csc_array:
        adjacency = self.template.adjacency
        valence = adjacency.sum(axis=1)
        laplacian = diags_array(valence) - adjacency
        return csc_array(laplacian @ diags_array(1 / np.maximum(valence, 1)) @ laplacian)

    def step(self, verts: Verts, number: int) -> tuple[Verts, Pairs]:
        """Return the vertices after one step, and its pairs."""
        share = number / max(VERTEX_STEPS - 1, 1)
        matching = Matching(between(_WIDTH, share) * self.diagonal, _NORMAL_LENGTH * self.diagonal, self.direction)
        template, count = self.template.points_at(verts), len(verts)
        pairs = find_pairs(template, self.target, np.arange(count), np.arange(len(self.target)), matching)
        weights = pairs.weights * count / 2
        metric = pairs.normals[:, :, None] * pairs.normals[:, None, :] + _POINT_WEIGHT * np.eye(3)
        metric = weights[:, None, None] * metric
        pull = np.einsum("nij,nj->ni", metric, pairs.goals)
        blocks = _summed(pairs.verts, metric.reshape(-1, 9), count).reshape(-1, 3, 3)
        fairness = between(_FAIRNESS, share)
        right = _summed(pairs.verts, pull, count) + fairness * (self._bending @ self.start) + _DAMPING * verts
        return self._limited(verts, self._solved(verts, blocks, right, fairness)), pairs

    def _solved(
        self, verts: Verts, blocks: Float64[np.ndarray, "V 3 3"], right: Float64[np.ndarray, "V 3"], fairness: float
    ) -> Verts:
        bending = fairness * self._bending
        mean = np.trace(blocks, axis1=1, axis2=2) / 3 + _DAMPING
        options = {"SymmetricMode": True}
        matrix = (bending + diags_array(mean)).tocsc()
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)

        def times(flat: Float64[np.ndarray, " N"]) -> Float64[np.ndarray, " N"]:
            x = flat.reshape(-1, 3)
            return np.asarray((bending @ x + np.einsum("nij,nj->ni", blocks, x) + _DAMPING * x).ravel())

        def preconditioned(flat: Float64[np.ndarray, " N"]) -> Float64[np.ndarray, " N"]:
            return np.asarray(factors.solve(np.ascontiguousarray(flat.reshape(-1, 3))).ravel())

        shape = (verts.size, verts.size)
        operator, inverse = (LinearOperator(shape, product, dtype=np.float64) for product in (times, preconditioned))
        flat, _ = cg(operator, right.ravel(), verts.ravel(), M=inverse, rtol=_TOLERANCE, maxiter=_MOST_ITERATIONS)
        return np.asarray(flat.reshape(-1, 3))

    def _limited(self, verts: Verts, goals: Verts) -> Verts:
        moved, _ = limit_step(self.template.connectivity, torch.tensor(verts), torch.tensor(goals))
        return np.asarray(moved.numpy())


def _summed(rows: np.ndarray, values: Float64[np.ndarray, "M N"], count: int) -> Float64[np.ndarray, "V N"]:
    columns = [np.bincount(rows, values[:, k], count) for k in range(values.shape[1])]
    return np.stack(columns, axis=1)
