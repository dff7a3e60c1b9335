"""The last sign of life of a running trial: its `progress.json`, as whoever looks on from outside reads it."""

import os
import socket
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from meshfit.errors import StoreError
from meshfit.experiment.plan import Trial
from meshfit.experiment.storage.run_directory import LOG, PROGRESS, RunDirectory, now, read_json, write_json
from meshfit.experiment.trial_status import Phase, Progress
from meshfit.fitting.callbacks import Step

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


_SECONDS_BETWEEN_FILES = 1.0
_SECONDS_BETWEEN_LINES = 10.0


class Journal:
    """The log and the progress of one attempt at a trial; whoever keeps it holds the trial's lock.

    Attributes:
        step: the last step that was told of.
    """

    def __init__(self, trial: Trial, store: RunDirectory) -> None:
        self._trial, self._store = trial, store
        self._started, self._phase = now(), Phase.WAITING
        self._file_due = self._line_due = 0.0
        self.step: Step | None = None
        self.note(f"started on {socket.gethostname()}, process {os.getpid()}, meshfit {version('meshfit')}")

    def note(self, text: str) -> None:
        """Add a line to the log.

        Raises:
            StoreError: it cannot be written.
        """
        self._store.append(self._trial, LOG, f"{now()}  {text}\n")

    def tell(self, progress: Progress) -> None:
        """Take note of where the trial is: at once in a new phase, else as often as is of use.

        Raises:
            StoreError: it cannot be written.
        """
        time_now, new = time.monotonic(), progress.phase is not self._phase
        self._phase, self.step = progress.phase, progress.step or self.step
        if new:
            self.note(progress.phase.name.lower())
            self._line_due = time_now + _SECONDS_BETWEEN_LINES
        elif time_now >= self._line_due and self.step is not None:
            self.note(f"step {self.step.done} of {self.step.steps}, loss {self.step.loss:.6g}")
            self._line_due = time_now + _SECONDS_BETWEEN_LINES
        if new or time_now >= self._file_due:
            self._write()
            self._file_due = time_now + _SECONDS_BETWEEN_FILES

    def close(self, text: str) -> None:
        """The last line of an attempt, which is over."""
        self.note(text)
        self._store.remove(self._trial, PROGRESS)

    def _write(self) -> None:
        step = self.step or Step(0, self._trial.settings.fit.steps, float("nan"))
        content = {
            "phase": self._phase.name.lower(),
            "step": step.done,
            "steps": step.steps,
            "loss": step.loss if abs(step.loss) < float("inf") else None,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "started": self._started,
            "updated": now(),
        }
        self._store.write(self._trial, PROGRESS, write_json(content), lasting=False)
