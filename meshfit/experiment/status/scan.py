"""Scan of run directories: experiments, their trials, and the status of each by its files, result and lock."""

import os
import re
import warnings
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from meshfit.config.path_parts import PLAN, TRIAL_FOLDER
from meshfit.errors import ConfigError, MeshfitWarning, StoreError
from meshfit.experiment.storage.failure import Failure, read_failure
from meshfit.experiment.storage.plan_file import PlanFile, PlannedTrial, read_plan
from meshfit.experiment.storage.run_directory import FAILURE, LOCK, RESULT, damage
from meshfit.experiment.storage.trial_log import read_progress, this_host
from meshfit.experiment.trial_status import TrialStatus

SCANNED_STATUSES = (
    TrialStatus.COMPLETE,
    TrialStatus.RUNNING,
    TrialStatus.FAILED,
    TrialStatus.DAMAGED,
    TrialStatus.INTERRUPTED,
    TrialStatus.WAITING,
)
"""The statuses that a scan distinguishes, in the order in which they are listed."""

FEWEST_DIGITS = 4
"""The number of digits to which an identity can be abbreviated."""

_IDENTITY = re.compile(rf"[0-9a-f]{{{FEWEST_DIGITS},64}}")
_MOST_LISTED = 5


@dataclass(frozen=True)
class TrialFolder:
    """The folder of a trial and the names of the files in it, none if the folder does not exist yet."""

    path: Path
    files: frozenset[str]

    @property
    def is_named(self) -> bool:
        """Whether its name is of the form `seed-N-HASH`, which a run gives."""
        return TRIAL_FOLDER.fullmatch(self.path.name) is not None

    @property
    def seed(self) -> int | None:
        """The seed in its name."""
        match = TRIAL_FOLDER.fullmatch(self.path.name)
        return int(match[1]) if match else None

    @property
    def identity(self) -> str:
        """The first ten digits of the trial's identity, from its name."""
        match = TRIAL_FOLDER.fullmatch(self.path.name)
        return match[2] if match else ""

    @property
    def experiment(self) -> Path:
        """The absolute path of the experiment's folder, three levels up."""
        parents = absolute(self.path).parents
        return parents[min(2, len(parents) - 1)]

    @property
    def sort_key(self) -> tuple[str, int, str]:
        """A key that sorts seed 2 before seed 10."""
        return (str(self.path.parent), -1 if self.seed is None else self.seed, self.path.name)


@dataclass(frozen=True)
class ScannedTrial:
    """One trial of a run directory.

    Attributes:
        folder: its folder.
        status: its status.
        planned: its entry in the latest plan of the experiment, if there is one.
    """

    folder: TrialFolder
    status: TrialStatus
    planned: PlannedTrial | None = None

    @property
    def path(self) -> Path:
        """The path of its folder."""
        return self.folder.path

    @property
    def target(self) -> str:
        """The short name of the target, from the path."""
        return absolute(self.path).parents[1].name

    @property
    def scheme(self) -> str:
        """The spec of the scheme; the name of its folder if the trial is not in the plan."""
        return self.planned.scheme if self.planned else absolute(self.path).parent.name

    @property
    def seed(self) -> int | None:
        """The seed; None if neither the plan nor the folder's name holds it."""
        return self.planned.seed if self.planned else self.folder.seed

    @property
    def variant(self) -> str:
        """The variant; empty where there is none."""
        return self.planned.variant if self.planned else ""

    @property
    def identity(self) -> str:
        """The identity; its first ten digits if the trial is not in the plan."""
        return self.planned.identity if self.planned else self.folder.identity

    @property
    def label(self) -> str:
        """Target, scheme, variant and seed, to be read by a person; the path if they are not known."""
        if self.seed is None:
            return str(self.path)
        return " · ".join(filter(None, (self.target, self.scheme, self.variant, f"seed {self.seed}")))


@dataclass(frozen=True)
class ScannedExperiment:
    """One experiment: its folder, its latest plan, if there is one, and its trials, in the order of the plan.

    Trials that are not in the plan are in the order of their folders.
    """

    name: str
    folder: Path
    plan: PlanFile | None
    trials: tuple[ScannedTrial, ...]

    @property
    def counts(self) -> dict[TrialStatus, int]:
        """The number of trials of each status."""
        counted = Counter(trial.status for trial in self.trials)
        return {status: counted[status] for status in SCANNED_STATUSES}

    def of(self, status: TrialStatus) -> list[ScannedTrial]:
        """The trials of one status."""
        return [trial for trial in self.trials if trial.status is status]

    def failures_by_kind(self) -> dict[str, list[tuple[ScannedTrial, Failure]]]:
        """The failed trials by kind of failure, the most frequent kind first."""
        kinds: dict[str, list[tuple[ScannedTrial, Failure]]] = {}
        for trial in self.of(TrialStatus.FAILED):
            failure = read_failure(trial.path)
            kinds.setdefault(failure.kind, []).append((trial, failure))
        return dict(sorted(kinds.items(), key=lambda kind: -len(kind[1])))


