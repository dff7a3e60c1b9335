"""What kinds of failure there are, which of them another try can help, and what `failure.json` says of one."""

import traceback
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from meshfit.errors import MeshfitError, StoreError
from meshfit.experiment.plan import Trial
from meshfit.experiment.status.scan import ExperimentOverview, Standing, State
from meshfit.experiment.storage.run_directory import FAILURE, LOG, Result, RunDirectory, now, read_json
from meshfit.fitting.problem import Diverged

LAST_GOOD = "last_good.ply"


class FailureKind(StrEnum):
    """Why a trial failed."""

    DIVERGED = "diverged"
    """A step of the fit was not finite."""
    OUT_OF_MEMORY = "out-of-memory"
    """Memory was asked for that was not there."""
    KILLED = "killed"
    """Its process ended from outside."""
    INPUT = "input"
    """A mesh or a setting cannot be used."""
    ERROR = "error"
    """Anything that is not foreseen; the record holds the traceback."""


RETRIED = frozenset({FailureKind.KILLED, FailureKind.OUT_OF_MEMORY})
"""The kinds that depend on what else goes on in the machine; the others would only come again."""

_WORDS_OF_MEMORY = ("out of memory", "can't allocate memory", "not enough memory")


def kind_of(error: Exception) -> FailureKind:
    """The kind of failure that an error stands for."""
    if isinstance(error, Diverged):
        return FailureKind.DIVERGED
    if isinstance(error, MeshfitError):
        return FailureKind.INPUT
    # torch says it with a RuntimeError, of a class of its own on CUDA only.
    spoken = isinstance(error, RuntimeError) and any(words in str(error).lower() for words in _WORDS_OF_MEMORY)
    return FailureKind.OUT_OF_MEMORY if spoken or isinstance(error, MemoryError) else FailureKind.ERROR


def failure_of(trial: Trial, error: Exception, step: int | None, attempts: int) -> Result:
    """The record of a trial that raised.

    Args:
        trial: which one.
        error: what it raised.
        step: the last step of the fit that was made, if any was.
        attempts: how many have failed, with this one.
    """
    kind = kind_of(error)
    record = _record(trial, kind, str(error), step, attempts) | {"error": type(error).__name__}
    if isinstance(error, Diverged):
        return record | {"step": error.step, "term": error.term, "last_good": LAST_GOOD}
    if kind is FailureKind.ERROR:
        return record | {"traceback": traceback.format_exception(error)}
    return record


def death_of(trial: Trial, step: int | None, attempts: int) -> Result:
    """The record of a trial whose process was killed."""
    times = {1: "", 2: " twice"}.get(attempts, f" {attempts} times")
    message = f"the process that ran it was killed{times}; perhaps there was not enough memory"
    return _record(trial, FailureKind.KILLED, message, step, attempts) | {"error": None}


def failed_attempts(trial: Trial, store: RunDirectory) -> int:
    """How many attempts at a trial have failed since it was last complete."""
    try:
        record = store.failure(trial)
    except StoreError:  # damaged, and about to be written anew
        return 0
    count = 0 if record is None else record.get("attempts", 1)
    return count if isinstance(count, int) else 1


def _record(trial: Trial, kind: FailureKind, message: str, step: int | None, attempts: int) -> Result:
    return {
        "kind": kind.value,
        "message": message,
        "step": step,
        "attempts": attempts,
        "log": LOG,
        "identity": trial.identity,
        "experiment": trial.experiment,
        **trial.names,
        "finished": now(),
    }


UNREADABLE = "unreadable"


@dataclass(frozen=True)
class Failure:
    """Why a trial failed.

    Attributes:
        trial: which one.
        kind: what went wrong, in one word; `unreadable` where the record itself is damaged.
        message: in one line.
        step: at which step, if it was at one.
        where: the file to look into: the trial's log, or the record where there is no log.
        record: all that the record says.
    """

    trial: Standing
    kind: str
    message: str
    step: int | None
    where: Path
    record: Result


def read_failure(trial: Standing) -> Failure:
    """Why a trial failed; a record that cannot be read is told as such."""
    path = trial.path / FAILURE
    try:
        record = read_json(path)
    except StoreError as error:
        return Failure(trial, UNREADABLE, str(error), None, path, {})
    step = record.get("step")
    return Failure(
        trial,
        str(record.get("kind", "error")),
        " ".join(str(record.get("message", "")).split()),
        step if isinstance(step, int) else None,
        trial.path / LOG if LOG in trial.folder.files else path,
        record,
    )


def failures_by_kind(experiment: ExperimentOverview) -> dict[str, list[Failure]]:
    """The failed trials of an experiment by kind, the most frequent kind first."""
    kinds: dict[str, list[Failure]] = {}
    for trial in experiment.of(State.FAILED):
        found = read_failure(trial)
        kinds.setdefault(found.kind, []).append(found)
    return dict(sorted(kinds.items(), key=lambda kind: -len(kind[1])))
