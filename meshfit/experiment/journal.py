"""What a running trial leaves for those who look on: lines in `trial.log`, and in `progress.json` where it is."""

import os
import socket
import time
from importlib.metadata import version

from meshfit.experiment.plan import Trial
from meshfit.experiment.progress import Phase, Progress
from meshfit.experiment.store import LOG, PROGRESS, RunDirectory, now, write_json
from meshfit.fitting.progress import Step

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
