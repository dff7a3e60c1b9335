"""Bootstrap intervals of means, for as few values as there are seeds."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 0.95

# One less than a round number, so that the bounds are themselves means of resamples: the 250th from either end.
_RESAMPLES = 9999
_TAIL = round((_RESAMPLES + 1) * (1 - CONFIDENCE) / 2) - 1


def mean_interval(*samples: Sequence[float]) -> tuple[float, float]:
    """The 95 % interval of a mean, or of the mean of several samples' means, each resampled within itself.

    A resample of n values stays within their range and has the variance (n - 1)/n of theirs, and its quantiles follow
    the normal law where Student's holds: with 2 to 10 values, a plain percentile interval that claims 95 % holds the
    mean of a normal law in 50 % (n = 2), 75 % (3), 84 % (5) and 90 % (10) of all cases. BCa mends the skewness and not
    this; here it does no better. Both faults are known in size (Hesterberg 2015, What teachers should know about the
    bootstrap, sec. 3.2), so the interval is stretched by their product, which brings it to 93 to 96 % for every n.
    With several samples each is stretched for its own variance, and the degrees of freedom of Student's law are those
    of Welch (1947) and Satterthwaite (1946), which holds the mean in 91 to 98 %. Their plain sum counts a sample that
    hardly varies like one that does: it comes to 82 to 84 % for two values each, where the spreads differ tenfold.

    The same samples always give the same interval: the resamples are drawn from fixed seeds.

    Args:
        samples: each of two values or more, which need not be equally many.
    """
    means = [mean_of(sample) for sample in samples]
    centre = sum(means) / len(means)
    if all(min(sample) == max(sample) for sample in samples):
        return centre, centre
    centred = [np.asarray(sample, np.float64) - mean for sample, mean in zip(samples, means, strict=True)]
    apart = np.zeros(_RESAMPLES)
    for stratum, values in enumerate(centred):
        apart += _resampled(values, stratum) * (math.sqrt(len(values) / (len(values) - 1)) / len(samples))
    low, high = np.partition(apart, (_TAIL, -1 - _TAIL))[[_TAIL, -1 - _TAIL]]
    stretch = _student_over_normal(_degrees_of_freedom(centred))
    return centre + stretch * float(low), centre + stretch * float(high)


def mean_of(sample: Sequence[float]) -> float:
    """The mean; of equal values, which rounding could move, their own value."""
    return float(sample[0] if min(sample) == max(sample) else np.mean(sample))


def _resampled(values: NDArray[np.float64], stratum: int) -> NDArray[np.float64]:
    """The means of all resamples."""
    total = np.zeros(_RESAMPLES)
    # Added up one by one, since a product of matrices may be rounded otherwise on another machine.
    for value, times in zip(values, _times_drawn(len(values), stratum), strict=True):
        total += value * times
    return total / len(values)


@lru_cache(maxsize=32)
def _times_drawn(count: int, stratum: int) -> NDArray[np.uint16]:
    """How often each value is in each resample; strata are drawn independently of each other."""
    generator = np.random.default_rng([stratum, count])
    drawn = generator.multinomial(count, np.full(count, 1 / count), size=_RESAMPLES)
    return np.ascontiguousarray(drawn.T, np.uint16)


def _degrees_of_freedom(centred: Sequence[NDArray[np.float64]]) -> float:
    scale = max(float(np.abs(values).max()) for values in centred)
    variances = [float(np.sum((values / scale) ** 2)) / (len(values) - 1) / len(values) for values in centred]
    parts = (variance**2 / (len(values) - 1) for variance, values in zip(variances, centred, strict=True))
    return sum(variances) ** 2 / sum(parts)


@lru_cache(maxsize=1024)
def _student_over_normal(degrees: float) -> float:
    from scipy.special import ndtri, stdtrit

    quantile = (1 + CONFIDENCE) / 2
    return float(stdtrit(degrees, quantile)) / float(ndtri(quantile))


POWER = 0.8
MOST_SEEDS = 10_000

# Power is as good as one beyond this, at any degrees of freedom; farther out, scipy's law returns NaN.
_FARTHEST = 30.0


def seeds_needed(mean: float, spreads: Sequence[float]) -> int | None:
    """The least number of seeds that finds a paired difference significant at 95 % in 80 % of all experiments.

    It takes the difference and spreads that were observed for the true ones, and is the usual planning of a paired t
    test by the noncentral t law (Cohen 1988, Statistical power analysis, ch. 2): the least n ≥ 2 with
    P(T > t(0.975, ν)) ≥ 0.8, where T has ν degrees of freedom and the noncentrality |mean| √n / spread. For a mean over
    several targets with n seeds each, spread is √(Σ s²)/targets, and ν is Welch's.

    Args:
        mean: the difference observed.
        spreads: standard deviations of the paired differences on each target.

    Returns:
        The number; None where it is more than 10,000, or the difference is zero.
    """
    total = sum(spread**2 for spread in spreads)
    if mean == 0:
        return None
    if total == 0:
        return 2
    effect = abs(mean) * len(spreads) / math.sqrt(total)
    degrees = 1 / sum((spread**2 / total) ** 2 for spread in spreads)
    if not _found(effect, degrees, MOST_SEEDS):
        return None
    too_few, enough = 1, MOST_SEEDS
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        too_few, enough = (too_few, middle) if _found(effect, degrees, middle) else (middle, enough)
    return enough


def _found(effect: float, degrees: float, seeds: int) -> bool:
    """Whether so many seeds have the power; an effect's other tail, significant the wrong way round, is left out."""
    from scipy.special import nctdtr, stdtrit

    freedom = degrees * (seeds - 1)
    bound = float(stdtrit(freedom, (1 + CONFIDENCE) / 2))
    return 1 - float(nctdtr(freedom, min(effect * math.sqrt(seeds), _FARTHEST), bound)) >= POWER


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
