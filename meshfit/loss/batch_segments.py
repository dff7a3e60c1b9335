"""Several meshes side by side: which rows of a tensor belong to which of them, and sums over each one's rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int64
from torch import Tensor


@dataclass(frozen=True, eq=False)
class BatchSegments:
    """The rows of the segments of a batch, one member after the other.

    Attributes:
        sizes: the number of rows of each of the K segments.
        counts: (K,) the same as a tensor, at least 1.
        first: (K,) the row that each begins at.
        index: (N,) the member of each row.
    """

    sizes: tuple[int, ...]
    counts: Int64[Tensor, " K"]
    first: Int64[Tensor, " K"]
    index: Int64[Tensor, " N"]

    @classmethod
    def of(cls, sizes: Sequence[int], device: torch.device) -> "BatchSegments":
        """Members of so many rows each."""
        counts = torch.tensor(sizes)
        first, index = counts.cumsum(0) - counts, torch.repeat_interleave(counts)
        return cls(tuple(sizes), counts.clamp_min(1).to(device), first.to(device), index.to(device))

    def parts(self, values: Tensor) -> Sequence[Tensor]:
        """The rows of each member."""
        return torch.split(values, list(self.sizes))

    def sums(self, values: Float[Tensor, " N"]) -> Float[Tensor, " K"]:
        """The sum over the rows of each member.

        On the CPU every member is summed by itself, so that its sum has the same bytes in any company.
        """
        if values.device.type == "cpu":
            return torch.stack([part.sum() for part in self.parts(values)])
        return values.new_zeros(len(self.sizes)).index_add(0, self.index, values)

    def means(self, values: Float[Tensor, " N"]) -> Float[Tensor, " K"]:
        """The mean over the rows of each member."""
        return self.sums(values) / self.counts

    def spread(self, gradient: Float[Tensor, " K"]) -> Float[Tensor, "N 1"] | Float[Tensor, "1 1"]:
        """The gradient of `means` with respect to its values, as a column: one number for all where K is 1."""
        share = (gradient / self.counts)[:, None]
        return share if len(self.sizes) == 1 else share.index_select(0, self.index)

    def padded(self, values: Float[Tensor, " N"]) -> Float[Tensor, "K M"]:
        """A row for each member, with zeros after the end of all but the largest."""
        return (
            values.new_zeros(len(self.sizes) * max(self.sizes))
            .index_copy(0, self._slots, values)
            .view(len(self.sizes), -1)
        )

    @cached_property
    def _slots(self) -> Int64[Tensor, " N"]:
        within = torch.arange(len(self.index), device=self.index.device) - self.first[self.index]
        return self.index * max(self.sizes) + within
