"""Consistency of the normals of adjacent faces."""

from typing import Any

from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import Function, once_differentiable

from meshfit.loss.autograd import apply
from meshfit.loss.operators import FaceGeometry, MeshOperators


def consistency(faces: FaceGeometry, operators: MeshOperators) -> Float[Tensor, " K"]:
    """Return the mean of 1 - cos of the angle between the normals of adjacent faces; 0 if there are none."""
    return apply(_Bend, faces.normals, operators)


class _Bend(Function):
    """The mean of cos over P pairs is Σ n·s / 2P, with s the sum of the normals of a face's neighbours.

    Being neighbours is symmetric, so its gradient is s / P.
    """

    @staticmethod
    def forward(ctx: Any, normals: Tensor, operators: MeshOperators) -> Tensor:  # noqa: ANN401  torch's context
        sums = operators.neighbours @ normals
        ctx.save_for_backward(sums)
        ctx.operators = operators
        cosines = (normals * sums).sum(1)
        return operators.faces.segments.sums(operators.valence_of_face - cosines) / (2 * operators.face_pairs)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:  # noqa: ANN401  torch's context
        (sums,), segments = ctx.saved_tensors, ctx.operators.faces.segments
        return sums * segments.spread(-gradient / ctx.operators.face_pairs * segments.counts), None
