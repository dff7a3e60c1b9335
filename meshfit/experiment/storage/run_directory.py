"""The run directory: one folder per trial, whose files are written whole or not at all."""

import json
import os
import re
import sys
import tempfile
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from meshfit.errors import StoreError
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

# The temporary names that `write_atomically` uses.
_HALF_WRITTEN = re.compile(r"\..+\.[a-z0-9_]{8}")

_LONGEST_VALUE = 60
_REPEATED = "the next `meshfit run` repeats the trial"
# The entries of a result that tables cannot do without, and their types.
_ESSENTIAL = {
    "schema_version": int,
    "identity": str,
    "experiment": str,
    "target": str,
    "target_title": str,
    "scheme": str,
    "seed": int,
    "settings": Mapping,
}
# Others that have to be of a type where there are some.
_OPTIONAL = {"inputs": Mapping, "seconds": Mapping, "cloud": Mapping, "warnings": list, "shortfalls": list}
_TYPES = {**_ESSENTIAL, **_OPTIONAL}


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
            return read_result(self.folder(trial))
        except StoreError:
            return None

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

    def remove_half_written(self, trial: "Trial") -> None:
        """Remove what earlier attempts at a trial were writing when they were killed; its lock must be held.

        Raises:
            StoreError: it cannot be removed.
        """
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
        StoreError: it cannot be read, lacks what every result has, or has a metric that no result can have.
    """
    path = folder / RESULT
    if not path.is_file():
        return None
    try:
        result = read_json(path)
    except StoreError as error:
        raise StoreError(f"{str(error).partition('; delete it')[0]}; {_REPEATED}") from None
    if (problem := problem_with(result)) is not None:
        raise StoreError(f"{path}: {problem}; {_REPEATED}")
    return result


def problem_with(result: Result) -> str | None:
    """Return what is wrong with a result; None if nothing is."""
    for key, kind in _TYPES.items():
        if key not in result and key in _ESSENTIAL:
            return f"not the result of a trial: no {key}"
        if key in result and not isinstance(result[key], kind):
            return f"not the result of a trial: {key} is {_shortened(result[key])}"
    for key, otherwise in (("targets", None), ("schemes", [""])):
        names = result["settings"].get(key, otherwise)
        if not (isinstance(names, list) and names and isinstance(names[0], str)):
            return f"not the result of a trial: no settings.{key}"
    for name in METRICS:
        value: Any = result
        for key in name.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        if value is not None and (problem := _impossible(name, value)) is not None:
            return problem
    return None


def _impossible(name: str, value: object) -> str | None:
    if not (isinstance(value, int | float) and abs(value) <= sys.float_info.max):
        return f"{name} is {_shortened(value)}, expected a finite number"
    if METRICS[name].format == "d" and value != int(value):
        return f"{name} is {_shortened(value)}, expected a whole number"
    least, largest = possible_range(name)
    return None if least <= value <= largest else f"{name} is {_shortened(value)}, which is impossible"


def _shortened(value: object) -> str:
    return textwrap.shorten(json.dumps(value), _LONGEST_VALUE, placeholder=" …")


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
