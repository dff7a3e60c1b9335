"""The normal equations of a step: sparse, symmetric and positive definite, solved by conjugate gradients."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from meshfit.fitting.gauss_newton.correspondences import Correspondences
from meshfit.fitting.gauss_newton.fairness import Fairness
from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.loss.sparse import Sparse, compressed_rows
from meshfit.remeshing.triangle_geometry import dot

_UPPER = tuple(combinations_with_replacement(range(3), 2))
# Where each entry of a symmetric 3 × 3 matrix is in its upper half.
_FULL = (0, 1, 2, 1, 3, 4, 2, 4, 5)
# The side of a face between two of its corners.
_SIDE = {(0, 1): 0, (1, 2): 1, (0, 2): 2}
_TOLERANCE, _MOST_ITERATIONS = 1e-3, 60


@dataclass(frozen=True, eq=False)
class SparsityPattern:
    """Where the matrix of a connectivity has entries: 3 × 3 blocks for each vertex and for each edge, both ways.

    Attributes:
        connectivity: the faces.
    """

    connectivity: Connectivity

    @cached_property
    def _order(self) -> tuple[Tensor, Tensor, Tensor]:
        """Block rows and columns in the order of rows, and where verts, edges and edges backwards are among them."""
        n, (tail, head) = self.connectivity.num_verts, self.connectivity.ends
        vert = torch.arange(n, device=tail.device)
        rows, columns = torch.cat([vert, tail, head]), torch.cat([vert, head, tail])
        order = (rows * n + columns).argsort()
        place = torch.empty_like(order)
        place[order] = torch.arange(len(order), device=order.device)
        return rows[order], columns[order], place

    @property
    def columns(self) -> Int64[Tensor, " B"]:
        """The block column of each block."""
        return self._order[1]

    @property
    def rows(self) -> Int64[Tensor, " B"]:
        """The block row of each block."""
        return self._order[0]

    @property
    def diagonal(self) -> Int64[Tensor, " V"]:
        """Which blocks are on the diagonal."""
        return self._order[2][: self.connectivity.num_verts]

    @cached_property
    def _scalars(self) -> tuple[Tensor, Tensor, Tensor]:
        """Row starts and columns of the matrix in numbers, and where each number of each block goes."""
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
        """The product with (V, 3) vectors of the matrix of these blocks."""
        starts, columns, place = self._scalars
        values = torch.empty_like(blocks.view(-1))
        values[place] = blocks.reshape(-1)
        matrix = compressed_rows(starts, columns, values, len(starts) - 1)
        return lambda x: (matrix @ x.reshape(-1)).view(-1, 3)

    def blocks(self, per_face: Float[Tensor, "F 6 6"]) -> Float[Tensor, "B 3 3"]:
        """Sums of what faces have for pairs of their corners (upper half) and of coordinates (likewise)."""
        faces, of_side = self.connectivity.faces, self.connectivity.edges.of_side
        n, num_edges = self.connectivity.num_verts, len(self.connectivity.edges.keys)
        total = per_face.new_zeros(len(self.rows), 6)
        for k, (i, j) in enumerate(_UPPER):
            if i == j:
                total.index_add_(0, self.diagonal[faces[:, i]], per_face[:, k])
                continue
            edge = of_side[:, _SIDE[i, j]]
            for start in (n, n + num_edges):
                total.index_add_(0, self._order[2][start + edge], per_face[:, k])
        return total[:, _FULL].view(-1, 3, 3)


@dataclass(frozen=True, eq=False)
class Control:
    """Verts of a control mesh that a surface follows.

    Attributes:
        verts: (C, 3) where they are.
        operator: (V, C) takes them to the surface.
        squares: (V, C) its squared entries.
    """

    verts: Float[Tensor, "C 3"]
    operator: Sparse
    squares: Sparse

    def diagonal(self, blocks: Float[Tensor, "V 3 3"]) -> Float[Tensor, "C 3 3"]:
        """About the diagonal blocks of Sᵀ A S, from those of A; what is off A's diagonal is left out."""
        return torch.stack([self.squares.T @ blocks[:, i] for i in range(3)], 1)


