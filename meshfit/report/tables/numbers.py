"""Numbers as text. The width of the interval decides how many digits of a mean are shown."""

import math

from meshfit.report.tables.style import Cells
from meshfit.statistics import PairedDifference, Summary

MINUS = "\u2212"
_MOST_DECIMALS = 6


def format_mean(
    summary: Summary, *, whole: bool = False, cells: Cells = "full", digits: int | None = None
) -> tuple[str, str]:
    """Format a mean with its median, `0.1100 (0.1093)`, and its interval, `[0.1040, 0.1153]`.

    All have as many decimals as show two digits of the interval's half width; `0.1100 ± 0.0046`, with the standard
    deviation, as many as show two digits of that. A single value is returned as it is, and equal values as
    `0.1830 ± 0`, both with an empty interval.

    Args:
        summary: of a cell.
        whole: the values are counts, and have no decimals.
        cells: what to show besides the mean.
        digits: significant digits of the mean, which give the decimals of all numbers.
    """
    mean, median = (format_number(value, whole=whole, digits=digits or 4) for value in (summary.mean, summary.median))
    if summary.interval is None or summary.spread is None:
        return mean, ""
    low, high = summary.interval
    half = (high - low) / 2
    if half == 0:
        return mean if cells == "mean" else f"{mean} ± 0", ""
    power = _power(max(abs(low), abs(high)))
    width = summary.spread if cells == "mean-sd" else half
    decimals = _decimals(width / 10**power) if digits is None else _decimals_of(summary.mean / 10**power, digits)
    if decimals > _MOST_DECIMALS:
        return _without_decimals(mean, median, width, cells)
    values = (summary.mean, summary.median, summary.spread, low, high)
    mean, median, spread, least, most = (_fixed(value / 10**power, decimals) for value in values)
    ending = f" e{power}".replace("-", MINUS) if power else ""
    interval = f"[{least}, {most}]{ending}"
    if cells == "mean-sd":
        return f"({mean} ± {spread}){ending}" if ending else f"{mean} ± {spread}", ""
    if cells == "full":
        return f"{mean} ({median}){ending}", interval
    return mean + ending, interval if cells == "mean-ci" else ""


def _without_decimals(mean: str, median: str, width: float, cells: Cells) -> tuple[str, str]:
    """Format a mean whose spread is too small for decimals that show it."""
    error = f"± {width:.1e}".replace("-", MINUS)
    if cells == "mean-sd":
        return f"{mean} {error}", ""
    return f"{mean} ({median})" if cells == "full" else mean, "" if cells == "mean" else error


def format_difference(difference: PairedDifference) -> str:
    """Format a difference with its interval, `−0.0123 [−0.0200, −0.0046]`, with decimals as in `format_mean`."""
    if difference.interval is None or difference.interval[0] == difference.interval[1]:
        mean = format_number(difference.mean, sign="+")
        return mean if difference.interval is None else f"{mean} [{mean}, {mean}]"
    power = _power(max(map(abs, difference.interval)))
    low, high = (bound / 10**power for bound in difference.interval)
    decimals = _decimals((high - low) / 2)
    if difference.significant:
        # A bound that is not zero must not be printed as zero.
        decimals = max(decimals, _decimals(min(abs(low), abs(high))) - 1)
    texts = [_fixed(value, min(decimals, _MOST_DECIMALS), "+") for value in (difference.mean / 10**power, low, high)]
    return _with_power(f"{texts[0]} [{texts[1]}, {texts[2]}]", power)


def format_number(value: float, *, whole: bool = False, sign: str = "", digits: int = 4) -> str:
    """Format a single number with four significant digits; zero, and a count, without decimals."""
    if value == 0 or (whole and value.is_integer()):
        return _fixed(value, 0, sign if value else "")
    power = _power(abs(value))
    scaled = value / 10**power
    text = _fixed(scaled, _decimals_of(scaled, digits), sign)
    return f"{text}e{power}".replace("-", MINUS) if power else text


def _decimals_of(value: float, digits: int) -> int:
    """Return the decimals that show a number of significant digits of a value, after rounding."""
    return max(0, digits - 1 - int(f"{value:.{digits - 1}e}".partition("e")[2]))


def _fixed(value: float, decimals: int, sign: str = "") -> str:
    # "z" prints a negative number that is rounded to zero without its sign.
    return f"{value:{sign}z.{decimals}f}".replace("-", MINUS)


def _power(largest: float) -> int:
    """Return the power of ten to factor out of very small or large numbers; 0 for others."""
    power = math.floor(math.log10(largest)) if largest else 0
    return power if power < -3 or power >= 6 else 0


def _decimals(width: float) -> int:
    """Return the decimals that show two significant digits of a width, after rounding: 0.0996 counts as 0.10."""
    return max(0, 1 - int(f"{width:.1e}".partition("e")[2]))


def _with_power(text: str, power: int) -> str:
    return f"({text})e{power}".replace("e-", f"e{MINUS}") if power else text
