"""Output of other libraries, which is kept off stderr in the processes of the command line."""

import logging
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

TRACEBACK_VARIABLE = "MESHFIT_TRACEBACK"
"""Environment variable that shows tracebacks of unexpected errors, and the log of libraries, on stderr."""


def wants_tracebacks() -> bool:
    """Whether tracebacks and the log of libraries are shown on stderr."""
    return os.environ.get(TRACEBACK_VARIABLE, "") not in ("", "0")


def silence_libraries() -> None:
    """Keep the log of other libraries, and errors in their threads and finalisers, off stderr."""
    if wants_tracebacks():
        return
    logging.disable(logging.CRITICAL)
    threading.excepthook = lambda _: None
    sys.unraisablehook = lambda _: None


@contextmanager
def native_output_discarded() -> Iterator[None]:
    """Discard what native code writes to stdout and stderr within the block, such as warnings on its plugins."""
    if wants_tracebacks():
        yield
        return
    saved: dict[int, int] = {}
    with suppress(OSError):  # a stream that is closed
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            saved[stream] = os.dup(stream)
            os.dup2(nowhere, stream)
        os.close(nowhere)
    try:
        yield
    finally:
        for stream, copy in saved.items():
            os.dup2(copy, stream)
            os.close(copy)
