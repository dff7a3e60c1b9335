"""Clean a run directory of what failed or was interrupted; what is complete or runs is left as it is."""

import os
import re
import shutil
import stat
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from meshfit.errors import StoreError
from meshfit.experiment.status.scan import ExperimentOverview, Standing, State, TrialFolder, look_at, state_at_rest
from meshfit.experiment.storage.run_directory import LOCK

# As `write_atomically` calls a file that it has not put in its place yet.
_HALF_WRITTEN = re.compile(r"\..+\.[a-z0-9_]{8}")


@dataclass(frozen=True)
class Removed:
    """What was removed, or would be: a trial's folder, or half-written files in the folder of a complete trial.

    Attributes:
        trial: of which it was.
        names: the half-written files; none where the whole folder went.
        size: in bytes.
    """

    trial: Standing
    names: tuple[str, ...]
    size: int


@dataclass(frozen=True)
class Cleaned:
    """What a cleaning did: what went, and which trials were left because they run."""

    removed: tuple[Removed, ...]
    running: tuple[Standing, ...]


def is_half_written(name: str) -> bool:
    """Whether a file is one that was being written when its process was killed."""
    return _HALF_WRITTEN.fullmatch(name) is not None


def clean(
    experiments: Sequence[ExperimentOverview],
    states: Collection[State],
    roots: Sequence[Path],
    *,
    dry_run: bool = False,
) -> Cleaned:
    """Remove the folders of trials in some states, and the folders above them that this leaves empty.

    With interrupted trials go the half-written files in folders of complete ones. Every folder's lock is held while
    something in it is removed, and its state is told anew under the lock. Symbolic links are not followed.

    Args:
        experiments: where to clean.
        states: what to remove: failed trials, interrupted ones, or both.
        roots: folders that are not removed, even if they become empty, nor any above them.
        dry_run: remove nothing, only say what would be.

    Raises:
        StoreError: something cannot be removed.
    """
    removed, running = list[Removed](), list[Standing]()
    for trial in (trial for experiment in experiments for trial in experiment.trials if trial.folder.is_named):
        found = _removable(trial, trial.folder, states)
        if trial.state is State.RUNNING:
            running.append(trial)
        elif found is not None:
            try:
                removed += [found] if dry_run else _remove(trial, states)
            except Timeout:
                running.append(trial)
    if not dry_run:
        _remove_empty((found.trial.path for found in removed if not found.names), roots)
    return Cleaned(tuple(removed), tuple(running))


def _removable(trial: Standing, folder: TrialFolder, states: Collection[State]) -> Removed | None:
    """What of a trial that does not run is to go."""
    state = state_at_rest(folder)
    if state is State.COMPLETE and State.INTERRUPTED in states:
        names = tuple(sorted(filter(is_half_written, folder.files)))
        return Removed(trial, names, sum(map(_size, (folder.path / name for name in names)))) if names else None
    wanted = state is not State.COMPLETE and state in states
    return Removed(trial, (), sum(map(_size, folder.path.rglob("*")))) if wanted else None


def _remove(trial: Standing, states: Collection[State]) -> list[Removed]:
    """Remove what is to go of a trial while its lock is held; what that is, is told anew.

    Raises:
        Timeout: another process holds the lock.
        StoreError: something cannot be removed.
    """
    lock = FileLock(trial.path / LOCK)
    try:
        with lock.acquire(timeout=0):
            found = _removable(trial, look_at(trial.path), states)
            if found is None:
                return []
            for name in found.names or sorted(look_at(trial.path).files - {LOCK}):
                _remove_file_or_folder(trial.path / name)
            if not found.names:
                _remove_lock(trial.path / LOCK)
        if not found.names:
            _remove_folder(trial.path)
    except Timeout:
        raise
    except OSError as error:
        raise StoreError(f"{error.filename or trial.path}: cannot be removed: {error.strerror}") from error
    return [found]


def _remove_lock(path: Path) -> None:
    """While it is held, so that who waits for it sees that it is gone; Windows lets nobody, and gets to it later."""
    with suppress(PermissionError):
        path.unlink()


def _remove_folder(path: Path) -> None:
    """The folder itself, and a lock that was left in it; unless another process has begun in it by now."""
    with suppress(OSError):
        if os.name == "nt":
            (path / LOCK).unlink(missing_ok=True)
        path.rmdir()


def _remove_file_or_folder(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _remove_empty(folders: Iterable[Path], roots: Sequence[Path]) -> None:
    """Remove the folders of schemes, targets and experiments that are empty now."""
    kept = {Path(os.path.abspath(root)) for root in roots}  # noqa: PTH100  as written: a run directory may be a link
    for folder in folders:
        for above in Path(os.path.abspath(folder)).parents[:3]:  # noqa: PTH100
            if above in kept or not any(above.is_relative_to(root) for root in kept):
                break
            try:
                above.rmdir()
            except OSError:
                break


def _size(path: Path) -> int:
    try:
        found = path.lstat()
    except OSError:
        return 0
    return found.st_size if stat.S_ISREG(found.st_mode) else 0
