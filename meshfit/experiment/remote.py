"""Workers that are no children of this process: any executor, with what has to be known of it besides."""

import uuid
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from meshfit.errors import ClusterError
from meshfit.experiment.store import make_folder, write_atomically

Transfer = Literal["auto", "shared", "returned"]
"""How files travel: workers write to a `shared` directory, or they are `returned` to the one who sent the trial."""


class StopSign(Protocol):
    """What workers look at to see whether they should write checkpoints and stop; it travels with each job."""

    def set(self) -> None:
        """Ask them to."""

    def is_set(self) -> bool:
        """Whether they are asked to."""

    def clear(self) -> None:
        """Take the sign away."""


@dataclass(frozen=True)
class FileStopSign:
    """A stop sign that stands as a file in the run directory: seen by those who share it."""

    path: Path

    def set(self) -> None:
        """Ask workers to stop."""
        write_atomically(self.path, "", lasting=False)

    def is_set(self) -> bool:
        """Whether they are asked to."""
        return self.path.exists()

    def clear(self) -> None:
        """Take the sign away."""
        self.path.unlink(missing_ok=True)


class Remote:
    """Workers elsewhere.

    Attributes:
        executor: takes calls; anything with the interface of `concurrent.futures.Executor`. Of two jobs in threads of
            one process the second waits for the first.
        gpus: how many trials can have a GPU of their own at a time.
        transfer: how files travel; `auto` looks whether workers see the run directory.
        workers: how many there are, as far as is known.
    """

    workers = 1

    def __init__(self, executor: Executor, *, gpus: int = 0, transfer: Transfer = "auto") -> None:
        self.executor, self.gpus, self.transfer = executor, gpus, transfer

    def stop_sign(self, root: Path) -> StopSign:
        """A new stop sign for trials under a run directory."""
        return FileStopSign(root / f".stop-{uuid.uuid4().hex}")

    def on_workers(self, function: Callable[..., Any], *args: object) -> list[Any]:
        """What some workers return for a call: all of them if that can be had, else one."""
        return [self.executor.submit(function, *args).result()]

    def shares(self, root: Path) -> bool:
        """Whether workers see this run directory.

        Raises:
            StoreError: it cannot be written to.
            ClusterError: workers have to see it, and do not.
        """
        if self.transfer == "returned":
            return False
        make_folder(root)
        path = (root / f".token-{uuid.uuid4().hex}").resolve()
        write_atomically(path, path.name, lasting=False)
        try:
            seen = all(self.on_workers(_sees, str(path), path.name))
        finally:
            path.unlink(missing_ok=True)
        if self.transfer == "shared" and not seen:
            raise ClusterError(f"workers do not see {root.resolve()}; name a directory they share, or return files")
        return seen

    def close(self) -> None:
        """Let go of the executor, which belongs to whoever made it."""


def _sees(path: str, content: str) -> bool:
    with suppress(OSError):
        return Path(path).read_text(encoding="utf-8") == content
    return False
