"""Squared length of edges."""

from typing import Any

from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import Function, once_differentiable

from meshfit.loss.autograd import apply
from meshfit.loss.batch_segments import BatchSegments
from meshfit.loss.operators import MeshOperators


def edge(edges: Float[Tensor, "E 3"], operators: MeshOperators) -> Float[Tensor, " K"]:
    """Return the mean squared length of edges (Gkioxari, Malik and Johnson 2019).

    Args:
        edges: (E, 3) `operators.edges @ verts`.
        operators: of the meshes.
    """
    return apply(_MeanSquare, edges, operators.of_edge)


class _MeanSquare(Function):
    @staticmethod
    def forward(ctx: Any, vectors: Tensor, segments: BatchSegments) -> Tensor:  # noqa: ANN401  torch's context
        ctx.save_for_backward(vectors)
        ctx.segments = segments
        return segments.means(vectors.square().sum(1))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:  # noqa: ANN401  torch's context
        (vectors,) = ctx.saved_tensors
        return vectors * ctx.segments.spread(2 * gradient), None
