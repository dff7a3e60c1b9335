"""Broad phase of intersection tests: pairs of overlapping boxes, and boxes near some of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Bool, Float64, Int32, Int64
from torch import Tensor

Pairs = tuple[Tensor, Tensor]
Rows = Tensor | slice

_BLOCK = 1 << 20
_STRIDE = 8
# Limits of the grid: columns per box in x or y, entries per box on average, and the share of boxes that are wider.
_MOST_COLUMNS = 64
_MOST_ENTRIES = 8
_MOST_WIDE = 0.01
_FAR = float(1 << 40)
# Cells per axis of the grid of `boxes_near`.
_CELLS = 32


def overlapping_boxes(
    low: Float64[Tensor, "N 3"], high: Float64[Tensor, "N 3"], members: Int64[Tensor, " N"]
) -> Iterator[Pairs]:
    """Yield pairs of boxes of the same mesh that overlap or touch, in blocks, so that memory stays bounded.

    A box has an entry in each column of an x-y grid that it reaches. The entries of a column, sorted by their start in
    z, are compared with the next entry, the next but one, and so on, until no box reaches that far: sweep and prune
    (Cohen, Lin, Manocha and Ponamgi, I-COLLIDE, 1995). Boxes much wider than a column are compared with all.

    Args:
        low: (N, 3) float64, least corners, finite.
        high: (N, 3) float64, greatest corners.
        members: (N,) int64, at least 0: mesh of each box.

    Yields:
        Two (P,) int64 tensors of boxes; each pair in one order only, and seldom more than once.
    """
    if not len(low):
        return
    first, last, wide = _columns(low, high)
    narrow = low[:, 2].argsort(stable=True)
    narrow = narrow[~wide.index_select(0, narrow)]
    for i, j in _in_blocks(_Sweep.over(low, high, members, (first, last), narrow).pairs()):
        same = members.index_select(0, i) == members.index_select(0, j)
        yield (i, j) if same.all() else (i[same], j[same])
    yield from _with_all(low, high, members, wide)


def _columns(
    low: Float64[Tensor, "N 3"], high: Float64[Tensor, "N 3"]
) -> tuple[Int64[Tensor, "N 2"], Int64[Tensor, "N 2"], Bool[Tensor, " N"]]:
    """Return the first and last column of each box in x and y, and which boxes are too wide for columns.

    Columns are twice as wide as the geometric mean of the boxes, and wider if that gives too many entries.
    """
    extents = (high - low).amax(1)
    usual = extents.clamp_min(0.01 * float(extents.median())).log().mean().exp()
    width = 2.0 * float(usual) or float(extents.amax()) or 1.0
    while True:
        # All columns beyond the clamp are one; boxes that overlap still share it.
        first, last = ((ends[:, :2] / width).floor().clamp(-_FAR, _FAR) for ends in (low, high))
        spans = last - first + 1
        wide = spans.amax(1) > _MOST_COLUMNS
        entries = float(spans.prod(1).masked_fill(wide, 0).sum())
        if entries <= _MOST_ENTRIES * len(low) and float(wide.sum()) <= _MOST_WIDE * len(low) + 1:
            return first.long(), last.long(), wide
        width *= 1.5


@dataclass(frozen=True, eq=False)
class _Sweep:
    """The entries of all columns, column by column, sorted by the start of their boxes in z.

    Attributes:
        boxes: (E,) box of each entry.
        columns: (E,) number of its column; distant columns may have the same number.
        low, high: (E,) for x, y and z: start and end of its box.
        leads: (E,) for x and y: whether its column is the first of its box.
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
        narrow: Int64[Tensor, " L"],
    ) -> "_Sweep":
        """Return the entries of the boxes `narrow`, which are sorted by their start in z."""
        first, last = (ends.index_select(0, narrow) for ends in columns)
        deep, across = (last - first + 1).unbind(1)
        owners = torch.repeat_interleave(deep * across)
        place = torch.arange(len(owners), device=low.device)
        place -= ((deep * across).cumsum(0) - deep * across).index_select(0, owners)
        across = across.index_select(0, owners)
        x = place.div(across, rounding_mode="floor")
        y = place - x * across
        leads = x == 0, y == 0
        owned, x0, y0 = (values.index_select(0, owners) for values in (narrow, *first.unbind(1)))
        numbers = (members.index_select(0, owned) & 0x1FF) << 22 | (x + x0 & 0x7FF) << 11 | y + y0 & 0x7FF
        sorting = numbers.int().sort(stable=True)
        boxes = owned.index_select(0, sorting.indices)
        begin, end = (tuple(row.index_select(0, boxes) for row in ends.T.contiguous()) for ends in (low, high))
        leading = tuple(lead.index_select(0, sorting.indices) for lead in leads)
        return cls(boxes, sorting.values, begin, end, leading)

    def pairs(self) -> Iterator[Pairs]:
        """Yield pairs of boxes that overlap, in the common column where the later one starts."""
        size = len(self.boxes)
        reached, ahead = self.boxes >= 0, 0
        while 4 * int(reached.sum()) > size > ahead + 1:
            ahead += 1
            i, j = slice(0, size - ahead), slice(ahead, size)
            reached = self._reach(i, j)
            which = (reached & self._overlap(i, j)).nonzero()[:, 0]
            yield self.boxes.index_select(0, which), self.boxes.index_select(0, which + ahead)
        yield from self._further(reached.nonzero()[:, 0], ahead + 1)

    def _further(self, rows: Int64[Tensor, " R"], ahead: int) -> Iterator[Pairs]:
        """Yield pairs of a few entries with those that far ahead or further, several distances at a time."""
        size = len(self.boxes)
        strides = torch.arange(_STRIDE, device=rows.device)
        while len(rows) and ahead < size:
            i, j = rows.repeat_interleave(_STRIDE), (rows[:, None] + (ahead + strides)).view(-1)
            reached = self._reach(i, j.clamp_max(size - 1)) & (j < size)
            which = reached.nonzero()[:, 0]
            i, j = _at(i, which), _at(j, which)
            which = self._overlap(i, j).nonzero()[:, 0]
            yield _at(self.boxes, _at(i, which)), _at(self.boxes, _at(j, which))
            rows, ahead = rows[reached.view(-1, _STRIDE)[:, -1]], ahead + _STRIDE

    def _reach(self, i: Rows, j: Rows) -> Bool[Tensor, " P"]:
        """Return whether later entries j are in the columns of i and start, in z, before these end."""
        return (_at(self.columns, i) == _at(self.columns, j)) & (_at(self.low[2], j) <= _at(self.high[2], i))

    def _overlap(self, i: Rows, j: Rows) -> Bool[Tensor, " P"]:
        """Return whether entries that overlap in z also do in x and y, in the column that counts."""
        tests = [
            (_at(low, j) <= _at(high, i)) & (_at(low, i) <= _at(high, j)) & (_at(leads, i) | _at(leads, j))
            for low, high, leads in zip(self.low[:2], self.high[:2], self.leads, strict=True)
        ]
        return tests[0] & tests[1]


