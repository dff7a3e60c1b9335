"""The run directory: one folder per trial, whose files are written whole or not at all."""

import json
import os
import tempfile
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from meshfit.errors import StoreError
from meshfit.paths import write_error_message

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

RESULT = "result.json"
FAILURE = "failure.json"
CHECKPOINT = "checkpoint.pt"
LOG = "trial.log"
PROGRESS = "progress.json"
PLAN = "plan.json"
CONFIG = "config.yaml"
LOCK = ".lock"
Result = dict[str, Any]


@dataclass(frozen=True)
class RunDirectory:
    """A run directory. A trial is complete once its `result.json` exists, which is written last."""

    root: Path

    def folder(self, trial: "Trial") -> Path:
        """The folder of a trial, which need not exist yet."""
        return self.root / trial.folder

    def result(self, trial: "Trial") -> Result | None:
        """Read the result of a trial; None if it is not complete.

        Raises:
            StoreError: it cannot be read.
        """
        return self._read(trial, RESULT)

    def is_complete(self, trial: "Trial") -> bool:
        """Whether a trial has a result."""
        return (self.folder(trial) / RESULT).is_file()

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
        write_atomically(self.folder(trial) / name, content, lasting=lasting)

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
            raise StoreError(f"{path}: {write_error_message(path, error)}") from error

    def remove(self, trial: "Trial", *names: str) -> None:
        """Remove files of a trial, if they exist."""
        for name in names:
            (self.folder(trial) / name).unlink(missing_ok=True)

    def _read(self, trial: "Trial", name: str) -> Result | None:
        path = self.folder(trial) / name
        return read_json(path) if path.is_file() else None


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
    except ValueError as error:
        raise StoreError(f"{path}: not valid JSON: {error}; delete it to have the trial run again") from None
    if not isinstance(content, dict):
        raise StoreError(f"{path}: expected a JSON object, got a {type(content).__name__}")
    return content


def now() -> str:
    """The time in UTC, to the second, in ISO 8601."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def json_text(content: Result) -> str:
    """Return the text of a JSON file.

    Raises:
        ValueError: a number is NaN or infinite, which JSON does not have.
    """
    return json.dumps(content, indent=2, allow_nan=False) + "\n"
