"""Pipes, named or anonymous, in place of files: read as far as wanted, without waiting for ever for a writer."""

import os
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from meshfit.errors import MeshError
from meshfit.paths import path_text

_CHUNK = 1 << 20
_SECONDS_FOR_A_WRITER = 5.0


def pipe_chunks(path: str | Path) -> Iterator[bytes]:
    """Yield the content of a pipe in chunks.

    Args:
        path: of a pipe, such as a named one or `/dev/fd/63`.

    Raises:
        MeshError: nobody opens it for writing within five seconds.
        OSError: it cannot be read.
    """
    # Opening a pipe without a writer would never return.
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    with open(descriptor, "rb", buffering=0) as pipe:  # noqa: PTH123  a descriptor
        is_named = not os.path.realpath(path).startswith("/proc/")  # an anonymous one gets no other writer
        deadline = time.monotonic() + (_SECONDS_FOR_A_WRITER if is_named else 0.0)
        while (chunk := pipe.read(_CHUNK)) == b"":  # None is a writer that has written nothing yet
            if time.monotonic() >= deadline:
                raise MeshError(f"{path_text(path)}: a pipe that nothing is written to; give the path of a file")
            time.sleep(0.05)
        os.set_blocking(descriptor, True)
        if chunk is not None:
            yield chunk
        yield from iter(partial(pipe.read, _CHUNK), b"")
