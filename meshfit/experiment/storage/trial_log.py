"""`trial.log` and `progress.json`: the log of a trial, and its latest progress while it runs."""

import math
import os
import socket
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from meshfit.errors import StoreError
from meshfit.experiment.storage.file_models import ProgressContent
from meshfit.experiment.storage.run_directory import LOG, PROGRESS, RunDirectory, json_text, now, read_json
from meshfit.experiment.trial_status import Progress, TrialStatus
from meshfit.fitting.callbacks import Step

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

# Progress is written about once a second, so a trial whose progress is older than this has presumably stopped.
_STALE_SECONDS = 60.0
_SECONDS_BETWEEN_FILES = 1.0
_SECONDS_BETWEEN_LINES = 10.0


class TrialLog:
    """Writer of the log and the progress of one attempt at a trial, whose lock must be held."""

    def __init__(self, trial: "Trial", store: RunDirectory) -> None:
        self._trial, self._store = trial, store
        self._started, self._status = now(), TrialStatus.WAITING
        self._file_due = self._line_due = 0.0
        self.note(f"started on {this_host()}, process {os.getpid()}, meshfit {version('meshfit')}")

    def note(self, text: str) -> None:
        """Add a line to the log.

        Raises:
            StoreError: it cannot be written.
        """
        self._store.append(self._trial, LOG, f"{now()}  {text}\n")

    def update(self, progress: Progress) -> None:
        """Write the progress at once if the status changes, else about once a second, and log it every ten seconds.

        Raises:
            StoreError: it cannot be written.
        """
        time_now, changed, step = time.monotonic(), progress.status is not self._status, progress.step
        self._status = progress.status
        if changed:
            self.note(progress.status)
            self._line_due = time_now + _SECONDS_BETWEEN_LINES
        elif time_now >= self._line_due and step.done:
            self.note(f"step {step.done} of {step.steps}, loss {step.loss:.6g}")
            self._line_due = time_now + _SECONDS_BETWEEN_LINES
        if changed or time_now >= self._file_due:
            self._write(progress)
            self._file_due = time_now + _SECONDS_BETWEEN_FILES

    def close(self, text: str) -> None:
        """Write the last line of this attempt, and remove its progress."""
        self.note(text)
        self._store.remove(self._trial, PROGRESS)

    def _write(self, progress: Progress) -> None:
        content = _plain(progress) | {
            "host": this_host(),
            "pid": os.getpid(),
            "started": self._started,
            "updated": now(),
        }
        self._store.write(self._trial, PROGRESS, json_text(content), lasting=False)


@dataclass(frozen=True, kw_only=True)
class LastProgress(Progress):
    """The content of a `progress.json`.

    Attributes:
        host: the machine on which the trial runs.
        pid: its process there.
        started: the time at which this attempt began.
        updated: the time at which the file was written.
    """

    host: str
    pid: int
    started: datetime
    updated: datetime

    def age_seconds(self, now: datetime) -> float:
        """Seconds since the file was written; 0 where the clocks of two machines would make it negative."""
        return max(0.0, (now - self.updated).total_seconds())

    def is_stale(self, now: datetime) -> bool:
        """Whether the file is so old that the trial has presumably stopped."""
        return self.age_seconds(now) >= _STALE_SECONDS

    @property
    def running_seconds(self) -> float:
        """Seconds from the start of the attempt until the file was written."""
        return max(0.0, (self.updated - self.started).total_seconds())

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the file as plain data."""
        times = {"started": self.started.isoformat(), "updated": self.updated.isoformat()}
        return _plain(self) | {"host": self.host, "pid": self.pid} | times


def read_progress(folder: Path) -> LastProgress | None:
    """Read the progress of a trial; None where there is none, or none that can be read."""
    try:
        content = ProgressContent.model_validate(read_json(folder / PROGRESS))
        loss = math.nan if content.loss is None else content.loss
        return LastProgress(
            status=TrialStatus(content.phase),
            step=Step(content.step, content.steps, loss),
            host=content.host,
            pid=content.pid,
            started=_parse_time(content.started),
            updated=_parse_time(content.updated),
        )
    except (StoreError, ValueError):  # no such phase or time
        return None


def this_host() -> str:
    """The name of this machine in a `progress.json`."""
    return socket.gethostname()


def _plain(progress: Progress) -> dict[str, Any]:
    step = progress.step
    loss = step.loss if math.isfinite(step.loss) else None
    return {"phase": progress.status.value, "step": step.done, "steps": step.steps, "loss": loss}


def _parse_time(text: str) -> datetime:
    parsed = datetime.fromisoformat(text)
    return parsed if parsed.tzinfo is not None else parsed.replace(tzinfo=UTC)
