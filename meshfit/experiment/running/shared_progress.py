"""Progress of trials in memory that processes share."""

import math
import multiprocessing
from dataclasses import dataclass
from typing import Any

from meshfit.experiment.trial_status import Progress, TrialStatus
from meshfit.fitting.callbacks import Step

_STATUSES = list(TrialStatus)  # waiting comes first: shared memory begins as zeros
_FIELDS = 4


@dataclass(frozen=True)
class SharedProgress:
    """Lock-free progress of each trial, written by workers; a worker that dies cannot leave it locked.

    Attributes:
        shared: float64 array: whether to stop; then status, steps done, steps in all and loss of each trial.
    """

    shared: Any

    @classmethod
    def of(cls, trials: int) -> "SharedProgress":
        """Return the progress of a number of waiting trials."""
        return cls(multiprocessing.get_context("spawn").RawArray("d", 1 + _FIELDS * trials))

    @property
    def cancelled(self) -> bool:
        """Whether workers are asked to write checkpoints and stop."""
        return bool(self.shared[0])

    def cancel(self) -> None:
        """Ask workers to write checkpoints and stop."""
        self.shared[0] = 1.0

    def clear(self) -> None:
        """Set all trials back to waiting."""
        self.shared[:] = [0.0] * len(self.shared)

    @property
    def capacity(self) -> int:
        """The number of trials that it has room for."""
        return (len(self.shared) - 1) // _FIELDS

    def __getitem__(self, trial: int) -> Progress:
        start = 1 + _FIELDS * trial
        status, done, steps, loss = self.shared[start : start + _FIELDS]
        step = Step(int(done), int(steps), loss if math.isfinite(loss) else math.nan)
        return Progress(_STATUSES[int(status)], step)

    def __setitem__(self, trial: int, progress: Progress) -> None:
        step, start = progress.step, 1 + _FIELDS * trial
        self.shared[start : start + _FIELDS] = [_STATUSES.index(progress.status), step.done, step.steps, step.loss]

    def reset(self, trial: int) -> None:
        """Set a trial back to waiting."""
        self[trial] = Progress(TrialStatus.WAITING)