def solve_step(
    shape: Shape,
    pattern: SparsityPattern,
    pairs: Correspondences,
    fairness: Fairness,
    point_weight: float,
    control: Control | None = None,
) -> tuple[Float[Tensor, "V 3"], int]:
    """The step d that minimises Σ w [(n · (B d - r))² + μ |B d - r|²] + fairness of the verts after it.

    B takes verts to the points of the pairs, r are their residuals, n the target's normals.

    Args:
        shape: the surface.
        pattern: of its connectivity.
        pairs: what is to come together.
        fairness: what is to stay smooth.
        point_weight: μ, how much of a residual along the target counts beside the one across it.
        control: if the surface follows a control mesh, that; the step is then of its verts, and so is the fairness.

    Returns:
        (V, 3) the step, (C, 3) with a control mesh, and the number of iterations it took.
    """
    connectivity = shape.connectivity
    table = _table(len(connectivity.faces), pairs, point_weight)
    blocks = pattern.blocks(table[:, :36].view(-1, 6, 6))
    pull, diagonal = _gathered(connectivity, table[:, 36:].view(-1, 3, 3)), blocks[pattern.diagonal]
    times, verts = pattern.times(blocks), shape.verts
    if control is not None:
        operator, fine = control.operator, times
        pull, diagonal, verts = operator.T @ pull, control.diagonal(diagonal), control.verts
        times = lambda x: operator.T @ fine(operator @ x)  # noqa: E731  the other one has no name, either
    eye = torch.eye(3, dtype=blocks.dtype, device=blocks.device)
    diagonal = diagonal + (fairness.diagonal()[:, :, None] + torch.finfo(blocks.dtype).tiny ** 0.5) * eye
    inverse = torch.linalg.inv(diagonal)
    return conjugate_gradients(
        lambda x: times(x) + fairness(x),
        pull - fairness.slope(verts),
        lambda r: (inverse @ r[:, :, None])[:, :, 0],
        _TOLERANCE,
    )


def _table(num_faces: int, pairs: Correspondences, point_weight: float) -> Tensor:
    """Per face, Σ w (b bᵀ) ⊗ (n nᵀ + μ I) in upper halves, and Σ w b ⊗ (n (n · r) + μ r)."""
    n, r, b = pairs.normals, pairs.residuals, pairs.corners
    metric = torch.stack([n[:, i] * n[:, j] + point_weight * (i == j) for i, j in _UPPER], 1)
    share = torch.stack([b[:, i] * b[:, j] for i, j in _UPPER], 1) * pairs.weights[:, None]
    pull = (n * dot(n, r)[:, None] + point_weight * r) * pairs.weights[:, None]
    left = (share[:, :, None] * metric[:, None, :]).view(-1, 36)
    right = (b[:, :, None] * pull[:, None, :]).view(-1, 9)
    return n.new_zeros(num_faces, 45).index_add_(0, pairs.face, torch.cat([left, right], 1))


def _gathered(connectivity: Connectivity, per_corner: Tensor) -> Tensor:
    total = per_corner.new_zeros(connectivity.num_verts, 3)
    for k in range(3):
        total.index_add_(0, connectivity.faces[:, k], per_corner[:, k])
    return total


def conjugate_gradients(
    times: Callable[[Tensor], Tensor],
    right: Float[Tensor, "V 3"],
    precondition: Callable[[Tensor], Tensor],
    tolerance: float,
    most: int = _MOST_ITERATIONS,
) -> tuple[Float[Tensor, "V 3"], int]:
    """Solve A x = b for a symmetric positive definite A, to a residual of so much of b.

    Preconditioned conjugate gradients (Hestenes and Stiefel 1952).

    Args:
        times: the product with A.
        right: b.
        precondition: the product with an approximate inverse of A.
        tolerance: on |b - A x| / |b|.
        most: iterations.
    """
    x, residual = torch.zeros_like(right), right
    if not bool(right.any()):
        return x, 0
    z = precondition(residual)
    direction, slope, limit = z, (residual * z).sum(), tolerance * right.norm()
    for iteration in range(1, most + 1):
        product = times(direction)
        length = slope / (direction * product).sum()
        x, residual = x + length * direction, residual - length * product
        if not residual.norm() > limit:
            return x, iteration
        z = precondition(residual)
        slope, before = (residual * z).sum(), slope
        direction = z + (slope / before) * direction
    return x, most
