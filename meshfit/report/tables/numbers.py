"""Numbers as they are printed: the interval decides how many digits of a mean are worth showing."""

import math

from meshfit.statistics import PairedDifference, Summary

MINUS = "\u2212"
_MOST_DECIMALS = 6


def format_mean(summary: Summary, *, whole: bool = False) -> tuple[str, str]:
    """`0.1100 (0.1093)` and `[0.1040, 0.1153]`: all to the decimal that shows two digits of the interval's half width.

    A single value stands alone, and the second text is empty; so it is for equal values, `0.1830 ± 0`.

    Args:
        summary: of a cell.
        whole: the values are counts, so that a single one has no decimals.
    """
    mean, median = (format_number(value, whole=whole) for value in (summary.mean, summary.median))
    if summary.interval is None:
        return mean, ""
    low, high = summary.interval
    half = (high - low) / 2
    if half == 0:
        return f"{mean} ± 0", ""
    power = _power(max(abs(low), abs(high)))
    decimals = _decimals(half / 10**power)
    if decimals > _MOST_DECIMALS:
        return f"{mean} ({median})", f"± {half:.1e}".replace("-", MINUS)
    values = (summary.mean, summary.median, low, high)
    mean, median, least, most = (_fixed(value / 10**power, decimals) for value in values)
    ending = f" e{power}".replace("-", MINUS) if power else ""
    return f"{mean} ({median}){ending}", f"[{least}, {most}]{ending}"


def format_difference(paired: PairedDifference) -> str:
    """`−0.0123 [−0.0200, −0.0046]`: all to the decimal that shows two digits of the interval's half width."""
    if paired.interval is None or paired.interval[0] == paired.interval[1]:
        mean = format_number(paired.mean, sign="+")
        return mean if paired.interval is None else f"{mean} [{mean}, {mean}]"
    power = _power(max(map(abs, paired.interval)))
    low, high = (bound / 10**power for bound in paired.interval)
    decimals = _decimals((high - low) / 2)
    if paired.significant:
        # A bound that is not zero must not be printed as one.
        decimals = max(decimals, _decimals(min(abs(low), abs(high))) - 1)
    texts = [_fixed(value, min(decimals, _MOST_DECIMALS), "+") for value in (paired.mean / 10**power, low, high)]
    return _with_power(f"{texts[0]} [{texts[1]}, {texts[2]}]", power)


def format_number(value: float, *, whole: bool = False, sign: str = "") -> str:
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
