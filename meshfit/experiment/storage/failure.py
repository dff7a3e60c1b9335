"""`failure.json`: kind, message and place of a trial's failure."""

import traceback
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from meshfit.errors import MeshfitError, StoreError
from meshfit.experiment.storage.file_models import FailureContent, fault_in
from meshfit.experiment.storage.run_directory import (
    FAILURE,
    LOG,
    Result,
    RunDirectory,
    is_of_folder,
    now,
    read_json,
)
from meshfit.fitting.external.tools import ToolError

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

LAST_GOOD = "last_good.ply"
UNREADABLE = "unreadable"
"""Kind of a failure whose record is damaged."""
_MEMORY_MESSAGES = ("out of memory", "can't allocate memory", "cannot allocate memory", "not enough memory")
_UNLOADABLE = "failed to map segment"
"""Of a library that memory has no room for."""


class FailureKind(StrEnum):
    """Kind of a failure."""

    DIVERGED = "diverged"
    """A step of the fit was not finite."""
    OUT_OF_MEMORY = "out-of-memory"
    """Memory could not be allocated."""
    KILLED = "killed"
    """The process was killed from outside."""
    TOOL = "tool"
    """An external tool failed, or wrote nothing that can be used."""
    TIME_LIMIT = "time-limit"
    """An external tool took longer than its settings allow."""
    MEMORY_LIMIT = "memory-limit"
    """An external tool took more memory than its settings allow."""
    INPUT = "input"
    """A mesh or a setting cannot be used."""
    ERROR = "error"
    """Any unforeseen error; the record holds the traceback."""


RETRIED = frozenset({FailureKind.KILLED, FailureKind.OUT_OF_MEMORY})
"""Kinds that depend on what else the machine is doing; the others would only recur."""


def failure_kind(error: Exception) -> FailureKind:
    """Classify an error that a trial raised."""
    from meshfit.fitting.problem import Diverged  # which takes numpy, and reading a failure does not

    if isinstance(error, Diverged):
        return FailureKind.DIVERGED
    if isinstance(error, ToolError):
        return FailureKind(error.kind)
    if isinstance(error, MeshfitError):
        return FailureKind.INPUT
    # torch raises a RuntimeError, with a class of its own on CUDA only.
    by_torch = isinstance(error, RuntimeError) and any(words in str(error).lower() for words in _MEMORY_MESSAGES)
    by_linker = isinstance(error, ImportError | OSError) and _UNLOADABLE in str(error)
    is_memory = by_torch or by_linker or isinstance(error, MemoryError)
    return FailureKind.OUT_OF_MEMORY if is_memory else FailureKind.ERROR


def failure_record(trial: "Trial", error: Exception, step: int | None, attempts: int) -> Result:
    """Return the record of a trial that raised an error.

    Args:
        trial: the trial.
        error: the error that it raised.
        step: the last step of the fit; None if there was none.
        attempts: the number of failed attempts, including this one.
    """
    from meshfit.fitting.problem import Diverged

    kind = failure_kind(error)
    record = _record(trial, kind, str(error), step, attempts) | {"error": type(error).__name__}
    if isinstance(error, Diverged):
        return record | {"step": error.step, "term": error.term, "last_good": LAST_GOOD}
    if kind is FailureKind.ERROR:
        return record | {"traceback": traceback.format_exception(error)}
    return record


def killed_record(trial: "Trial", step: int | None, attempts: int) -> Result:
    """Return the record of a trial whose process was killed."""
    times = {1: "", 2: " twice"}.get(attempts, f" {attempts} times")
    message = f"the process that ran it was killed{times}; perhaps there was not enough memory"
    return _record(trial, FailureKind.KILLED, message, step, attempts) | {"error": None}


def failed_attempts(trial: "Trial", store: RunDirectory) -> int:
    """The number of failed attempts at a trial since it was last complete."""
    try:
        record = store.failure(trial)
    except StoreError:  # damaged, and about to be overwritten
        return 0
    if record is None or fault_in(FailureContent, record) is not None:
        return 0
    return FailureContent.model_validate(record).attempts


def _record(trial: "Trial", kind: FailureKind, message: str, step: int | None, attempts: int) -> Result:
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


@dataclass(frozen=True)
class Failure:
    """A recorded failure.

    Attributes:
        kind: a `FailureKind`, or `unreadable` where the record is damaged.
        message: the error in one line.
        step: the step of the fit at which it occurred; None if there was none.
        path: the file with the details: the log of the trial, or the record where there is no log.
        record: the whole record.
    """

    kind: str
    message: str
    step: int | None
    path: Path
    record: Result


def read_failure(folder: Path) -> Failure:
    """Read why the trial in a folder failed; a damaged record is reported as `unreadable`."""
    path = folder / FAILURE
    try:
        record = read_json(path)
    except StoreError as error:
        return Failure(UNREADABLE, str(error), None, path, {})
    if (fault := fault_in(FailureContent, record)) is not None:
        return Failure(UNREADABLE, f"{path}: not the record of a failure: {fault}", None, path, {})
    content = FailureContent.model_validate(record)
    if content.identity is not None and not is_of_folder(folder, content.identity):
        return Failure(UNREADABLE, f"{path}: the failure of another trial, {content.identity[:10]}", None, path, {})
    log = folder / LOG
    message = " ".join(content.message.split())
    return Failure(content.kind, message, content.step, log if log.is_file() else path, record)
