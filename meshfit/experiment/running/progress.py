"""The board: a few numbers for each trial in memory that processes share, and that none can leave locked."""

import math
import multiprocessing
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from meshfit.experiment.plan import Trial
from meshfit.experiment.storage.run_directory import PROGRESS, RunDirectory
from meshfit.experiment.storage.trial_log import read_progress
from meshfit.experiment.trial_status import Outcome, Phase, Progress
from meshfit.fitting.callbacks import Step

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


_SECONDS_BETWEEN_LOOKS = 2.0
_NOTHING = Step(0, 0, math.nan)


class FileBoard:
    """Progress of each trial, as `progress.json` in its folder has it; a trial without such a file waits."""

    def __init__(self, trials: Sequence[Trial], store: RunDirectory, outcomes: Mapping[int, Outcome]) -> None:
        self._folders = [store.folder(trial) for trial in trials]
        self._outcomes = outcomes
        self._seen: dict[int, tuple[Phase, Step]] = {}
        self._due = 0.0

    def phase(self, trial: int) -> Phase:
        """Where a trial is."""
        self._look()
        return self._seen[trial][0] if trial in self._seen else Phase.WAITING

    def step(self, trial: int) -> Step:
        """The steps of a trial so far."""
        self._look()
        return self._seen[trial][1] if trial in self._seen else _NOTHING

    def reset(self, trial: int) -> None:
        """Put a trial back to where it waits."""
        (self._folders[trial] / PROGRESS).unlink(missing_ok=True)
        self._seen.pop(trial, None)

    def _look(self) -> None:
        if time.monotonic() < self._due:
            return
        self._due = time.monotonic() + _SECONDS_BETWEEN_LOOKS
        self._seen = {}
        for number, folder in enumerate(self._folders):
            seen = None if number in self._outcomes else read_progress(folder)
            if seen is not None:
                loss = math.nan if seen.loss is None else seen.loss
                phase = Phase.__members__.get(seen.phase.upper(), Phase.FITTING)
                self._seen[number] = (phase, Step(seen.step, seen.steps, loss))
