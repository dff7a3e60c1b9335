"""Numbers as they are printed: the spread decides how many digits of a mean are worth showing."""

import math

from meshfit.experiment.statistics import PairedDifference, Summary

MINUS = "\u2212"
_MOST_DECIMALS = 6


def mean_and_spread(summary: Summary, *, whole: bool = False) -> str:
    """`0.1830 ± 0.0021`: two digits of the spread, the mean to the same decimal; four digits of a mean without one.

    Args:
        summary: of a cell.
        whole: the values are counts, so that a single one has no decimals.
    """
    if summary.spread is None:
        return plain(summary.mean, whole=whole)
    if summary.spread == 0:
        return f"{plain(summary.mean, whole=whole)} ± 0"
    power = _power(max(abs(summary.mean), summary.spread))
    mean, spread = summary.mean / 10**power, summary.spread / 10**power
    decimals = _decimals(spread)
    if decimals > _MOST_DECIMALS:
        return f"{plain(summary.mean, whole=whole)} ± {summary.spread:.1e}".replace("-", MINUS)
    return _with_power(f"{_fixed(mean, decimals)} ± {spread:.{decimals}f}", power)


def difference_and_interval(paired: PairedDifference) -> str:
    """`−0.0123 [−0.0200, −0.0046]`: all to the decimal that shows two digits of the interval's half width."""
    if paired.interval is None or paired.interval[0] == paired.interval[1]:
        mean = plain(paired.mean, sign="+")
        return mean if paired.interval is None else f"{mean} [{mean}, {mean}]"
    power = _power(max(map(abs, paired.interval)))
    low, high = (bound / 10**power for bound in paired.interval)
    decimals = _decimals((high - low) / 2)
    if paired.significant:
        # A bound that is not zero must not be printed as one.
        decimals = max(decimals, _decimals(min(abs(low), abs(high))) - 1)
    texts = [_fixed(value, min(decimals, _MOST_DECIMALS), "+") for value in (paired.mean / 10**power, low, high)]
    return _with_power(f"{texts[0]} [{texts[1]}, {texts[2]}]", power)


def plain(value: float, *, whole: bool = False, sign: str = "") -> str:
    """A number by itself, to four significant digits; a count, or a zero, without decimals."""
    if value == 0 or (whole and value.is_integer()):
        return _fixed(value, 0, sign if value else "")
    power = _power(abs(value))
    scaled = value / 10**power
    text = _fixed(scaled, max(0, 3 - math.floor(math.log10(abs(scaled)))), sign)
    return f"{text}e{power}".replace("-", MINUS) if power else text


def _fixed(value: float, decimals: int, sign: str = "") -> str:
    # The "z" keeps a rounded-away minus from being printed as -0.00.
    return f"{value:{sign}z.{decimals}f}".replace("-", MINUS)


def _power(largest: float) -> int:
    """The power of ten to take out of numbers that would be all zeros in front or behind; else 0."""
    power = math.floor(math.log10(largest)) if largest else 0
    return power if power < -3 or power >= 6 else 0


def _decimals(width: float) -> int:
    """Decimals that show two significant digits of a width, after rounding: 0.0996 counts as 0.10."""
    return max(0, 1 - int(f"{width:.1e}".partition("e")[2]))


def _with_power(text: str, power: int) -> str:
    return f"({text})e{power}".replace("e-", f"e{MINUS}") if power else text
