"""Remove failed and interrupted trials, half-written files and unused targets from a run directory."""

import os
import shutil
import stat
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from meshfit.config.path_parts import TARGETS
from meshfit.errors import StoreError
from meshfit.experiment.status.scan import (
    ScannedExperiment,
    ScannedTrial,
    TrialFolder,
    absolute,
    scan,
    status_at_rest,
    status_of,
    trial_folder,
)
from meshfit.experiment.storage.run_directory import (
    LOCK,
    Result,
    is_half_written,
    read_result,
)
from meshfit.experiment.storage.targets import remove_targets, unused_targets
from meshfit.experiment.trial_status import TrialStatus


@dataclass(frozen=True)
class Removed:
    """A removal, done or planned: a trial's whole folder, or half-written files of a complete trial.

    Attributes:
        trial: the trial.
        names: the half-written files; empty if the whole folder is removed.
        size: in bytes.
    """

    trial: ScannedTrial
    names: tuple[str, ...]
    size: int


@dataclass(frozen=True)
class Cleaned:
    """The outcome of a cleaning: what was removed, and the trials that were left because they are running.

    Attributes:
        removed: trials, and half-written files of trials.
        running: the trials that were left.
        targets: carried targets that no complete trial uses, with their size in bytes.
    """

    removed: tuple[Removed, ...]
    running: tuple[ScannedTrial, ...]
    targets: Mapping[Path, int] = field(default_factory=dict)


def clean(
    experiments: Sequence[ScannedExperiment],
    statuses: Collection[TrialStatus],
    roots: Sequence[Path],
    *,
    dry_run: bool = False,
) -> Cleaned:
    """Remove the folders of trials of some statuses, and the folders above them that become empty.

    With interrupted trials, half-written files in the folders of complete trials are removed too. A trial's lock is
    held while something in its folder is removed, and its status is checked again under the lock. Links are not
    followed. Carried targets that no complete trial of the run directory uses are removed too, unless a trial is
    running, or one's result or a link hides which it uses; trials that are not complete carry theirs again.

    Args:
        experiments: the experiments to clean.
        statuses: failed, interrupted, or both.
        roots: folders to keep, even if they become empty, with all above them.
        dry_run: report what would be removed, and remove nothing.

    Raises:
        StoreError: something cannot be removed.
    """
    removed, running = list[Removed](), list[ScannedTrial]()
    for trial in (trial for experiment in experiments for trial in experiment.trials if trial.folder.is_named):
        removable = _removable(trial, trial.folder, statuses)
        if trial.status is TrialStatus.RUNNING:
            running.append(trial)
        elif removable is not None:
            try:
                removed += [removable] if dry_run else _remove(trial, statuses)
            except Timeout:
                running.append(trial)
    gone = {absolute(removal.trial.path) for removal in removed if not removal.names}
    if not dry_run:
        _remove_empty(gone, roots)
    targets = dict[Path, int]()
    for root in sorted({experiment.folder.parent for experiment in experiments}):
        unused = _unused_targets(root, gone)
        targets |= {path: _size(path) for path in unused}
        if unused and not dry_run:
            remove_targets(root, unused)
    return Cleaned(tuple(removed), tuple(running), targets)


def _unused_targets(root: Path, gone: Collection[Path]) -> list[Path]:
    """Return the carried targets that no complete trial uses; none where that is not certain."""
    if not (root / TARGETS).is_dir() or any(path.is_symlink() for path in root.iterdir()):
        return []
    records = list[Result]()
    now = datetime.now(UTC)
    for folder in scan(root).trials:
        status = TrialStatus.WAITING if absolute(folder.path) in gone else status_of(folder, now)
        if status in (TrialStatus.RUNNING, TrialStatus.DAMAGED):
            return []
        if status is TrialStatus.COMPLETE and (record := read_result(folder.path)) is not None:
            records.append(record)
    return unused_targets(root, records)


def _removable(trial: ScannedTrial, folder: TrialFolder, statuses: Collection[TrialStatus]) -> Removed | None:
    """Return the part of a trial that is to be removed if the trial is not running."""
    status = status_at_rest(folder)
    if status is TrialStatus.COMPLETE and TrialStatus.INTERRUPTED in statuses:
        names = tuple(sorted(filter(is_half_written, folder.files)))
        return Removed(trial, names, sum(map(_size, (folder.path / name for name in names)))) if names else None
    if status is TrialStatus.COMPLETE or status not in statuses:
        return None
    return Removed(trial, (), sum(map(_size, folder.path.rglob("*"))))


def _remove(trial: ScannedTrial, statuses: Collection[TrialStatus]) -> list[Removed]:
    """Remove the removable part of a trial, determined again while its lock is held.

    Raises:
        Timeout: another process holds the lock.
        StoreError: something cannot be removed.
    """
    lock = FileLock(trial.path / LOCK)
    try:
        with lock.acquire(timeout=0):
            removable = _removable(trial, trial_folder(trial.path), statuses)
            if removable is None:
                return []
            for name in removable.names or sorted(trial_folder(trial.path).files - {LOCK}):
                _remove_file_or_folder(trial.path / name)
            if not removable.names:
                _remove_lock(trial.path / LOCK)
        if not removable.names:
            _remove_folder(trial.path)
    except Timeout:
        raise
    except OSError as error:
        raise StoreError(f"{error.filename or trial.path}: cannot be removed: {error.strerror}") from error
    return [removable]


def _remove_lock(path: Path) -> None:
    """Remove a lock while it is held, so that a process that waits for it notices; Windows does not allow that."""
    with suppress(PermissionError):
        path.unlink()


def _remove_folder(path: Path) -> None:
    """Remove a folder and a lock left in it, unless another process has begun to use it."""
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
    """Remove the folders of schemes, targets and experiments that have become empty."""
    kept = set(map(absolute, roots))
    for folder in folders:
        for above in absolute(folder).parents[:3]:
            if above in kept or not any(above.is_relative_to(root) for root in kept):
                break
            try:
                above.rmdir()
            except OSError:
                break


def _size(path: Path) -> int:
    try:
        status = path.lstat()
    except OSError:
        return 0
    return status.st_size if stat.S_ISREG(status.st_mode) else 0
