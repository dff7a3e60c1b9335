"""Temporary run directories, which the next command removes where a process was killed."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

_PREFIX, _LOCK = "meshfit-run-", ".lock"


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a temporary folder, which is removed at the end, and remove those that killed processes have left."""
    _remove_abandoned()
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX))
        lock = FileLock(folder / _LOCK)
        with lock:
            if not (folder / _LOCK).exists():  # another process took it for abandoned
                continue
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            return


def _remove_abandoned() -> None:
    """Remove the folders whose lock nobody holds; the system releases it when its holder dies, however it dies."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        if (folder / _LOCK).is_file():
            with suppress(OSError, Timeout), FileLock(folder / _LOCK, timeout=0):
                shutil.rmtree(folder, ignore_errors=True)
