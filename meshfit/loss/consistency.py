"""The bend between neighbouring faces."""

from typing import Any

from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import Function, once_differentiable

from meshfit.loss.autograd import apply
from meshfit.loss.operators import FaceGeometry, MeshOperators


def consistency(faces: FaceGeometry, surface: MeshOperators) -> Float[Tensor, " K"]:
    """Mean over pairs of faces with a common edge of 1 - cos of the angle between their normals; 0 on a plane.

    It is 0, too, where no two faces have a common edge.
    """
    value: Tensor = apply(_Bend, faces.normals, surface)
    return value


class _Bend(Function):
    """The mean of cos over P pairs is Σ n·s / 2P, where s is the sum of the normals across a face's edges.

    Each pair is seen from both of its faces, and neighbours are so mutually; so its gradient is s / P.
    """

    @staticmethod
    def forward(ctx: Any, normals: Tensor, surface: MeshOperators) -> Tensor:  # noqa: ANN401  torch's context
        across = surface.neighbours @ normals
        ctx.save_for_backward(across)
        ctx.surface = surface
        cosines = (normals * across).sum(1)
        return surface.faces.segments.sums(surface.valence_of_face - cosines) / (2 * surface.face_pairs)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:  # noqa: ANN401  likewise
        (across,), segments = ctx.saved_tensors, ctx.surface.faces.segments
        return across * segments.spread(-gradient / ctx.surface.face_pairs * segments.counts), None
