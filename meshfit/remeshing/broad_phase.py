"""Which boxes lie near some of them: a grid of cells, and sums over it."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float64, Int32, Int64
from torch import Tensor

_CELLS = 32


def boxes_near(
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


Pairs = tuple[Tensor, Tensor]
Rows = Tensor | slice

_BLOCK = 1 << 20
_STRIDE = 8
# What is laid into columns: boxes over no more than 64 in x or y, 8 entries a box together. Few boxes are left out.
_MOST_COLUMNS = 64
_MOST_ENTRIES = 8
_MOST_WIDE = 0.01
_FAR = float(1 << 40)


def overlapping_boxes(
    low: Float64[Tensor, "N 3"], high: Float64[Tensor, "N 3"], members: Int64[Tensor, " N"]
) -> Iterator[Pairs]:
    """Pairs of boxes of the same member that overlap or touch, in blocks, so that memory stays bounded.

    A box has an entry in each column, of a grid over x and y, that it reaches. The entries of a column, sorted by where
    they begin in z, are compared with the next, with the next but one, and so on until no box reaches that far: sweep
    and prune (Cohen, Lin, Manocha and Ponamgi, I-COLLIDE, 1995). Boxes much wider than a column are compared with all.

    Args:
        low: float64, the least corners, finite.
        high: float64, the greatest.
        members: int64, at least 0.

    Yields:
        Two (P,) int64 tensors, the one box and the other; of each pair in one order only, and seldom more than once.
    """
    if not len(low):
        return
    first, last, wide = _columns(low, high)
    laid = low[:, 2].argsort(stable=True)
    laid = laid[~wide.index_select(0, laid)]
    for i, j in _in_blocks(_Sweep.over(low, high, members, (first, last), laid).pairs()):
        same = members.index_select(0, i) == members.index_select(0, j)
        yield (i, j) if same.all() else (i[same], j[same])
    yield from _with_all(low, high, members, wide)


def _columns(
    low: Float64[Tensor, "N 3"], high: Float64[Tensor, "N 3"]
) -> tuple[Int64[Tensor, "N 2"], Int64[Tensor, "N 2"], Bool[Tensor, " N"]]:
    """The first and last column of each box in x and y, and which boxes are too wide to be laid into columns.

    Columns are twice as wide as the geometric mean of the boxes, and wider where that makes too many entries.
    """
    extents = (high - low).amax(1)
    usual = extents.clamp_min(0.01 * float(extents.median())).log().mean().exp()
    width = 2.0 * float(usual) or float(extents.amax()) or 1.0
    while True:
        # Beyond the clamp columns are one: boxes that overlap still share one, and that is all that is asked of them.
        first, last = ((ends[:, :2] / width).floor().clamp(-_FAR, _FAR) for ends in (low, high))
        spans = last - first + 1
        wide = spans.amax(1) > _MOST_COLUMNS
        entries = float(spans.prod(1).masked_fill(wide, 0).sum())
        if entries <= _MOST_ENTRIES * len(low) and float(wide.sum()) <= _MOST_WIDE * len(low) + 1:
            return first.long(), last.long(), wide
        width *= 1.5


@dataclass(frozen=True, eq=False)
class _Sweep:
    """The entries of all columns, one column after the other, each sorted by where its boxes begin in z.

    Attributes:
        boxes: (E,) the box of each entry.
        columns: (E,) the number of its column. Columns far from each other may have the same one.
        low, high: (E,) in x, y and z, where its box begins and ends.
        leads: (E,) in x and y, whether its column is the first of its box.
    """

    boxes: Int64[Tensor, " E"]
    columns: Int32[Tensor, " E"]
    low: tuple[Tensor, ...]
    high: tuple[Tensor, ...]
    leads: tuple[Tensor, ...]

    @classmethod
    def over(
        cls,
        low: Float64[Tensor, "N 3"],
        high: Float64[Tensor, "N 3"],
        members: Int64[Tensor, " N"],
        columns: tuple[Int64[Tensor, "N 2"], Int64[Tensor, "N 2"]],
        laid: Int64[Tensor, " L"],
    ) -> "_Sweep":
        """The entries of the boxes `laid`, which are sorted by where they begin in z."""
        first, last = (ends.index_select(0, laid) for ends in columns)
        deep, across = (last - first + 1).unbind(1)
        owners = torch.repeat_interleave(deep * across)
        place = torch.arange(len(owners), device=low.device)
        place -= ((deep * across).cumsum(0) - deep * across).index_select(0, owners)
        across = across.index_select(0, owners)
        x = place.div(across, rounding_mode="floor")
        y = place - x * across
        leads = x == 0, y == 0
        owned, x0, y0 = (values.index_select(0, owners) for values in (laid, *first.unbind(1)))
        numbers = (members.index_select(0, owned) & 0x1FF) << 22 | (x + x0 & 0x7FF) << 11 | y + y0 & 0x7FF
        sorting = numbers.int().sort(stable=True)
        boxes = owned.index_select(0, sorting.indices)
        begin, end = (tuple(row.index_select(0, boxes) for row in ends.T.contiguous()) for ends in (low, high))
        leading = tuple(lead.index_select(0, sorting.indices) for lead in leads)
        return cls(boxes, sorting.values, begin, end, leading)

    def pairs(self) -> Iterator[Pairs]:
        """Pairs of boxes that overlap; of the columns that two share, the one counts where the later begins."""
        size = len(self.boxes)
        reached, ahead = self.boxes >= 0, 0
        while 4 * int(reached.sum()) > size > ahead + 1:
            ahead += 1
            i, j = slice(0, size - ahead), slice(ahead, size)
            reached = self._reach(i, j)
            found = (reached & self._overlap(i, j)).nonzero()[:, 0]
            yield self.boxes.index_select(0, found), self.boxes.index_select(0, found + ahead)
        yield from self._further(reached.nonzero()[:, 0], ahead + 1)

    def _further(self, rows: Int64[Tensor, " R"], ahead: int) -> Iterator[Pairs]:
        """Pairs of some entries with those that far ahead or further: few, picked one by one, but several at a time."""
        size = len(self.boxes)
        strides = torch.arange(_STRIDE, device=rows.device)
        while len(rows) and ahead < size:
            i, j = rows.repeat_interleave(_STRIDE), (rows[:, None] + (ahead + strides)).view(-1)
            reached = self._reach(i, j.clamp_max(size - 1)) & (j < size)
            seen = reached.nonzero()[:, 0]
            i, j = _at(i, seen), _at(j, seen)
            found = self._overlap(i, j).nonzero()[:, 0]
            yield _at(self.boxes, _at(i, found)), _at(self.boxes, _at(j, found))
            rows, ahead = rows[reached.view(-1, _STRIDE)[:, -1]], ahead + _STRIDE

    def _reach(self, i: Rows, j: Rows) -> Bool[Tensor, " P"]:
        """Whether later entries j are in the columns of i and begin, in z, before these end."""
        return (_at(self.columns, i) == _at(self.columns, j)) & (_at(self.low[2], j) <= _at(self.high[2], i))

    def _overlap(self, i: Rows, j: Rows) -> Bool[Tensor, " P"]:
        """Whether entries that overlap in z do so in x and y, and in the column that counts."""
        tests = [
            (_at(low, j) <= _at(high, i)) & (_at(low, i) <= _at(high, j)) & (_at(leads, i) | _at(leads, j))
            for low, high, leads in zip(self.low[:2], self.high[:2], self.leads, strict=True)
        ]
        return tests[0] & tests[1]


def _with_all(
    low: Float64[Tensor, "N 3"], high: Float64[Tensor, "N 3"], members: Int64[Tensor, " N"], wide: Bool[Tensor, " N"]
) -> Iterator[Pairs]:
    """Pairs of which a box is wide, by comparing the wide ones with all."""
    everyone = torch.arange(len(low), device=low.device)
    rows, size = wide.nonzero()[:, 0], max(1, _BLOCK // len(low))
    for start in range(0, len(rows), size):
        some = rows[start : start + size]
        here = some[:, None]
        meet = (members[here] == members) & ~(wide & (everyone <= here))
        for k in range(3):
            meet &= (low[:, k] <= high[here, k]) & (low[here, k] <= high[:, k])
        i, j = meet.nonzero().unbind(1)
        yield some[i], j


def _in_blocks(pairs: Iterator[Pairs]) -> Iterator[Pairs]:
    """The same pairs in fewer and larger blocks."""
    held: list[Pairs] = []
    for some in pairs:
        held.append(some)
        if sum(len(i) for i, _ in held) > _BLOCK:
            yield _joined(held)
            held = []
    if held:
        yield _joined(held)


def _joined(held: list[Pairs]) -> Pairs:
    return torch.cat([i for i, _ in held]), torch.cat([j for _, j in held])


def _at(values: Tensor, rows: Rows) -> Tensor:
    return values[rows] if isinstance(rows, slice) else values.index_select(0, rows)
