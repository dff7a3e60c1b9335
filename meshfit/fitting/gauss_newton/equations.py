"""The normal equations of a step: sparse, symmetric positive definite, solved by conjugate gradients."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from meshfit.fitting.gauss_newton.correspondences import Correspondences
from meshfit.fitting.gauss_newton.fairness import Fairness
from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.loss.sparse import Sparse, compressed_rows
from meshfit.mesh.topology import PolygonTopology
from meshfit.remeshing.triangle_geometry import dot, unit

UPPER = tuple(combinations_with_replacement(range(3), 2))
"""Rows and columns of the upper half of a 3 × 3 matrix, in the order in which symmetric matrices are stored."""

# Place of each entry of a symmetric 3 × 3 matrix in its upper half.
_FULL = (0, 1, 2, 1, 3, 4, 2, 4, 5)
# Places in the upper half of the corners of a face, and of its sides, in the order of its half-edges.
_CORNERS, _SIDES = (0, 3, 5), (1, 4, 2)
_TOLERANCE, _MOST_ITERATIONS = 1e-3, 60


@dataclass(frozen=True, eq=False)
class SparsityPattern:
    """Block-sparsity of a mesh's matrices: a 3 × 3 block for each vertex, and two for each edge."""

    connectivity: Connectivity

    @cached_property
    def _order(self) -> tuple[Tensor, Tensor, Tensor]:
        """Row and column of each block, sorted by row, and its number among vertices, edges and reversed edges."""
        n, (tail, head) = self.connectivity.num_verts, self.connectivity.ends
        vert = torch.arange(n, device=tail.device)
        rows, columns = torch.cat([vert, tail, head]), torch.cat([vert, head, tail])
        order = (rows * n + columns).argsort()
        return rows[order], columns[order], order

    @property
    def columns(self) -> Int64[Tensor, " B"]:
        """Block column of each block."""
        return self._order[1]

    @property
    def rows(self) -> Int64[Tensor, " B"]:
        """Block row of each block."""
        return self._order[0]

    @cached_property
    def diagonal(self) -> Int64[Tensor, " V"]:
        """Indices of the diagonal blocks."""
        return (self._order[2] < self.connectivity.num_verts).nonzero()[:, 0]

    @cached_property
    def _values(self) -> Int64[Tensor, " B"]:
        """Index of the value of each block among those of vertices and edges; reversed edges have the same."""
        order, num_edges = self._order[2], len(self.connectivity.edges.keys)
        return torch.where(order < self.connectivity.num_verts + num_edges, order, order - num_edges)

    @cached_property
    def _scalars(self) -> tuple[Tensor, Tensor, Tensor]:
        """Row starts and columns of the scalar matrix, and the place of each entry of each block."""
        n, three = self.connectivity.num_verts, torch.arange(3, device=self.rows.device)
        count = torch.bincount(self.rows, minlength=n)
        start = count.cumsum(0) - count
        within = torch.arange(len(self.rows), device=self.rows.device) - start[self.rows]
        first = (9 * start[self.rows] + 3 * within)[:, None, None]
        place = (first + three[:, None] * (3 * count[self.rows])[:, None, None] + three).view(-1)
        columns = torch.empty(len(place), dtype=torch.int32, device=place.device)
        columns[place] = (3 * self.columns[:, None, None] + three).expand(-1, 3, 3).reshape(-1).int()
        starts = torch.cat([count.new_zeros(1), (3 * count).repeat_interleave(3).cumsum(0)]).int()
        return starts, columns, place

    def times(self, blocks: Float[Tensor, "B 3 3"]) -> Callable[[Tensor], Tensor]:
        """Return the product of the matrix of these blocks with (V, 3) vectors."""
        starts, columns, place = self._scalars
        values = torch.empty_like(blocks.view(-1))
        values[place] = blocks.reshape(-1)
        matrix = compressed_rows(starts, columns, values, len(starts) - 1)
        return lambda x: (matrix @ x.reshape(-1)).view(-1, 3)

    def blocks(self, per_face: Float[Tensor, "F 6 6"]) -> Float[Tensor, "B 3 3"]:
        """Assemble face matrices, given as upper halves over pairs of corners and over pairs of coordinates."""
        edges, upper = self.connectivity.edges, per_face.permute(1, 2, 0)
        at_verts = _at_verts(self.connectivity, upper[_CORNERS, :])
        of_side = torch.stack([upper[k] for k in _SIDES], 2).view(len(UPPER), -1)
        at_edges = of_side.index_select(1, edges.left)
        at_edges += of_side.index_select(1, edges.right.clamp_min(0)).masked_fill_(~edges.inner, 0)
        total = torch.cat([at_verts, at_edges], 1).index_select(1, self._values)
        return total[_FULL, :].T.contiguous().view(-1, 3, 3)

    def springs(self, weights: Float[Tensor, "E 1"]) -> Float[Tensor, "B 3 3"]:
        """Return the matrix of Σ t |x - x'|² over the edges x x', of weights t."""
        tail, head = self.connectivity.ends
        at_verts = weights.new_zeros(self.connectivity.num_verts, 1)
        at_verts.index_add_(0, tail, weights).index_add_(0, head, weights)
        eye = torch.eye(3, dtype=weights.dtype, device=weights.device)
        return torch.cat([at_verts, -weights]).index_select(0, self._values)[:, :, None] * eye


