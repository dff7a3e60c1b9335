"""Length of the Laplacian of the vertex positions, with uniform or cotangent weights."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import Function, once_differentiable

from meshfit.loss.autograd import apply
from meshfit.loss.batch_segments import BatchSegments
from meshfit.loss.operators import LEAST_DOUBLE_AREA, FaceGeometry, MeshOperators


def laplacian_uniform(edges: Float[Tensor, "E 3"], operators: MeshOperators) -> Float[Tensor, " K"]:
    """Return the mean distance of vertices from the mean of their neighbours (Desbrun et al. 1999, umbrella operator).

    A vertex without neighbours counts as 0. Differences are summed, since sums of positions lose digits.

    Args:
        edges: (E, 3) `operators.edges @ verts`.
        operators: of the meshes.
    """
    return apply(_MeanLength, operators.umbrella @ edges, operators.of_vert)


def laplacian_cotangent(verts: Float[Tensor, "V 3"], operators: MeshOperators) -> Float[Tensor, " K"]:
    """Return the mean distance of vertices from the cotangent-weighted mean of their neighbours (Desbrun et al. 1999).

    The weights are constant in the backward pass. As in PyTorch3D, they are not normalised unless their sum is
    positive. A vertex without neighbours counts as 0.
    """
    with torch.no_grad():
        cotangents = corner_cotangents(verts, operators).reshape(-1)
        # The cotangent at corner k is the weight of the opposite edge, of corners k+1 and k+2.
        start, end = (operators.faces.verts.roll(-shift, 1).reshape(-1) for shift in (1, 2))
        total = torch.zeros_like(verts[:, 0]).index_add(0, start, cotangents).index_add(0, end, cotangents)
        scale = torch.where(total > 0, 1 / total, total)[:, None]
    weight = cotangents[:, None]
    sums = torch.zeros_like(verts).index_add(0, start, weight * verts.index_select(0, end))
    sums = sums.index_add(0, end, weight * verts.index_select(0, start))
    return apply(_MeanLength, scale * sums - operators.has_edges * verts, operators.of_vert)


def corner_cotangents(verts: Float[Tensor, "V 3"], operators: MeshOperators) -> Float[Tensor, "F 3"]:
    """Return the cotangent of the angle at each corner of each face."""
    corners = verts.index_select(0, operators.faces.verts.reshape(-1)).reshape(-1, 3, 3)
    ahead, behind = corners.roll(-1, 1) - corners, corners.roll(1, 1) - corners
    double_area = FaceGeometry.of(operators.faces, verts).double_area
    cotangents: Tensor = (ahead * behind).sum(2) / double_area.clamp_min(LEAST_DOUBLE_AREA)[:, None]
    return cotangents


class _MeanLength(Function):
    """The gradient of a length is the unit vector; 0 where the length is 0."""

    @staticmethod
    def forward(ctx: Any, vectors: Tensor, segments: BatchSegments) -> Tensor:  # noqa: ANN401  torch's context
        lengths = vectors.square().sum(1).sqrt()
        ctx.save_for_backward(vectors, lengths)
        ctx.segments = segments
        return segments.means(lengths)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:  # noqa: ANN401  torch's context
        vectors, lengths = ctx.saved_tensors
        units = vectors / lengths.clamp_min(torch.finfo(lengths.dtype).tiny)[:, None]
        return units * ctx.segments.spread(gradient), None
