"""A board that is read from the files of running trials, for workers that share a directory and no memory."""

import math
import time
from collections.abc import Mapping, Sequence

from meshfit.experiment.plan import Trial
from meshfit.experiment.progress import Outcome, Phase
from meshfit.experiment.progress_file import read_progress
from meshfit.experiment.store import PROGRESS, RunDirectory
from meshfit.fitting.progress import Step

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
