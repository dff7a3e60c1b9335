"""Fits of a deformation graph to a target: robust pairs, annealed from wide to narrow, over finer and finer graphs."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from jaxtyping import Float64, Int64
from scipy.sparse import csc_array, csr_array, diags_array, eye_array
from scipy.sparse.linalg import splu

from meshfit.fitting.registration.deformation_graph import DeformationGraph
from meshfit.fitting.registration.landmarks import summed_rows
from meshfit.fitting.registration.oriented_points import OrientedPoints, some_of
from meshfit.fitting.registration.pairs import Matching, Pairs, find_pairs, geman_mcclure, metric_roots
from meshfit.fitting.registration.plan import Level, Range
from meshfit.fitting.registration.template import Template
from meshfit.fitting.settings import Direction
from meshfit.mesh.landmarks import PlacedLandmarks

# Unknowns up to which the equations are solved as a dense matrix.
_DENSE = 700
_DAMPING, _LARGEST_TURN = 1e-9, 0.5
# Vertices that are paired in a step, at least so many for each node.
_SAMPLES_PER_NODE = 6
# Distance at which a landmark has a quarter of its weight, relative to the diagonal: of those given, some are wrong.
_LANDMARK_WIDTH = (0.2, 0.02)
# Rows of fixed vertices, at most about, and their weight; pairs have up to 2.
_FIXED_ROWS, _FIXED_WEIGHT = 500, 50.0


@dataclass(frozen=True, eq=False)
class GraphFit:
    """A template that is carried to a target by a deformation graph.

    Attributes:
        template: the template.
        target: points of the target.
        direction: of the pairs.
        diagonal: of the target.
        remoteness: distance that a difference of 1 in remoteness is worth at first, relative to the diagonal.
        landmarks: points whose places are known.
        weights: (V,) confidence in the data at each vertex; None for the same everywhere.
        fixed: vertices that are held where they are in the template.
        soft: whether parts may grow and shrink.
    """

    template: Template
    target: OrientedPoints
    direction: Direction
    diagonal: float
    remoteness: float = 0.0
    landmarks: PlacedLandmarks | None = None
    weights: Float64[np.ndarray, " V"] | None = None
    fixed: Int64[np.ndarray, " F"] | None = None
    soft: bool = False

    def step(
        self,
        graph: DeformationGraph,
        level: Level,
        number: int,
        generator: np.random.Generator,
        progress: float,
    ) -> tuple[DeformationGraph, Pairs]:
        """Return the graph after one step of a level, and the pairs of the step.

        Args:
            graph: before the step.
            level: of the step.
            number: of the step in its level.
            generator: of the samples.
            progress: share of all levels that is done, by which the robust weights of landmarks narrow.
        """
        share = number / max(level.steps - 1, 1)
        width, stiffness, point_weight = (
            between(ends, share) for ends in (level.width, level.stiffness, level.point_weight)
        )
        count = max(level.samples, _SAMPLES_PER_NODE * graph.num_nodes)
        known = max(level.points, 2 * count)
        target, rows = self.target.thinned(known), some_of(len(graph.rest), known)
        part = graph.restricted(rows)
        template = self._points(part, rows)
        verts, points = (_drawn(len(side), count, generator) for side in (template, target))
        matching = Matching(
            width * self.diagonal,
            level.normal_length * self.diagonal,
            self.direction,
            self.remoteness * self.diagonal * (1 - share),
        )
        pairs = find_pairs(template, target, verts, points, matching)
        pairs = pairs.weighted(None if self.weights is None else self.weights[rows])
        roots = metric_roots(pairs.normals, pairs.weights, point_weight)
        jacobian = part.jacobian(pairs.verts, roots)
        residuals = np.einsum("nij,nj->ni", roots, pairs.goals - template.points[pairs.verts]).ravel()
        bend, bent = graph.stiffness()
        shares = (graph.shares * (stiffness / max(float(graph.shares.sum()), 1e-12))).repeat(3)
        square = jacobian.T @ jacobian + bend.T @ diags_array(shares) @ bend
        right = jacobian.T @ residuals - bend.T @ (shares * bent)
        if self.landmarks is not None:
            more_square, more_right = self._pull_of_landmarks(self.landmarks, graph, progress)
            square, right = square + more_square, right + more_right
        if self.fixed is not None and len(self.fixed):
            more_square, more_right = self._hold_of_fixed(self.fixed, graph)
            square, right = square + more_square, right + more_right
        square = csc_array(square + _DAMPING * eye_array(square.shape[0]))
        moved = graph.moved(_solved(square, right).reshape(-1, 6), _LARGEST_TURN)
        return moved.rescaled() if self.soft else moved, pairs

    def _points(self, graph: DeformationGraph, rows: Int64[np.ndarray, " M"]) -> OrientedPoints:
        """Return some vertices, which are those of the graph, where it moves them, with their normals there."""
        at_rest = self._at_rest
        areas, rim, remoteness = at_rest.areas[rows], at_rest.rim[rows], at_rest.remoteness[rows]
        return OrientedPoints(graph.positions(), graph.turned(at_rest.normals[rows]), areas, rim, remoteness)

    @cached_property
    def _at_rest(self) -> OrientedPoints:
        return self.template.points_at(self.template.mesh.verts)

    def _hold_of_fixed(
        self, fixed: Int64[np.ndarray, " F"], graph: DeformationGraph
    ) -> tuple[csr_array, Float64[np.ndarray, " N"]]:
        """Return the equations that hold fixed vertices, or some of them, where they are in the template."""
        some = fixed[:: max(1, len(fixed) // _FIXED_ROWS)]
        part = graph.restricted(some)
        away = self.template.mesh.verts[some] - part.positions()
        root = np.sqrt(_FIXED_WEIGHT / len(some))
        jacobian = part.jacobian(np.arange(len(some)), np.broadcast_to(root * np.eye(3), (len(some), 3, 3)))
        return csr_array(jacobian.T @ jacobian), jacobian.T @ (root * away).ravel()

    def _pull_of_landmarks(
        self, landmarks: PlacedLandmarks, graph: DeformationGraph, progress: float
    ) -> tuple[csr_array, Float64[np.ndarray, " N"]]:
        """Return the equations of landmarks, whose weights sum to at most that of one direction of pairs."""
        corners = graph.restricted(landmarks.corners.ravel())
        away = landmarks.goals - landmarks.points_between(corners.positions().reshape(-1, 3, 3))
        width = between(_LANDMARK_WIDTH, progress) * self.diagonal
        weights = geman_mcclure(np.linalg.norm(away, axis=1), width) / len(landmarks)
        eyes = np.broadcast_to(np.eye(3), (3 * len(landmarks), 3, 3))
        jacobian = summed_rows(landmarks, corners.jacobian(np.arange(len(eyes)), eyes))
        scaled = diags_array(weights.repeat(3)) @ jacobian
        return csr_array(jacobian.T @ scaled), scaled.T @ away.ravel()


def between(ends: Range, share: float) -> float:
    """Return the value at a share of the way between two, in geometric steps."""
    return float(ends[0] * (ends[1] / ends[0]) ** share)


def _drawn(count: int, wanted: int, generator: np.random.Generator) -> np.ndarray:
    return np.arange(count) if wanted >= count else generator.choice(count, wanted, replace=False)


def _solved(square: csc_array, right: Float64[np.ndarray, " N"]) -> Float64[np.ndarray, " N"]:
    if len(right) <= _DENSE:
        factor = scipy.linalg.cho_factor(square.toarray(), check_finite=False)
        return np.asarray(scipy.linalg.cho_solve(factor, right, check_finite=False))
    options = {"SymmetricMode": True}
    factors = splu(square, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return np.asarray(factors.solve(right))
