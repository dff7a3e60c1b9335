"""Status, progress and outcome of a trial."""

import math
from dataclasses import dataclass
from enum import StrEnum

from meshfit.fitting.callbacks import Step


class TrialStatus(StrEnum):
    """Status of a trial; the values are those written to files."""

    WAITING = "waiting"
    RUNNING = "running"
    """Fitting or measuring; a scan of the run directory does not distinguish the two."""
    PREPARING = "preparing"
    """Making the control mesh from the target."""
    FITTING = "fitting"
    MEASURING = "measuring"
    COMPLETE = "complete"
    FAILED = "failed"
    DAMAGED = "damaged"
    """Ended, with a result that cannot be read; the next run repeats the trial."""
    INTERRUPTED = "interrupted"
    """Begun, and neither complete, failed nor running."""

    @property
    def is_running(self) -> bool:
        """Whether a process works on the trial."""
        return self in (TrialStatus.RUNNING, TrialStatus.PREPARING, TrialStatus.FITTING, TrialStatus.MEASURING)


_NO_STEP = Step(0, 0, math.nan)


@dataclass(frozen=True)
class Progress:
    """Progress of a trial: its status, and the last step of its fit."""

    status: TrialStatus
    step: Step = _NO_STEP


@dataclass(frozen=True)
class Outcome:
    """The outcome of one attempt at a trial.

    Attributes:
        status: complete, failed or interrupted.
        message: the reason, if it failed.
        kind: its `FailureKind`, if it failed.
    """

    status: TrialStatus
    message: str = ""
    kind: str = ""
