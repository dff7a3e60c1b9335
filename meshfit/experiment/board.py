"""The board: a few numbers for each trial in memory that processes share, and that none can leave locked."""

import math
import multiprocessing
from dataclasses import dataclass
from typing import Any

from meshfit.experiment.progress import Phase, Progress
from meshfit.fitting.progress import Step

_FIELDS = 4


@dataclass(frozen=True)
class Board:
    """Progress of each trial, written by workers and read by whoever shows it.

    Attributes:
        shared: float64 array: whether to stop; then phase, steps done, steps in all and loss of each trial.
    """

    shared: Any

    @classmethod
    def of(cls, trials: int) -> "Board":
        """An empty board for so many trials."""
        return cls(multiprocessing.get_context("spawn").RawArray("d", 1 + _FIELDS * trials))

    @property
    def stopped(self) -> bool:
        """Whether workers are asked to write a checkpoint and stop."""
        return bool(self.shared[0])

    def stop(self) -> None:
        """Ask workers to write a checkpoint and stop."""
        self.shared[0] = 1.0

    def post(self, trial: int, progress: Progress) -> None:
        """Say where a trial is."""
        at = 1 + _FIELDS * trial
        self.shared[at] = float(progress.phase.value)
        if progress.step is not None:
            self.shared[at + 1 : at + _FIELDS] = [progress.step.done, progress.step.steps, progress.step.loss]

    def reset(self, trial: int) -> None:
        """Put a trial back to where it waits."""
        at = 1 + _FIELDS * trial
        self.shared[at : at + _FIELDS] = [0.0] * _FIELDS

    def phase(self, trial: int) -> Phase:
        """Where a trial is."""
        return Phase(int(self.shared[1 + _FIELDS * trial]))

    def step(self, trial: int) -> Step:
        """The steps of a trial so far."""
        done, steps, loss = self.shared[2 + _FIELDS * trial : 1 + _FIELDS * (trial + 1)]
        return Step(int(done), int(steps), loss if math.isfinite(loss) else math.nan)
