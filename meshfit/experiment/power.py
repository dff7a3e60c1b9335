"""How many seeds a difference takes to be found significant."""

import math
from collections.abc import Sequence

from meshfit.experiment.bootstrap import CONFIDENCE

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
