"""Times and sizes as they are printed, to as many digits as a person wants to know."""

_SECONDS = 90
_MINUTES = 90 * 60
_HOURS = 48 * 3600
_UNITS = ("B", "kB", "MB", "GB", "TB")


def duration(seconds: float) -> str:
    """`45 s`, `12 min`, `3 h 20 min`, `4 days`."""
    if seconds < _SECONDS:
        return f"{seconds:.0f} s"
    if seconds < _MINUTES:
        return f"{seconds / 60:.0f} min"
    if seconds < _HOURS:
        hours, minutes = divmod(round(seconds / 60), 60)
        return f"{hours} h {minutes} min" if minutes else f"{hours} h"
    return f"{seconds / 86400:.0f} days"


def size(count: float) -> str:
    """`649 B`, `3.2 kB`, `128 kB`, `1.2 MB`; a kB is 1,000 bytes."""
    power = 0
    while count >= 999.5 and power < len(_UNITS) - 1:
        count, power = count / 1000, power + 1
    decimals = 1 if power and count < 9.95 else 0
    return f"{count:.{decimals}f} {_UNITS[power]}"
