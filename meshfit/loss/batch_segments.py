"""Segments of a batch: which rows of a tensor belong to which mesh, and sums over the rows of each."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int64
from torch import Tensor


@dataclass(frozen=True, eq=False)
class BatchSegments:
    """The rows of K meshes in a tensor, one mesh after the other.

    Attributes:
        sizes: number of rows of each of the K meshes.
        counts: (K,) the same as a tensor, at least 1.
        first: (K,) first row of each.
        index: (N,) mesh of each row.
    """

    sizes: tuple[int, ...]
    counts: Int64[Tensor, " K"]
    first: Int64[Tensor, " K"]
    index: Int64[Tensor, " N"]

    @classmethod
    def of(cls, sizes: Sequence[int], device: torch.device) -> "BatchSegments":
        """Return the segments of these sizes."""
        counts = torch.tensor(sizes)
        first, index = counts.cumsum(0) - counts, torch.repeat_interleave(counts)
        return cls(tuple(sizes), counts.clamp_min(1).to(device), first.to(device), index.to(device))

    def parts(self, values: Tensor) -> Sequence[Tensor]:
        """Split a tensor into the rows of each mesh."""
        return torch.split(values, list(self.sizes))

    def sums(self, values: Float[Tensor, " N"]) -> Float[Tensor, " K"]:
        """Return the sum over the rows of each mesh.

        On the CPU each is summed by itself, so that its sum is byte-identical regardless of the rest of the batch.
        """
        if values.device.type == "cpu":
            return torch.stack([part.sum() for part in self.parts(values)])
        return values.new_zeros(len(self.sizes)).index_add(0, self.index, values)

    def means(self, values: Float[Tensor, " N"]) -> Float[Tensor, " K"]:
        """Return the mean over the rows of each mesh."""
        return self.sums(values) / self.counts

    def spread(self, gradient: Float[Tensor, " K"]) -> Float[Tensor, "N 1"] | Float[Tensor, "1 1"]:
        """Return the gradient of `means` with respect to its values, as a column, or as one number if K is 1."""
        share = (gradient / self.counts)[:, None]
        return share if len(self.sizes) == 1 else share.index_select(0, self.index)

    def padded(self, values: Float[Tensor, " N"]) -> Float[Tensor, "K M"]:
        """Return one row per mesh, padded with zeros to the largest."""
        return (
            values.new_zeros(len(self.sizes) * max(self.sizes))
            .index_copy(0, self._slots, values)
            .view(len(self.sizes), -1)
        )

    @cached_property
    def _slots(self) -> Int64[Tensor, " N"]:
        within = torch.arange(len(self.index), device=self.index.device) - self.first[self.index]
        return self.index * max(self.sizes) + within
