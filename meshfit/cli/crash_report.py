"""Reports of unexpected errors: one line on stderr, and a file with the traceback.

Only the standard library is imported, since memory may have run out while others were.
"""

import platform
import shlex
import sys
import tempfile
import traceback
from contextlib import suppress
from datetime import UTC, datetime

from meshfit.library_output import TRACEBACK_VARIABLE, wants_tracebacks

EXIT_CRASHED = 70
"""An unexpected error; the code that BSD's sysexits.h has for errors in a program."""

_LONGEST = 200
_MEMORY_WORDS = (
    *("out of memory", "can't allocate memory", "cannot allocate memory", "not enough memory", "bad_alloc"),
    "failed to map segment",  # of a library that is imported
)


def crash_report(error: BaseException) -> str:
    """Write the traceback of an unexpected error to a file, and return the message that names the file."""
    if wants_tracebacks():
        traceback.print_exception(error)
    try:
        place = f"its traceback is in {_write(error)}"
    except OSError as unwritable:
        reason = unwritable.strerror or type(unwritable).__name__
        place = f"its traceback cannot be saved: {reason}; {TRACEBACK_VARIABLE}=1 shows it"
    except Exception:  # noqa: BLE001  memory may be short
        place = f"{TRACEBACK_VARIABLE}=1 shows its traceback"
    if _is_lack_of_memory(error):
        return f"not enough memory; use smaller meshes or fewer workers (-j), or raise the limit; {place}"
    return f"unexpected {_text(error)}; this is an error in meshfit: please report it; {place}"


def print_crash(error: BaseException) -> None:
    """Report an unexpected error on stderr without any library."""
    print_fault(crash_report(error))


def print_fault(message: str) -> None:
    """Print an error on stderr without any library."""
    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.write(f"error: {message}\n")
        sys.stderr.flush()


def _text(error: BaseException) -> str:
    text = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def _is_lack_of_memory(error: BaseException) -> bool:
    text = str(error).lower()
    return isinstance(error, MemoryError) or any(words in text for words in _MEMORY_WORDS)


def _write(error: BaseException) -> str:
    details = (
        f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}  Python {platform.python_version()}, {sys.platform}",
        f"command: {shlex.join(sys.argv)}",
        *traceback.format_exception(error),
    )
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", errors="backslashreplace", prefix="meshfit-error-", suffix=".txt", delete=False
    ) as file:
        file.write("\n".join(details))
    return file.name
