"""The normal equations of a step: sparse, symmetric positive definite, solved by conjugate gradients."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from meshfit.fitting.gauss_newton.correspondences import Correspondences
from meshfit.fitting.gauss_newton.fairness import Fairness
from meshfit.fitting.gauss_newton.surface import Connectivity
from meshfit.loss.sparse import Sparse, compressed_rows
from meshfit.mesh.topology import PolygonTopology
from meshfit.remeshing.triangle_geometry import dot

UPPER = tuple(combinations_with_replacement(range(3), 2))
"""Rows and columns of the upper half of a 3 × 3 matrix, in the order in which symmetric matrices are stored."""

# Place of each entry of a symmetric 3 × 3 matrix in its upper half.
_FULL = (0, 1, 2, 1, 3, 4, 2, 4, 5)
# Side of a face between two of its corners.
_SIDE = {(0, 1): 0, (1, 2): 1, (0, 2): 2}
_TOLERANCE, _MOST_ITERATIONS = 1e-3, 60


@dataclass(frozen=True, eq=False)
class SparsityPattern:
    """Block-sparsity of a mesh's matrices: a 3 × 3 block for each vertex, and two for each edge."""

    connectivity: Connectivity

    @cached_property
    def _order(self) -> tuple[Tensor, Tensor, Tensor]:
        """Row and column of each block, sorted by row, and the places of vertices, edges and reversed edges."""
        n, (tail, head) = self.connectivity.num_verts, self.connectivity.ends
        vert = torch.arange(n, device=tail.device)
        rows, columns = torch.cat([vert, tail, head]), torch.cat([vert, head, tail])
        order = (rows * n + columns).argsort()
        place = torch.empty_like(order)
        place[order] = torch.arange(len(order), device=order.device)
        return rows[order], columns[order], place

    @property
    def columns(self) -> Int64[Tensor, " B"]:
        """Block column of each block."""
        return self._order[1]

    @property
    def rows(self) -> Int64[Tensor, " B"]:
        """Block row of each block."""
        return self._order[0]

    @property
    def diagonal(self) -> Int64[Tensor, " V"]:
        """Indices of the diagonal blocks."""
        return self._order[2][: self.connectivity.num_verts]

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
        faces, of_side = self.connectivity.faces, self.connectivity.edges.of_side
        n, num_edges = self.connectivity.num_verts, len(self.connectivity.edges.keys)
        total = per_face.new_zeros(len(self.rows), 6)
        for k, (i, j) in enumerate(UPPER):
            if i == j:
                total.index_add_(0, self.diagonal[faces[:, i]], per_face[:, k])
                continue
            edge = of_side[:, _SIDE[i, j]]
            for start in (n, n + num_edges):
                total.index_add_(0, self._order[2][start + edge], per_face[:, k])
        return total[:, _FULL].view(-1, 3, 3)


@dataclass(frozen=True, eq=False)
class ControlledSurface:
    """A surface that is the subdivision of a control mesh.

    Attributes:
        pattern: sparsity pattern of the surface.
        operator: (V, C) subdivision matrix S, from the control mesh's positions to the surface's.
        squares: (V, C) squared entries of S.
        polygons: the polygons that the surface was triangulated from, if any.
    """

    pattern: SparsityPattern
    operator: Sparse
    squares: Sparse
    polygons: PolygonTopology | None = None

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
    table = _table(len(surface.connectivity.faces), pairs, point_weight)
    blocks = surface.blocks(table[:, :36].view(-1, 6, 6))
    pull, diagonal = _at_verts(surface.connectivity, table[:, 36:].view(-1, 3, 3)), blocks[surface.diagonal]
    surface_times = surface.times(blocks)
    if controlled is not None:
        pull, diagonal = controlled.operator.T @ pull, controlled.diagonal(diagonal)

    def times(x: Tensor) -> Tensor:
        if controlled is None:
            return surface_times(x) + fairness(x)
        return controlled.operator.T @ surface_times(controlled.operator @ x) + fairness(x)

    eye = torch.eye(3, dtype=blocks.dtype, device=blocks.device)
    diagonal = diagonal + (fairness.diagonal()[:, :, None] + torch.finfo(blocks.dtype).tiny ** 0.5) * eye
    return conjugate_gradients(times, pull - fairness.slope(verts), diagonal, _TOLERANCE)


def _table(num_faces: int, pairs: Correspondences, point_weight: float) -> Tensor:
    """Return, per face, Σ w (b bᵀ) ⊗ (n nᵀ + μ I) in upper halves, and Σ w b ⊗ (n (n · r) + μ r)."""
    n, r, b = pairs.normals, pairs.residuals, pairs.corners
    metric = torch.stack([n[:, i] * n[:, j] + point_weight * (i == j) for i, j in UPPER], 1)
    share = torch.stack([b[:, i] * b[:, j] for i, j in UPPER], 1) * pairs.weights[:, None]
    pull = (n * dot(n, r)[:, None] + point_weight * r) * pairs.weights[:, None]
    left = (share[:, :, None] * metric[:, None, :]).view(-1, 36)
    right = (b[:, :, None] * pull[:, None, :]).view(-1, 9)
    return n.new_zeros(num_faces, 45).index_add_(0, pairs.face, torch.cat([left, right], 1))


def _at_verts(connectivity: Connectivity, per_corner: Tensor) -> Tensor:
    """Sum (F, 3, 3) vectors of the corners of faces at each vertex."""
    total = per_corner.new_zeros(connectivity.num_verts, 3)
    for k in range(3):
        total.index_add_(0, connectivity.faces[:, k], per_corner[:, k])
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
