"""Statistics over seeds: what a table cell states, and whether two schemes differ by more than their seeds do."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshfit.experiment.bootstrap import mean_interval, mean_of
from meshfit.experiment.power import seeds_needed

BySeed = Mapping[int, float]
_Pairs = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Summary:
    """The values of one cell, one for each seed, in short.

    Attributes:
        mean: their mean.
        spread: their sample standard deviation; None for a single value.
        median: their median.
        interval: 95 % bootstrap interval of the mean, low and high; None for a single value.
        count: how many there are.
        values: the values themselves.
    """

    mean: float
    spread: float | None
    median: float
    interval: tuple[float, float] | None
    count: int
    values: tuple[float, ...]


@dataclass(frozen=True)
class PairedDifference:
    """A mean difference of two samples, paired by seed; or the mean of such differences over several targets.

    Attributes:
        mean: mean of the differences, the first sample minus the second.
        interval: its 95 % bootstrap interval, low and high; None where a target has a single pair.
        count: how many seeds both samples have; over several targets, the fewest.
        improvement: probability of improvement, that a run of the first is better than one of the second; None where
            neither direction is better.
        seeds_needed: how many seeds find a difference of this size and spread significant, in 80 % of all experiments;
            None without an interval, without a difference, or where 10,000 are too few.
        targets: how many targets it is the mean over.
    """

    mean: float
    interval: tuple[float, float] | None
    count: int
    improvement: float | None = None
    seeds_needed: int | None = None
    targets: int = 1

    @property
    def significant(self) -> bool | None:
        """Whether the interval leaves out zero; None where there is none."""
        if self.interval is None:
            return None
        low, high = self.interval
        return not low <= 0 <= high


def summarise(values: Sequence[float]) -> Summary:
    """Mean, spread, median and interval of at least one value."""
    if not values:
        raise ValueError("a summary needs at least one value")
    several = len(values) > 1
    return Summary(
        mean=mean_of(values),
        spread=_spread(values) if several else None,
        median=float(np.median(values)),
        interval=mean_interval(values) if several else None,
        count=len(values),
        values=tuple(map(float, values)),
    )


def median_seed(sample: BySeed) -> int:
    """The seed of the median; of two in the middle, that of the lower."""
    ranked = sorted(sample, key=lambda seed: (sample[seed], seed))
    return ranked[(len(ranked) - 1) // 2]


def paired_difference(first: BySeed, second: BySeed, *, smaller_is_better: bool | None = None) -> PairedDifference:
    """The mean difference of two samples over the seeds that both have.

    Args:
        first: values by seed.
        second: values by seed; at least one seed is also in `first`.
        smaller_is_better: which direction is the better one; None where neither is.
    """
    return mean_difference([(first, second)], smaller_is_better=smaller_is_better)


def mean_difference(
    samples: Sequence[tuple[BySeed, BySeed]], *, smaller_is_better: bool | None = None
) -> PairedDifference:
    """The mean over targets of their mean differences, each over the seeds that both samples have.

    Targets count alike, and are taken as given: the interval is for other seeds on the same targets, so that seeds are
    resampled within each target, and targets are not.

    Args:
        samples: on each target, the two samples by seed; they have at least one seed in common.
        smaller_is_better: which direction is the better one; None where neither is.
    """
    if not samples:
        raise ValueError("a difference needs at least one target")
    pairs = [_pairs(first, second) for first, second in samples]
    differences = [(first - second).tolist() for first, second in pairs]
    mean = sum(map(mean_of, differences)) / len(differences)
    count = min(map(len, differences))
    several = count > 1
    return PairedDifference(
        mean=mean,
        interval=mean_interval(*differences) if several else None,
        count=count,
        improvement=None if smaller_is_better is None else _improvement(pairs, smaller_is_better=smaller_is_better),
        seeds_needed=seeds_needed(mean, list(map(_spread, differences))) if several else None,
        targets=len(samples),
    )


def differ(first: BySeed, second: BySeed) -> bool:
    """Whether two samples differ significantly over the seeds that both have; without two such seeds, they do not."""
    common = sorted(first.keys() & second.keys())
    if len(common) < 2:
        return False
    low, high = mean_interval([first[seed] - second[seed] for seed in common])
    return not low <= 0 <= high


def _pairs(first: BySeed, second: BySeed) -> _Pairs:
    seeds = sorted(first.keys() & second.keys())
    if not seeds:
        raise ValueError("the samples have no seed in common")
    return np.array([first[seed] for seed in seeds], float), np.array([second[seed] for seed in seeds], float)


def _spread(values: Sequence[float]) -> float:
    # Equal values have no spread, even where their mean is rounded.
    return 0.0 if min(values) == max(values) else float(np.std(values, ddof=1))


def _improvement(pairs: Sequence[_Pairs], *, smaller_is_better: bool) -> float:
    """The mean over targets of the probability that a run of the first is better than one of the second.

    It is the share of all pairs of runs, of whatever seeds, in which it is; equal ones count a half (Agarwal et al.
    2021, Deep reinforcement learning at the edge of the statistical precipice, sec. 4.3).
    """
    shares = []
    for first, second in pairs:
        ordered = np.sort(second)
        below = (np.searchsorted(ordered, first, "left") + np.searchsorted(ordered, first, "right")) / 2
        larger = float(np.mean(below)) / len(second)
        shares.append(1 - larger if smaller_is_better else larger)
    return sum(shares) / len(shares)
