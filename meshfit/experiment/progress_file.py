"""The last sign of life of a running trial: its `progress.json`, as whoever looks on from outside reads it."""

import socket
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from meshfit.errors import StoreError
from meshfit.experiment.store import PROGRESS, read_json

FRESH_SECONDS = 60.0
"""Progress is written about once a second: after so long without, something is wrong."""


@dataclass(frozen=True)
class LastProgress:
    """What a trial last said of itself.

    Attributes:
        phase: `fitting`, `measuring` or `waiting`.
        step: steps done.
        steps: of how many.
        loss: after them, if there is one.
        host: the machine that it runs on.
        pid: its process there.
        started: when this attempt began.
        updated: when this was written.
    """

    phase: str
    step: int
    steps: int
    loss: float | None
    host: str
    pid: int
    started: datetime
    updated: datetime

    def silent_seconds(self, now: datetime) -> float:
        """Seconds since this was written; none where the clocks of two machines differ that way."""
        return max(0.0, (now - self.updated).total_seconds())

    @property
    def running_seconds(self) -> float:
        """Seconds from its start to its last sign of life."""
        return max(0.0, (self.updated - self.started).total_seconds())

    def to_dict(self) -> dict[str, Any]:
        """As it stands in the file."""
        return vars(self) | {"started": self.started.isoformat(), "updated": self.updated.isoformat()}


def read_progress(folder: Path) -> LastProgress | None:
    """A trial's last sign of life; None where there is none, or none that can be read."""
    try:
        found = read_json(folder / PROGRESS)
        loss = found["loss"]
        return LastProgress(
            phase=str(found["phase"]),
            step=int(found["step"]),
            steps=int(found["steps"]),
            loss=None if loss is None else float(loss),
            host=str(found["host"]),
            pid=int(found["pid"]),
            started=_time(found["started"]),
            updated=_time(found["updated"]),
        )
    except (StoreError, KeyError, TypeError, ValueError):
        return None


def this_host() -> str:
    """The name that this machine goes by in such a file."""
    return socket.gethostname()


def _time(text: str) -> datetime:
    time = datetime.fromisoformat(text)
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)
