"""Differences with their intervals, as lines beside zero: places along one axis, in percent of its width."""

from collections.abc import Sequence
from dataclasses import dataclass

from meshfit.experiment.statistics import PairedDifference

_MARGIN = 4.0


@dataclass(frozen=True)
class Whisker:
    """Where zero, the mean and the ends of the interval are, from 0 to 100."""

    zero: float
    mean: float
    low: float
    high: float


def whiskers(paired: Sequence[PairedDifference]) -> list[Whisker | None]:
    """Where differences lie along one axis that holds all of them, and zero; None for one without an interval."""
    ends = [0.0, *(end for each in paired if each.interval is not None for end in each.interval)]
    least, most = min(ends), max(ends)
    width = (most - least) or 1.0

    def place(value: float) -> float:
        return round(_MARGIN + (100 - 2 * _MARGIN) * (value - least) / width, 2)

    return [
        None
        if each.interval is None
        else Whisker(place(0.0), place(each.mean), place(each.interval[0]), place(each.interval[1]))
        for each in paired
    ]