def scan_experiments(
    roots: Sequence[Path], now: datetime, *, required: bool = True, complete: Collection[Path] = ()
) -> list[ScannedExperiment]:
    """Scan run directories, or folders in them, for experiments with at least one trial.

    Args:
        roots: the run directories or folders.
        now: the current time, from which the age of progress is counted.
        required: whether there has to be a trial.
        complete: absolute paths of the folders of trials that are known to be complete, whose results are not read.

    Raises:
        StoreError: no such directory, or no trial in any of them; of a plan that cannot be read, where there is one.

    Warns:
        MeshfitWarning: a plan cannot be read, so that its trials are those that have begun.
    """
    scans = [scan(root) for root in roots]
    begun: dict[Path, dict[Path, TrialFolder]] = {}
    for folder in (trial for scanned in scans for trial in scanned.trials):
        begun.setdefault(folder.experiment, {}).setdefault(absolute(folder.path), folder)
    planned = {absolute(path): path for scanned in scans for path in scanned.planned}
    within = [absolute(root) for root in roots]
    faults = list[StoreError]()
    experiments = [
        _experiment(planned.get(path, path), begun.get(path, {}), within, now, complete, faults)
        for path in sorted({*begun, *planned})
    ]
    experiments = [experiment for experiment in experiments if experiment.trials]
    if not experiments and required and faults:
        raise faults[0]
    for fault in faults:
        warnings.warn(f"trials that have not begun are not known: {fault}", MeshfitWarning, stacklevel=2)
    if not experiments and required:
        raise StoreError(f"no trial under {', '.join(map(str, roots))}; `meshfit run` makes them")
    return experiments


def _experiment(
    folder: Path,
    begun: Mapping[Path, TrialFolder],
    within: Sequence[Path],
    now: datetime,
    complete: Collection[Path],
    faults: list[StoreError],
) -> ScannedExperiment:
    plan = _plan(folder, faults)
    experiment = absolute(folder)
    planned = {experiment / entry.folder: entry for entry in plan.trials} if plan else {}
    folders = dict(begun)
    for path, entry in planned.items():
        if path not in folders and any(path.is_relative_to(root) for root in within):
            # The scan did not see it: it did not exist yet, or lies behind a link.
            folders[path] = TrialFolder(folder / entry.folder, frozenset())
    trials = [
        ScannedTrial(trial, TrialStatus.COMPLETE if path in complete else status_of(trial, now), planned.get(path))
        for path, trial in folders.items()
    ]
    ordered = sorted(trials, key=lambda trial: (_place(trial, plan), trial.folder.sort_key[1:]))
    return ScannedExperiment(experiment.name, folder, plan, tuple(ordered))


def _plan(experiment: Path, faults: list[StoreError]) -> PlanFile | None:
    try:
        return read_plan(experiment)
    except StoreError as error:
        faults.append(error)
        return None


def _place(trial: ScannedTrial, plan: PlanFile | None) -> tuple[tuple[int, ...], str]:
    """The place of a trial by the plan, then by the folder of its target and scheme."""
    variant = trial.variant if trial.planned else None
    place = plan.place(trial.target, trial.scheme, variant) if plan else ()
    return place, str(trial.path.parent)


@dataclass(frozen=True)
class Scan:
    """Folders below a root: those of trials, and those of experiments that hold a plan."""

    trials: tuple[TrialFolder, ...]
    planned: tuple[Path, ...]


def scan(root: Path) -> Scan:
    """Search a run directory, or a folder in it; links to folders are not followed, and no file is read.

    Raises:
        StoreError: no such directory.
    """
    if not root.exists():
        raise StoreError(f"{root}: no such run directory; `meshfit run` makes one")
    if not root.is_dir():
        raise StoreError(f"{root}: not a directory; expected a run directory, or a folder in one")
    trials, planned = list[TrialFolder](), list[Path]()
    for path, files in _folders(root):
        folder = TrialFolder(path, files)
        if folder.is_named or files & {RESULT, FAILURE}:
            trials.append(folder)
        elif PLAN in files:
            planned.append(path)
    return Scan(tuple(sorted(trials, key=lambda trial: trial.sort_key)), tuple(sorted(planned)))


