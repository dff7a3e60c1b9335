"""Differentiable sampling of surfaces, uniform by area."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Generator, Tensor
from torch.autograd.function import Function, once_differentiable
from torch.nn.functional import embedding_bag

from meshfit.loss.autograd import apply
from meshfit.loss.batch_segments import BatchSegments
from meshfit.loss.operators import FaceGeometry
from meshfit.loss.terms import Samples


@dataclass(frozen=True, eq=False)
class AreaTable:
    """Cumulative face areas of each mesh of a batch, by which faces are picked in proportion to their area."""

    sums: tuple[np.ndarray, ...] | Tensor
    segments: BatchSegments

    @classmethod
    def of(cls, geometry: FaceGeometry) -> "AreaTable":
        """Return the table of the faces at their current positions."""
        area, segments = geometry.double_area, geometry.faces.segments
        if area.device.type == "cpu":
            return cls(tuple(part.cumsum(0).numpy() for part in segments.parts(area)), segments)
        return cls(segments.padded(area).cumsum(1), segments)

    def pick(self, uniform: Float[Tensor, "K N"]) -> Int64[Tensor, " KN"]:
        """Return the face that each number from 0 to 1 falls on, N numbers per mesh."""
        if isinstance(self.sums, Tensor):
            place = torch.searchsorted(self.sums, uniform * self.sums[:, -1:], right=True)
            return (place.minimum(self.segments.counts[:, None] - 1) + self.segments.first[:, None]).view(-1)
        # numpy's search starts from the last place found, which halves its time for sorted numbers; torch's does not.
        picked, first = [], 0
        for sums, numbers in zip(self.sums, uniform.numpy(), strict=True):
            picked.append(np.minimum(sums.searchsorted(numbers * sums[-1], "right"), len(sums) - 1) + first)
            first += len(sums)
        return torch.from_numpy(np.concatenate(picked))


def sample(
    geometry: FaceGeometry, count: int, generators: Sequence[Generator], table: AreaTable | None = None
) -> Samples:
    """Draw points uniformly by area; gradients treat each as a fixed convex combination of its face's corners.

    Args:
        geometry: the faces of K meshes at their current positions.
        count: N, the number of points per mesh.
        generators: one per mesh, on the same device; each is advanced by exactly 3 N numbers.
        table: the cumulative areas, if known.
    """
    with torch.no_grad():
        picked, weights = _draw(table or AreaTable.of(geometry), count, generators, geometry.double_area)
        corners = geometry.faces.verts.index_select(0, picked)
    return Samples(apply(_Points, geometry.verts, corners, weights), picked, geometry)


def _draw(table: AreaTable, count: int, generators: Sequence[Generator], like: Tensor) -> tuple[Tensor, Tensor]:
    """Draw faces, (K N,), and weights of their corners, (K N, 3), by the square-root map (Osada et al. 2002, eq. 1).

    The numbers are drawn in single precision whatever the dtype, so that one seed gives the same samples in both.
    """
    uniform = like.new_empty(len(generators), 3, count, dtype=torch.float32)
    for numbers, generator in zip(uniform, generators, strict=True):
        numbers.uniform_(generator=generator)
    if like.device.type == "cpu":
        # The order of the faces does not change the distribution, and k-d trees answer neighbouring queries faster.
        uniform[:, 0].numpy().sort(axis=1)
    uniform = uniform.to(like.dtype)
    root = uniform[:, 1].sqrt()
    third = root * uniform[:, 2]
    return table.pick(uniform[:, 0]), torch.stack([1 - root, root - third, third], 2).view(-1, 3)


class _Points(Function):
    """Weighted sums of three vertices each."""

    @staticmethod
    def forward(ctx: Any, verts: Tensor, corners: Tensor, weights: Tensor) -> Tensor:  # noqa: ANN401  torch's context
        ctx.save_for_backward(corners, weights)
        ctx.num_verts = len(verts)
        if verts.device.type == "cpu":
            return embedding_bag(corners, verts.detach(), per_sample_weights=weights, mode="sum")
        return (weights[:, :, None] * verts[corners]).sum(1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:  # noqa: ANN401  torch's context
        corners, weights = ctx.saved_tensors
        at_verts = gradient.new_zeros(ctx.num_verts, 3)
        for corner, weight in zip(corners.unbind(1), weights.split(1, dim=1), strict=True):
            at_verts.index_add_(0, corner, weight * gradient)
        return at_verts, None, None
