"""Refusal to start where the limit on address space (`ulimit -v`) is below what the libraries of a command take.

Below it, native libraries end the process with lines of their own, or try again for minutes. Only the standard library
is imported.
"""

from collections.abc import Sequence

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_MB = 1_000_000
_WITH_TORCH = 1000
"""Megabytes that torch, SciPy and pymeshlab take together once they are imported."""
_TO_MEASURE = 450
_WITH_SCIPY = 300
_WITH_NUMPY = 150
_WITHOUT = ("init", "schema", "--help", "-h", "--version", "--install-completion", "--show-completion")
_LEAST = {
    **dict.fromkeys(("run", "compare", "tune", "fit"), _WITH_TORCH),
    "measure": _TO_MEASURE,
    **dict.fromkeys(("status", "show", "clean", "table", "export", "expect", "targets"), _WITH_NUMPY),
    **dict.fromkeys(
        ("subdivide", "render", "figure", "chart", "report", "animate", "save", "views", "view", "schemes"),
        _WITH_SCIPY,
    ),
}


def lack_of_address_space(words: Sequence[str]) -> str | None:
    """Return the message where a command line cannot run within the limit; None where it perhaps can.

    Args:
        words: the command and its arguments.
    """
    if resource is None or not words or any(word in _WITHOUT for word in words):
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    least = _LEAST.get(words[0], 0)
    if limit == resource.RLIM_INFINITY or limit >= least * _MB:
        return None
    needed = f"meshfit {words[0]} needs {least:,} MB of address space to load its libraries"
    return f"not enough memory: {needed}, and the limit is {limit // _MB:,} MB; raise it (ulimit -v)"
