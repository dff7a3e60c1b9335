"""Statistics over seeds: t intervals, paired differences, probability of improvement, and seeds needed."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 0.95
POWER = 0.8
MOST_SEEDS = 10_000

# The power is 1 beyond this noncentrality, at any degrees of freedom; farther out, scipy returns NaN.
_MAX_NONCENTRALITY = 30.0

BySeed = Mapping[int, float]
"""The values of a sample by seed."""
_Pairs = tuple[NDArray[np.float64], NDArray[np.float64]]


def mean_interval(*samples: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % confidence interval of a mean, or of the mean of several samples' means.

    It is Student's t interval; for several samples with the degrees of freedom of Welch (1947) and Satterthwaite
    (1946), so that a sample that hardly varies counts little. For normal values, its coverage is 95 % for one sample
    and 92 to 98 % for several.

    Args:
        samples: samples of at least two values each, not necessarily of the same size.
    """
    means = [mean_of(sample) for sample in samples]
    centre = sum(means) / len(means)
    deviations = [np.asarray(sample, np.float64) - mean for sample, mean in zip(samples, means, strict=True)]
    scale = max(float(np.abs(values).max()) for values in deviations)
    if scale == 0:
        return centre, centre
    # Variances of the means, in units of the largest deviation, so that they neither overflow nor underflow.
    variances = [float(np.sum((values / scale) ** 2)) / (len(values) - 1) / len(values) for values in deviations]
    squares = (variance**2 / (len(values) - 1) for variance, values in zip(variances, deviations, strict=True))
    degrees = sum(variances) ** 2 / sum(squares)
    half_width = _t_quantile(degrees) * scale * math.sqrt(sum(variances)) / len(samples)
    return centre - half_width, centre + half_width


def mean_of(sample: Sequence[float]) -> float:
    """Return the mean; for equal values exactly that value, which rounding could change."""
    return float(sample[0] if min(sample) == max(sample) else np.mean(sample))


def _t_quantile(degrees: float) -> float:
    """The two-sided 95 % quantile of Student's t distribution."""
    from scipy.special import stdtrit  # what `scipy.stats.t.ppf` calls; scipy.stats takes much longer to import

    return float(stdtrit(degrees, (1 + CONFIDENCE) / 2))


def seeds_needed(mean: float, spreads: Sequence[float]) -> int | None:
    """Return the least number of seeds that finds a paired difference significant in 80 % of all experiments.

    The observed difference and spreads are taken for the true ones. This is the usual planning of a paired t test by
    the noncentral t distribution (Cohen 1988, Statistical power analysis, ch. 2): the least n ≥ 2 with
    P(T > t(0.975, ν)) ≥ 0.8, where T has ν degrees of freedom and the noncentrality |mean| √n / spread. For a mean over
    several targets with n seeds each, spread is √(Σ s²)/targets, and ν is Welch's.

    Args:
        mean: the observed difference.
        spreads: standard deviations of the paired differences on each target.

    Returns:
        The number; None if it is more than 10,000, or the difference is zero.
    """
    total = sum(spread**2 for spread in spreads)
    if mean == 0:
        return None
    if total == 0:
        return 2
    effect = abs(mean) * len(spreads) / math.sqrt(total)
    degrees = 1 / sum((spread**2 / total) ** 2 for spread in spreads)
    if not _has_power(effect, degrees, MOST_SEEDS):
        return None
    too_few, enough = 1, MOST_SEEDS
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        too_few, enough = (too_few, middle) if _has_power(effect, degrees, middle) else (middle, enough)
    return enough


def _has_power(effect: float, degrees: float, seeds: int) -> bool:
    """Whether a number of seeds suffices; a difference that is significant with the wrong sign does not count."""
    from scipy.special import nctdtr

    freedom = degrees * (seeds - 1)
    noncentrality = min(effect * math.sqrt(seeds), _MAX_NONCENTRALITY)
    return 1 - float(nctdtr(freedom, noncentrality, _t_quantile(freedom))) >= POWER


@dataclass(frozen=True)
class Summary:
    """Summary of one cell's values, one per seed.

    Attributes:
        mean: the mean.
        spread: the sample standard deviation; None for a single value.
        median: the median.
        interval: 95 % confidence interval of the mean, low and high; None for a single value.
        count: the number of values.
        values: the values.
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
        interval: its 95 % confidence interval, low and high; None where a target has a single pair.
        count: the number of seeds that both samples have; over several targets, the fewest.
        improvement: probability that a run of the first sample is better than one of the second; None where neither
            direction is better.
        seeds_needed: the number of seeds that finds a difference of this size and spread significant in 80 % of all
            experiments; None without an interval, without a difference, or where 10,000 are too few.
        targets: the number of targets.
    """

    mean: float
    interval: tuple[float, float] | None
    count: int
    improvement: float | None = None
    seeds_needed: int | None = None
    targets: int = 1

    @property
    def significant(self) -> bool | None:
        """Whether the interval excludes zero; None where there is no interval."""
        return None if self.interval is None else _excludes_zero(self.interval)


def summarise(values: Sequence[float]) -> Summary:
    """Summarise at least one value."""
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
    """Return the seed of the median; of two in the middle, that of the lower value."""
    ranked = sorted(sample, key=lambda seed: (sample[seed], seed))
    return ranked[(len(ranked) - 1) // 2]


def mean_difference(
    samples: Sequence[tuple[BySeed, BySeed]], *, smaller_is_better: bool | None = None
) -> PairedDifference:
    """Average over targets the mean differences of two samples, each over the seeds that both have.

    All targets count equally, and are taken as fixed: the interval is for other seeds on the same targets.

    Args:
        samples: the two samples by seed on each target, with at least one common seed.
        smaller_is_better: the better direction; None where neither is.
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
    """Whether two samples differ significantly over the seeds that both have; False for fewer than two such seeds."""
    common = sorted(first.keys() & second.keys())
    if len(common) < 2:
        return False
    return _excludes_zero(mean_interval([first[seed] - second[seed] for seed in common]))


def _excludes_zero(interval: tuple[float, float]) -> bool:
    return not interval[0] <= 0 <= interval[1]


def _pairs(first: BySeed, second: BySeed) -> _Pairs:
    seeds = sorted(first.keys() & second.keys())
    if not seeds:
        raise ValueError("the samples have no seed in common")
    return np.array([first[seed] for seed in seeds], float), np.array([second[seed] for seed in seeds], float)


def _spread(values: Sequence[float]) -> float:
    # Equal values have no spread, even where their mean is rounded.
    return 0.0 if min(values) == max(values) else float(np.std(values, ddof=1))


def _improvement(pairs: Sequence[_Pairs], *, smaller_is_better: bool) -> float:
    """The mean over targets of the probability that a run of the first sample is better than one of the second.

    This is the share of all pairs of runs, also of different seeds, in which it is better; ties count a half (Agarwal
    et al. 2021, Deep reinforcement learning at the edge of the statistical precipice, sec. 4.3). It equals the
    statistic of `scipy.stats.mannwhitneyu` per pair, without the half second that scipy.stats takes to import.
    """
    larger = [np.mean((first[:, None] > second) + 0.5 * (first[:, None] == second)) for first, second in pairs]
    return float(np.mean([1 - share if smaller_is_better else share for share in larger]))
