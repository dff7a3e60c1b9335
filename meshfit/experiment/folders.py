"""The folders of trials as they lie there, found by their names alone, and the state that each is in."""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path

from filelock import FileLock, Timeout

from meshfit.errors import StoreError
from meshfit.experiment.progress_file import FRESH_SECONDS, read_progress, this_host
from meshfit.experiment.store import FAILURE, LOCK, PLAN, RESULT

_NAME = re.compile(r"seed-(\d+)-([0-9a-f]{10})")
_ENDINGS = {RESULT, FAILURE}


class State(StrEnum):
    """Where a trial stands; `interrupted` is one that was begun, and is neither complete nor failed nor running."""

    COMPLETE = "complete"
    RUNNING = "running"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    WAITING = "waiting"


@dataclass(frozen=True)
class TrialFolder:
    """A trial's folder and the names of what is in it; an empty set where the folder is not there yet."""

    path: Path
    files: frozenset[str]

    @property
    def is_named(self) -> bool:
        """Whether its name is one that a run gives, `seed-N-HASH`."""
        return _NAME.fullmatch(self.path.name) is not None

    @property
    def seed(self) -> int | None:
        """The seed, as the name has it."""
        match = _NAME.fullmatch(self.path.name)
        return int(match[1]) if match else None

    @property
    def identity(self) -> str:
        """The first ten digits of the trial's identity, as the name has them."""
        match = _NAME.fullmatch(self.path.name)
        return match[2] if match else ""

    @property
    def experiment(self) -> Path:
        """The absolute path of the experiment's folder, three levels up."""
        parents = Path(os.path.abspath(self.path)).parents  # noqa: PTH100  as written: links stay links
        return parents[min(2, len(parents) - 1)]

    @property
    def order(self) -> tuple[str, int, str]:
        """What to sort by: seed 2 comes before seed 10."""
        return (str(self.path.parent), -1 if self.seed is None else self.seed, self.path.name)


@dataclass(frozen=True)
class Scan:
    """What lies under a folder: folders of trials, and folders of experiments that hold a plan."""

    trials: tuple[TrialFolder, ...]
    planned: tuple[Path, ...]


def scan(root: Path) -> Scan:
    """Look through a run directory, or a folder in it; symbolic links in it are not followed, no file is read.

    Raises:
        StoreError: no such directory.
    """
    if not root.exists():
        raise StoreError(f"{root}: no such run directory; `meshfit run` makes one")
    if not root.is_dir():
        raise StoreError(f"{root}: not a directory; a run directory, or a folder in one, is needed")
    trials, planned = list[TrialFolder](), list[Path]()
    for path, files in _folders(root):
        folder = TrialFolder(path, files)
        if folder.is_named or files & _ENDINGS:
            trials.append(folder)
        elif PLAN in files:
            planned.append(path)
    return Scan(tuple(sorted(trials, key=lambda trial: trial.order)), tuple(sorted(planned)))


def look_at(path: Path) -> TrialFolder:
    """A trial's folder as it is now."""
    try:
        return TrialFolder(path, frozenset(os.listdir(path)))  # noqa: PTH208  names are all that is needed
    except FileNotFoundError:
        return TrialFolder(path, frozenset())


def state_of(folder: TrialFolder, now: datetime) -> State:
    """The state that a trial is in."""
    if RESULT in folder.files:
        return State.COMPLETE
    if is_running(folder, now):
        return State.RUNNING
    if (folder.path / RESULT).exists():
        return State.COMPLETE  # it was still running when its folder was looked through
    return state_at_rest(folder)


def state_at_rest(folder: TrialFolder) -> State:
    """The state that a trial is in if it does not run."""
    if RESULT in folder.files:
        return State.COMPLETE
    if FAILURE in folder.files:
        return State.FAILED
    return State.INTERRUPTED if folder.files else State.WAITING


def is_running(folder: TrialFolder, now: datetime) -> bool:
    """Whether a living process holds the trial's lock.

    Where the lock says nothing, since it cannot be tried here or since another host need not see it, what counts is
    whether the trial's progress was written within the last minute.
    """
    if LOCK not in folder.files:
        return False
    lock = FileLock(folder.path / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return True
    except (OSError, NotImplementedError):
        return _is_fresh(folder.path, now)
    lock.release()
    return _is_fresh(folder.path, now, elsewhere=True)


def _is_fresh(folder: Path, now: datetime, *, elsewhere: bool = False) -> bool:
    progress = read_progress(folder)
    if progress is None or (elsewhere and progress.host == this_host()):
        return False
    return progress.silent_seconds(now) < FRESH_SECONDS


def _folders(root: Path) -> Iterator[tuple[Path, frozenset[str]]]:
    left = [root]
    while left:
        path = left.pop()
        files, below = set[str](), list[Path]()
        with os.scandir(path) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    below.append(path / entry.name)
                else:
                    files.add(entry.name)
        yield path, frozenset(files)
        if _NAME.fullmatch(path.name) is None:
            left += below
