"""Where a trial is, and how it ended."""

from dataclasses import dataclass
from enum import Enum

from meshfit.fitting.callbacks import Step


class Phase(Enum):
    """Where a trial is."""

    WAITING = 0
    FITTING = 1
    MEASURING = 2
    COMPLETE = 3
    FAILED = 4
    INTERRUPTED = 5


@dataclass(frozen=True)
class Progress:
    """What `on_progress` is told: the phase, and the steps done, if it is fitting."""

    phase: Phase
    step: Step | None = None


@dataclass(frozen=True)
class Outcome:
    """How a trial ended, and, if it failed, why.

    Attributes:
        phase: where it is now.
        message: why it failed, for a person to read.
        kind: a `FailureKind`, if it failed.
    """

    phase: Phase
    message: str = ""
    kind: str = ""