@dataclass(frozen=True, eq=False)
class ControlledSurface:
    """A surface that is the subdivision of a control mesh.

    Attributes:
        pattern: sparsity pattern of the surface.
        operator: (V, C) subdivision matrix S, from the control mesh's positions to the surface's.
        squares: (V, C) squared entries of S.
        polygons: the polygons that the surface was triangulated from, if any.
        tangents: (V, C) operators to two tangents at each vertex, if they are on the limit surface.
    """

    pattern: SparsityPattern
    operator: Sparse
    squares: Sparse
    polygons: PolygonTopology | None = None
    tangents: tuple[Sparse, Sparse] | None = None

    def shape(self, verts: Float[Tensor, "C 3"]) -> Shape:
        """Return the surface of a control mesh at these positions."""
        normals = None
        if self.tangents is not None:
            normals = unit(torch.linalg.cross(self.tangents[0] @ verts, self.tangents[1] @ verts))
        return Shape(self.pattern.connectivity, self.operator @ verts, normals)

    def diagonal(self, blocks: Float[Tensor, "V 3 3"]) -> Float[Tensor, "C 3 3"]:
        """Approximate the diagonal blocks of Sᵀ A S from the diagonal blocks of A."""
        return torch.stack([self.squares.T @ blocks[:, i] for i in range(3)], 1)


def solve_step(
    pattern: SparsityPattern,
    verts: Float[Tensor, "V 3"],
    pairs: Correspondences,
    fairness: Fairness,
    point_weight: float,
    controlled: ControlledSurface | None = None,
) -> tuple[Float[Tensor, "V 3"], int]:
    """Return the step d that minimises Σ w [(n · (B d - r))² + μ |B d - r|²] plus the fairness after it.

    B maps vertices to the points of the correspondences; r are the residuals, n the target's normals.

    Args:
        pattern: sparsity pattern of the mesh that is solved for.
        verts: (V, 3) its current positions.
        pairs: correspondences of the surface.
        fairness: fairness of the mesh that is solved for.
        point_weight: μ, the weight of residuals along the target relative to those across it.
        controlled: the surface, if the mesh that is solved for is its control mesh.

    Returns:
        (V, 3) the step, and the number of iterations.
    """
    surface = pattern if controlled is None else controlled.pattern
    left, right = _table(len(surface.connectivity.faces), pairs, point_weight)
    blocks = surface.blocks(left.permute(2, 0, 1))
    pull, slope = _at_verts(surface.connectivity, right).T, fairness.slope(verts)
    if controlled is None and fairness.tension is not None:
        blocks += surface.springs(fairness.tension.weights)
        fairness = replace(fairness, tension=None)
    diagonal = blocks[surface.diagonal]
    surface_times = surface.times(blocks)
    if controlled is not None:
        pull, diagonal = controlled.operator.T @ pull, controlled.diagonal(diagonal)

    def times(x: Tensor) -> Tensor:
        if controlled is None:
            return surface_times(x) + fairness(x)
        return controlled.operator.T @ surface_times(controlled.operator @ x) + fairness(x)

    eye = torch.eye(3, dtype=blocks.dtype, device=blocks.device)
    diagonal = diagonal + (fairness.diagonal()[:, :, None] + torch.finfo(blocks.dtype).tiny ** 0.5) * eye
    return conjugate_gradients(times, pull - slope, diagonal, _TOLERANCE)