def _with_all(
    low: Float64[Tensor, "N 3"], high: Float64[Tensor, "N 3"], members: Int64[Tensor, " N"], wide: Bool[Tensor, " N"]
) -> Iterator[Pairs]:
    """Yield pairs with a wide box, by comparing the wide ones with all."""
    numbers = torch.arange(len(low), device=low.device)
    rows, size = wide.nonzero()[:, 0], max(1, _BLOCK // len(low))
    for start in range(0, len(rows), size):
        block = rows[start : start + size]
        column = block[:, None]
        meet = (members[column] == members) & ~(wide & (numbers <= column))
        for k in range(3):
            meet &= (low[:, k] <= high[column, k]) & (low[column, k] <= high[:, k])
        i, j = meet.nonzero().unbind(1)
        yield block[i], j


def _in_blocks(pairs: Iterator[Pairs]) -> Iterator[Pairs]:
    """Yield the same pairs in fewer and larger blocks."""
    blocks: list[Pairs] = []
    for block in pairs:
        blocks.append(block)
        if sum(len(i) for i, _ in blocks) > _BLOCK:
            yield _joined(blocks)
            blocks = []
    if blocks:
        yield _joined(blocks)


def _joined(blocks: list[Pairs]) -> Pairs:
    return torch.cat([i for i, _ in blocks]), torch.cat([j for _, j in blocks])


def _at(values: Tensor, rows: Rows) -> Tensor:
    return values[rows] if isinstance(rows, slice) else values.index_select(0, rows)


def boxes_near(
    low: Float64[Tensor, "N 3"], high: Float64[Tensor, "N 3"], some: Bool[Tensor, " N"]
) -> Bool[Tensor, " N"]:
    """Return which boxes share a cell, of a grid over all of them, with one of `some`; these include all that meet one.

    Args:
        low: (N, 3) float64, least corners, finite.
        high: (N, 3) float64, greatest corners.
        some: (N,) which boxes.
    """
    if not bool(some.any()):
        return torch.zeros_like(some)
    floor = low.amin(0)
    width = ((high.amax(0) - floor) / _CELLS).clamp_min(torch.finfo(torch.float64).tiny)
    first, last = (((ends - floor) / width).long().clamp_(0, _CELLS - 1) for ends in (low, high))
    occupied = _cumulative(_marked(first[some], last[some]))
    # Number of occupied cells within each box, by inclusion and exclusion of sums up to its corners.
    count = torch.zeros(len(low), dtype=torch.int64, device=low.device)
    for place, sign in _signed_corners(first, last):
        count -= occupied[place] * sign
    return count > 0


def _marked(first: Tensor, last: Tensor) -> Tensor:
    """Return the change, from cell to cell, of the number of boxes over a cell, (32 + 1)³."""
    change = torch.zeros((_CELLS + 1,) * 3, dtype=torch.int64, device=first.device)
    for place, sign in _signed_corners(first, last):
        change.index_put_(place, torch.full_like(place[0], sign), accumulate=True)
    return change


def _signed_corners(first: Tensor, last: Tensor) -> Iterator[tuple[tuple[Tensor, ...], int]]:
    """Yield the 8 corners of boxes of cells, with the signs of inclusion and exclusion: 1 for the first corner."""
    for after in product((False, True), repeat=3):
        place = tuple(last[:, axis] + 1 if up else first[:, axis] for axis, up in enumerate(after))
        yield place, -1 if sum(after) % 2 else 1


def _cumulative(change: Tensor) -> Tensor:
    """Return the number of occupied cells before each corner of the grid, along all axes."""
    for axis in range(3):
        change = change.cumsum(axis)
    occupied = torch.zeros((_CELLS + 1,) * 3, dtype=torch.int64, device=change.device)
    occupied[1:, 1:, 1:] = (change > 0)[:-1, :-1, :-1]
    for axis in range(3):
        occupied = occupied.cumsum(axis)
    return occupied