def _folders(root: Path) -> Iterator[tuple[Path, frozenset[str]]]:
    pending = [root]
    while pending:
        path = pending.pop()
        try:
            with os.scandir(path) as scanned:
                entries = list(scanned)
        except FileNotFoundError:  # removed since its parent was listed
            continue
        folders = {entry.name for entry in entries if entry.is_dir(follow_symlinks=False)}
        yield path, frozenset(entry.name for entry in entries) - folders
        if TRIAL_FOLDER.fullmatch(path.name) is None:
            pending += [path / name for name in folders]


def trial_folder(path: Path) -> TrialFolder:
    """List the folder of a trial."""
    try:
        return TrialFolder(path, frozenset(os.listdir(path)))  # noqa: PTH208  only names are used
    except FileNotFoundError:
        return TrialFolder(path, frozenset())


def status_of(folder: TrialFolder, now: datetime) -> TrialStatus:
    """The status of a trial."""
    if _has_valid_result(folder):
        return TrialStatus.COMPLETE
    if is_running(folder, now):
        return TrialStatus.RUNNING
    # It may have been running still when its folder was listed.
    return status_at_rest(trial_folder(folder.path) if LOCK in folder.files else folder)


def status_at_rest(folder: TrialFolder) -> TrialStatus:
    """The status of a trial that is not running."""
    if RESULT in folder.files:
        return TrialStatus.COMPLETE if _has_valid_result(folder) else TrialStatus.DAMAGED
    if FAILURE in folder.files:
        return TrialStatus.FAILED
    return TrialStatus.INTERRUPTED if folder.files else TrialStatus.WAITING


def _has_valid_result(folder: TrialFolder) -> bool:
    return RESULT in folder.files and damage(folder.path / RESULT) is None


def is_running(folder: TrialFolder, now: datetime) -> bool:
    """Whether a living process holds the trial's lock.

    Where the lock is inconclusive, because it cannot be tried or another host does not share it, a trial is running if
    its progress was written within the last minute.
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
    return _is_fresh(folder.path, now, only_other_hosts=True)


def _is_fresh(folder: Path, now: datetime, *, only_other_hosts: bool = False) -> bool:
    progress = read_progress(folder)
    if progress is None or (only_other_hosts and progress.host == this_host()):
        return False
    return not progress.is_stale(now)


_TrialOfExperiment = tuple[ScannedExperiment, ScannedTrial]


def find_trial(text: str, runs: Path, now: datetime) -> _TrialOfExperiment:
    """Find a trial, and the experiment that it belongs to.

    Args:
        text: the trial's folder, a file in it, a folder above this trial alone, or at least the first four digits
            of its identity.
        runs: the run directory in which to look for an identity.
        now: the current time, from which the age of progress is counted.

    Raises:
        ConfigError: no trial matches, or several do.
        StoreError: the run directory does not exist.
    """
    path = Path(text)
    if path.exists():
        return _trial_in(path if path.is_dir() else path.parent, now)
    trials = list(_trials(scan_experiments([runs], now)))
    digits = text.lower()
    if _IDENTITY.fullmatch(digits):
        matches = [pair for pair in trials if _matches(pair[1].identity, digits)]
    else:
        matches = [pair for pair in trials if absolute(pair[1].path) == absolute(path)]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise ConfigError(f"{len(matches)} trials under {runs} begin with {text}: {_listed(matches)}")
    expected = f"a trial's folder, a file in it, or {FEWEST_DIGITS} or more digits of its identity"
    raise ConfigError(f"no trial under {runs} is '{text}'; expected {expected}; the trials are: {_listed(trials)}")


def _trial_in(folder: Path, now: datetime) -> _TrialOfExperiment:
    trials = list(_trials(scan_experiments([folder], now)))
    matches = [pair for pair in trials if pair[1].path == folder] or trials
    if len(matches) == 1:
        return matches[0]
    raise ConfigError(f"{folder}: expected the folder of one trial; the trials below it are: {_listed(trials)}")


def _trials(experiments: Iterable[ScannedExperiment]) -> Iterator[_TrialOfExperiment]:
    return ((experiment, trial) for experiment in experiments for trial in experiment.trials)


def _matches(identity: str, digits: str) -> bool:
    """Whether an identity, of which perhaps only the first digits are known, begins with the given digits."""
    return bool(identity) and (identity.startswith(digits) or digits.startswith(identity))


def _listed(trials: Sequence[_TrialOfExperiment]) -> str:
    shown = [f"{trial.identity[:10]} ({experiment.name}, {trial.label})" for experiment, trial in trials[:_MOST_LISTED]]
    more = len(trials) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")


def absolute(path: Path) -> Path:
    """Return the absolute path without resolving links, since a run directory may be one."""
    return Path(os.path.abspath(path))  # noqa: PTH100  Path.resolve follows links