def _table(num_faces: int, pairs: Correspondences, point_weight: float) -> tuple[Tensor, Tensor]:
    """Return, per face, Σ w (b bᵀ) ⊗ (n nᵀ + μ I) in upper halves, and Σ w b ⊗ (n (n · r) + μ r).

    Returns:
        (6, 6, F) for each pair of corners and of coordinates, and (3, 3, F) for each corner and coordinate: with faces
        last, it takes half the time.
    """
    n, r, b = (values.T.contiguous() for values in (pairs.normals, pairs.residuals, pairs.corners))
    metric = torch.stack([n[i] * n[j] + point_weight * (i == j) for i, j in UPPER])
    pull = (n * dot(pairs.normals, pairs.residuals) + point_weight * r) * pairs.weights
    left, right = n.new_zeros(len(UPPER), len(UPPER), num_faces), n.new_zeros(3, 3, num_faces)
    for k, (i, j) in enumerate(UPPER):
        left[k].index_add_(1, pairs.face, b[i] * b[j] * pairs.weights * metric)
    for k in range(3):
        right[k].index_add_(1, pairs.face, b[k] * pull)
    return left, right


def _at_verts(connectivity: Connectivity, per_corner: Float[Tensor, "3 N F"]) -> Float[Tensor, "N V"]:
    """Sum values of the corners of faces at each vertex."""
    total = per_corner.new_zeros(per_corner.shape[1], connectivity.num_verts)
    for k in range(3):
        total.index_add_(1, connectivity.faces[:, k], per_corner[k])
    return total


def conjugate_gradients(
    times: Callable[[Tensor], Tensor],
    right: Float[Tensor, "V 3"],
    diagonal: Float[Tensor, "V 3 3"],
    tolerance: float,
    most: int = _MOST_ITERATIONS,
) -> tuple[Float[Tensor, "V 3"], int]:
    """Solve A x = b, A symmetric positive definite, by conjugate gradients (Hestenes and Stiefel 1952).

    The preconditioner is block Jacobi: the inverse of the diagonal blocks.

    Args:
        times: product with A.
        right: b.
        diagonal: the diagonal blocks of A, or an approximation.
        tolerance: largest |b - A x| / |b|.
        most: largest number of iterations.

    Returns:
        x, and the number of iterations.
    """
    x, residual = torch.zeros_like(right), right
    if not bool(right.any()):
        return x, 0
    inverse = torch.linalg.inv(diagonal)
    z = (inverse @ residual[:, :, None])[:, :, 0]
    direction, slope, limit = z, (residual * z).sum(), tolerance * right.norm()
    for iteration in range(1, most + 1):
        product = times(direction)
        length = slope / (direction * product).sum()
        x, residual = x + length * direction, residual - length * product
        if not residual.norm() > limit:
            return x, iteration
        z = (inverse @ residual[:, :, None])[:, :, 0]
        slope, before = (residual * z).sum(), slope
        direction = z + (slope / before) * direction
    return x, most
