"""The run directory: one folder per trial, whose files are written whole or not at all."""

import json
import math
import os
import re
import sys
import tempfile
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from meshfit.config.path_parts import TRIAL_FOLDER
from meshfit.errors import StoreError
from meshfit.experiment.storage.file_models import ResultContent, fault_in, shortened_value
from meshfit.experiment.storage.mesh_files import fault_in_size
from meshfit.measuring.metrics import METRICS, possible_range
from meshfit.paths import write_error_message

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

RESULT = "result.json"
FAILURE = "failure.json"
CHECKPOINT = "checkpoint.pt"
LOG = "trial.log"
PROGRESS = "progress.json"
CONFIG = "config.yaml"
TRACE = "trace.csv"
TIMES = "times.csv"
"""Seconds of fitting until each row of the trace; the only file of a trial's numbers that differs from run to run."""
CORRESPONDENCE = "correspondence.csv"
LOCK = ".lock"
Result = dict[str, Any]

_SUFFIXES = (".json", ".pt", ".log", ".csv", ".yaml", ".ply", ".npz")
"""Suffixes of the files of a trial."""
# The temporary names that `write_atomically` uses.
_HALF_WRITTEN = re.compile(r"\..+\.[a-z0-9_]{8}")

_REPEATED = "the next `meshfit run` repeats the trial"


@dataclass(frozen=True)
class RunDirectory:
    """A run directory. A trial is complete once it has a valid `result.json`, which is written last.

    Attributes:
        root: its path.
        carries_targets: whether targets are copied into it.
    """

    root: Path
    carries_targets: bool = True

    def folder(self, trial: "Trial") -> Path:
        """The folder of a trial, which need not exist yet."""
        return self.root / trial.folder

    def result(self, trial: "Trial") -> Result | None:
        """Read the result of a trial; None if it is not complete, or damaged."""
        try:
            result = read_result(self.folder(trial))
        except StoreError:
            return None
        return None if result is None or result["identity"] != trial.identity else result

    def is_complete(self, trial: "Trial") -> bool:
        """Whether a trial has a result that is not damaged."""
        return self.result(trial) is not None

    def failure(self, trial: "Trial") -> Result | None:
        """Read the record of a trial's failure; None if there is none.

        Raises:
            StoreError: it cannot be read.
        """
        return self._read(trial, FAILURE)

    def lock(self, trial: "Trial") -> FileLock:
        """Return a lock on a trial's folder; the system releases it when its holder dies, however it dies.

        Raises:
            StoreError: the folder cannot be created.
        """
        folder = self.folder(trial)
        make_folder(folder)
        return FileLock(folder / LOCK)

    def write(self, trial: "Trial", name: str, content: bytes | str, *, lasting: bool = True) -> None:
        """Write a file of a trial as `write_atomically` does.

        Raises:
            StoreError: it cannot be written.
        """
        try:
            write_atomically(self.folder(trial) / name, content, lasting=lasting)
        except StoreError:
            self._require_folder(trial)
            raise

    def append(self, trial: "Trial", name: str, text: str) -> None:
        """Append to a text file of a trial.

        Raises:
            StoreError: it cannot be written.
        """
        path = self.folder(trial) / name
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            self._require_folder(trial)
            raise StoreError(f"{path}: {write_error_message(path, error)}") from error

    def remove(self, trial: "Trial", *names: str) -> None:
        """Remove files of a trial, if they exist.

        Raises:
            StoreError: one cannot be removed.
        """
        for name in names:
            path = self.folder(trial) / name
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise StoreError(f"{path}: cannot be removed: {error.strerror}") from error

    def clear(self, trial: "Trial") -> None:
        """Remove what earlier attempts at a trial left half-written; its lock must be held.

        A folder in the place of a file is set aside under another name, and a link in the place of the log is removed.

        Raises:
            StoreError: it cannot be removed or renamed.
        """
        for path in self.folder(trial).iterdir():
            if path.suffix in _SUFFIXES and path.is_dir() and not path.is_symlink():
                aside = path.with_name(f"{path.name}-set-aside-{uuid.uuid4().hex[:8]}")
                try:
                    path.rename(aside)
                except OSError as error:
                    raise StoreError(f"{path}: a folder in the place of a file: {error.strerror}; remove it") from error
        if (self.folder(trial) / LOG).is_symlink():
            self.remove(trial, LOG)
        self.remove(trial, *filter(is_half_written, (path.name for path in self.folder(trial).glob(".*"))))

    def _require_folder(self, trial: "Trial") -> None:
        folder = self.folder(trial)
        if not folder.is_dir():
            raise StoreError(f"{folder}: moved or removed during the run; run the same command again") from None

    def _read(self, trial: "Trial", name: str) -> Result | None:
        path = self.folder(trial) / name
        return read_json(path) if path.is_file() else None


def is_half_written(name: str) -> bool:
    """Whether a file was being written when its process was killed."""
    return _HALF_WRITTEN.fullmatch(name) is not None


