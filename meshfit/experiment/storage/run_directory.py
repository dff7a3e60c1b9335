"""The run directory: one folder a trial, written so that what is there is whole."""

import json
import os
import tempfile
from collections.abc import Iterable, Iterator
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
LOCK = ".lock"
Result = dict[str, Any]


@dataclass(frozen=True)
class RunDirectory:
    """A run directory. `result.json` is written last in a trial's folder: where it stands, the trial is complete."""

    root: Path

    def folder(self, trial: "Trial") -> Path:
        """The folder of a trial, which need not exist yet."""
        return self.root / trial.folder

    def result(self, trial: "Trial") -> Result | None:
        """The result of a trial, or None if it is not complete.

        Raises:
            StoreError: it cannot be read.
        """
        path = self.folder(trial) / RESULT
        return read_json(path) if path.is_file() else None

    def is_complete(self, trial: "Trial") -> bool:
        """Whether a trial has a result."""
        return (self.folder(trial) / RESULT).is_file()

    def failure(self, trial: "Trial") -> Result | None:
        """The record of a trial's failure, or None if there is none.

        Raises:
            StoreError: it cannot be read.
        """
        path = self.folder(trial) / FAILURE
        return read_json(path) if path.is_file() else None

    def lock(self, trial: "Trial") -> FileLock:
        """A lock on a trial's folder, which the system releases when its holder dies, however it dies.

        Raises:
            StoreError: the folder cannot be made.
        """
        folder = self.folder(trial)
        make_folder(folder)
        return FileLock(folder / LOCK)

    def write(self, trial: "Trial", name: str, content: bytes | str, *, lasting: bool = True) -> None:
        """Write a file of a trial, whole or not at all.

        Args:
            trial: whose file.
            name: of the file.
            content: of the file.
            lasting: wait until it would survive a loss of power.

        Raises:
            StoreError: it cannot be written.
        """
        write_atomically(self.folder(trial) / name, content, lasting=lasting)

    def append(self, trial: "Trial", name: str, text: str) -> None:
        """Add to the end of a text file of a trial.

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
        """Remove files of a trial that are no longer wanted, if they are there."""
        for name in names:
            (self.folder(trial) / name).unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make a folder and those above it.

    Raises:
        StoreError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be made: {error.strerror}; choose another place with --runs") from error


def write_atomically(path: Path, content: bytes | str, *, lasting: bool = True) -> None:
    """Write a file so that a reader, and a crash, see all of it or nothing.

    Args:
        path: of the file.
        content: of the file.
        lasting: wait until it would survive a loss of power.

    Raises:
        StoreError: it cannot be written; what was there before is left as it was.
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
        StoreError: it cannot be read, or is not one.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise StoreError(f"{path}: not valid JSON: {error}; delete it to have the trial run again") from None
    if not isinstance(content, dict):
        raise StoreError(f"{path}: found a {type(content).__name__}, a JSON object is needed")
    return content


def now() -> str:
    """The time in UTC, to the second, as ISO 8601 has it."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def write_json(content: Result) -> str:
    """The text of a JSON file; NaN and infinity, which JSON has not, are refused."""
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def read_results(roots: Iterable[Path]) -> list[Result]:
    """Every complete result under some run directories, or under folders of them, in the order of their paths.

    Raises:
        StoreError: no such directory, nothing complete in any of them, or a result that cannot be read.
    """
    paths: list[Path] = []
    for root in roots:
        if not root.exists():
            raise StoreError(f"{root}: no such run directory; `meshfit run` makes one")
        paths += _results_below(root)
    if not paths:
        raise StoreError(f"no complete trial under {', '.join(map(str, roots))}; `meshfit run` makes them")
    return [read_json(path) | {"folder": str(path.parent)} for path in dict.fromkeys(paths)]


def _results_below(folder: Path) -> Iterator[Path]:
    """Every result at any depth, in the order of their paths; links to folders are not followed."""
    try:
        with os.scandir(folder) as found:
            entries = sorted(found, key=lambda entry: entry.name)
    except (NotADirectoryError, PermissionError):
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from _results_below(Path(entry))
        elif entry.name == RESULT:
            yield Path(entry)
