"""Which boxes lie near some of them: a grid of cells, and sums over it."""

import torch
from jaxtyping import Bool, Float64
from torch import Tensor

_CELLS = 32


def near_some(
    low: Float64[Tensor, "N 3"], high: Float64[Tensor, "N 3"], some: Bool[Tensor, " N"]
) -> Bool[Tensor, " N"]:
    """Which boxes have a cell, of a grid over all of them, in common with one of `some`: at least those that meet one.

    Args:
        low: float64, the least corners, finite.
        high: float64, the greatest.
        some: which boxes.
    """
    if not bool(some.any()):
        return torch.zeros_like(some)
    floor = low.amin(0)
    width = ((high.amax(0) - floor) / _CELLS).clamp_min(torch.finfo(torch.float64).tiny)
    first, last = (((ends - floor) / width).long().clamp_(0, _CELLS - 1) for ends in (low, high))
    taken = _count(_marked(first[some], last[some]))
    # The number of taken cells within each box, by inclusion and exclusion from sums up to its corners.
    found = torch.zeros(len(low), dtype=torch.int64, device=low.device)
    for corner in range(8):
        upper = [bool(corner >> axis & 1) for axis in range(3)]
        x, y, z = (last[:, axis] + 1 if up else first[:, axis] for axis, up in enumerate(upper))
        found += taken[x, y, z] * (1 if sum(upper) % 2 else -1)
    return found > 0


def _marked(first: Tensor, last: Tensor) -> Tensor:
    """How the number of boxes over a cell changes from cell to cell, of (32 + 1)³."""
    change = torch.zeros((_CELLS + 1,) * 3, dtype=torch.int64, device=first.device)
    one = torch.ones(len(first), dtype=torch.int64, device=first.device)
    for corner in range(8):
        after = [bool(corner >> axis & 1) for axis in range(3)]
        place = tuple(last[:, axis] + 1 if up else first[:, axis] for axis, up in enumerate(after))
        change.index_put_(place, one if sum(after) % 2 == 0 else -one, accumulate=True)
    return change


def _count(change: Tensor) -> Tensor:
    """The number of taken cells before each corner of the grid, along all axes."""
    for axis in range(3):
        change = change.cumsum(axis)
    taken = torch.zeros((_CELLS + 1,) * 3, dtype=torch.int64, device=change.device)
    taken[1:, 1:, 1:] = (change > 0)[:-1, :-1, :-1]
    for axis in range(3):
        taken = taken.cumsum(axis)
    return taken