def make_folder(folder: Path) -> None:
    """Create a folder and its parents.

    Raises:
        StoreError: it cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be created: {error.strerror}; choose another place with --runs") from error


def write_atomically(path: Path, content: bytes | str, *, lasting: bool = True) -> None:
    """Write a file so that a reader sees all of it or nothing, even after a crash.

    Args:
        path: path of the file, in a folder that exists.
        content: content of the file; text is encoded as UTF-8.
        lasting: wait until the file would survive a loss of power.

    Raises:
        StoreError: it cannot be written; the previous file is left as it was.
    """
    data = content.encode() if isinstance(content, str) else content
    part = None
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            part = Path(file.name)
            file.write(data)
            file.flush()
            if lasting:
                os.fsync(file.fileno())
        part.chmod(0o644)
        part.replace(path)
    except OSError as error:
        if part is not None:
            part.unlink(missing_ok=True)
        raise StoreError(f"{path}: {write_error_message(path, error)}") from error


def read_json(path: Path) -> Result:
    """Read a JSON object.

    Raises:
        StoreError: the file cannot be read, or holds something else.
    """
    try:
        if path.exists() and not path.is_file():
            raise StoreError(f"{path}: expected a file, got {'a folder' if path.is_dir() else 'something else'}")
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else error
        raise StoreError(f"{path}: not valid JSON: {reason}; delete it to have the trial run again") from None
    if not isinstance(content, dict):
        raise StoreError(f"{path}: expected a JSON object, got a {type(content).__name__}")
    return content


def read_result(folder: Path) -> Result | None:
    """Read the result of the trial in a folder; None if it has none.

    Raises:
        StoreError: it cannot be read, lacks what every result has, has a value that no result can have, or is that of
            another trial; or the fitted mesh has another size than it was written with.
    """
    path = folder / RESULT
    if not os.path.lexists(path):
        return None
    try:
        result = read_json(path)
    except StoreError as error:
        raise StoreError(f"{str(error).partition('; delete it')[0]}; {_REPEATED}") from None
    problem = problem_with(result) or _fault_in_identity(folder, result["identity"]) or fault_in_size(folder, result)
    if problem is not None:
        raise StoreError(f"{path}: {problem}; {_REPEATED}")
    return result


def is_of_folder(folder: Path, identity: str) -> bool:
    """Whether a file in the folder of a trial is that of its trial, as far as the name of the folder tells."""
    named = TRIAL_FOLDER.fullmatch(folder.name)
    return named is None or identity.startswith(named[2])


def _fault_in_identity(folder: Path, identity: str) -> str | None:
    return None if is_of_folder(folder, identity) else f"the result of another trial, {identity[:10]}"


def problem_with(result: Result) -> str | None:
    """Return what is wrong with a result; None if nothing is."""
    if (fault := fault_in(ResultContent, result)) is not None:
        return f"not the result of a trial: {fault}"
    for name, keys, least, largest in _metrics_in_results():
        value: Any = result
        for key in keys:
            if not isinstance(value, dict):
                return f"{name.partition('.')[0]} is {shortened_value(value)}, expected an object"
            value = value.get(key, {} if value is result and "." in name else None)
        if value is None or (type(value) is float and least <= value <= largest):
            continue
        if (problem := _impossible(name, value)) is not None:
            return problem
    return None


@cache
def _metrics_in_results() -> list[tuple[str, list[str], float, float]]:
    """Return each metric with its keys in a result, and the range of floats that need no other check."""
    ranges = {
        name: (math.inf, -math.inf) if metric.format == "d" else possible_range(name)
        for name, metric in METRICS.items()
    }
    return [
        (name, name.split("."), least, min(largest, sys.float_info.max)) for name, (least, largest) in ranges.items()
    ]


def _impossible(name: str, value: object) -> str | None:
    if METRICS[name].format == "":
        return None if isinstance(value, bool) else f"{name} is {shortened_value(value)}, expected true or false"
    if isinstance(value, bool) or not (isinstance(value, int | float) and abs(value) <= sys.float_info.max):
        return f"{name} is {shortened_value(value)}, expected a finite number"
    if METRICS[name].format == "d" and not isinstance(value, int):
        return f"{name} is {shortened_value(value)}, expected a whole number"
    least, largest = possible_range(name)
    return None if least <= value <= largest else f"{name} is {shortened_value(value)}, which is impossible"


def damage(path: Path) -> str | None:
    """Return the path of a `result.json` and what is wrong with it; None if it is valid, or missing."""
    try:
        read_result(path.parent)
    except StoreError as error:
        return str(error).removesuffix(f"; {_REPEATED}")
    return None


def now() -> str:
    """The time in UTC, to the second, in ISO 8601."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def json_text(content: Result) -> str:
    """Return the text of a JSON file.

    Raises:
        ValueError: a number is NaN or infinite, which JSON does not have.
    """
    return json.dumps(content, indent=2, allow_nan=False) + "\n"
