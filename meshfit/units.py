"""Counts, durations and file sizes in words, and tables of text for notebooks."""

from collections.abc import Iterable
from html import escape

# Shorter durations are given in seconds, minutes, or hours and minutes.
_SECONDS_BELOW, _MINUTES_BELOW, _HOURS_BELOW = 90, 90 * 60, 48 * 3600
_SIZES = ("B", "kB", "MB", "GB", "TB")


def count_text(number: int | str, noun: str) -> str:
    """Return `1 trial`, `1,200 trials` or `2 vertices`; a number given as text stays as it is."""
    text = number if isinstance(number, str) else f"{number:,}"
    plural = f"{noun.removesuffix('ex')}ices" if noun.endswith("vertex") else f"{noun}s"
    return f"{text} {noun}" if text == "1" else f"{text} {plural}"


def duration_text(seconds: float) -> str:
    """Return `45 s`, `12 min`, `3 h 20 min` or `4 days`."""
    if seconds < _SECONDS_BELOW:
        return f"{seconds:.0f} s"
    if seconds < _MINUTES_BELOW:
        return f"{seconds / 60:.0f} min"
    if seconds < _HOURS_BELOW:
        hours, minutes = divmod(round(seconds / 60), 60)
        return f"{hours} h {minutes} min" if minutes else f"{hours} h"
    return f"{seconds / 86400:.0f} days"


def size_text(count: float) -> str:
    """Return `649 B`, `3.2 kB`, `128 kB` or `1.2 MB`; a kB is 1,000 bytes."""
    power = 0
    while count >= 999.5 and power < len(_SIZES) - 1:
        count, power = count / 1000, power + 1
    decimals = 1 if power and count < 9.95 else 0
    return f"{count:.{decimals}f} {_SIZES[power]}"


def html_table(columns: Iterable[str], rows: Iterable[Iterable[str]], caption: str = "") -> str:
    """Return an HTML table of texts, which are escaped, for notebooks."""
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
