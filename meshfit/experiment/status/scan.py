"""The folders of trials as they lie there, found by their names alone, and the state that each is in."""

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path

from filelock import FileLock, Timeout

from meshfit.errors import ConfigError, StoreError
from meshfit.experiment.storage.plan_file import PlanFile, PlannedTrial, read_plan
from meshfit.experiment.storage.run_directory import FAILURE, LOCK, PLAN, RESULT
from meshfit.experiment.storage.trial_log import FRESH_SECONDS, read_progress, this_host

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


@dataclass(frozen=True)
class Standing:
    """One trial, as it stands.

    Attributes:
        folder: its folder, and what is in it.
        state: where it stands.
        planned: what the experiment's latest plan says of it; None if it is not in that, or if there is none.
    """

    folder: TrialFolder
    state: State
    planned: PlannedTrial | None = None

    @property
    def path(self) -> Path:
        """Its folder."""
        return self.folder.path

    @property
    def target(self) -> str:
        """The short name of the target, which is that of a folder."""
        return Path(os.path.abspath(self.path)).parents[1].name  # noqa: PTH100  as written: links stay links

    @property
    def scheme(self) -> str:
        """The scheme; as its folder is called, where no plan says more."""
        return self.planned.scheme if self.planned else Path(os.path.abspath(self.path)).parent.name  # noqa: PTH100

    @property
    def seed(self) -> int | None:
        """The seed; None where neither the plan nor the folder's name says it."""
        return self.planned.seed if self.planned else self.folder.seed

    @property
    def variant(self) -> str:
        """The variant; empty where there is none."""
        return self.planned.variant if self.planned else ""

    @property
    def identity(self) -> str:
        """The identity, or its first ten digits where no plan has all of it."""
        return self.planned.identity if self.planned else self.folder.identity

    @property
    def label(self) -> str:
        """Target, scheme, variant and seed, for a person to read; the folder, where its name does not tell them."""
        if self.seed is None:
            return str(self.path)
        return " · ".join(filter(None, (self.target, self.scheme, self.variant, f"seed {self.seed}")))


@dataclass(frozen=True)
class ExperimentOverview:
    """One experiment: its folder, its latest plan, if there is one, and its trials, in the order of their folders."""

    name: str
    folder: Path
    plan: PlanFile | None
    trials: tuple[Standing, ...]

    @property
    def counts(self) -> dict[State, int]:
        """How many trials are in each state."""
        counted = Counter(trial.state for trial in self.trials)
        return {state: counted[state] for state in State}

    def of(self, state: State) -> list[Standing]:
        """The trials that are in one state."""
        return [trial for trial in self.trials if trial.state is state]


def overview(roots: Sequence[Path], now: datetime) -> list[ExperimentOverview]:
    """Every experiment that has a trial under some run directories, or under folders of them.

    Args:
        roots: where to look.
        now: the time, by which the age of a sign of life is told.

    Raises:
        StoreError: no such directory, no trial in any of them, or a plan that cannot be read.
    """
    scans = [scan(root) for root in roots]
    begun: dict[Path, dict[Path, TrialFolder]] = {}
    for folder in (trial for found in scans for trial in found.trials):
        begun.setdefault(folder.experiment, {}).setdefault(_absolute(folder.path), folder)
    shown = {_absolute(path): path for found in scans for path in found.planned}
    within = [_absolute(root) for root in roots]
    found = [
        _experiment(shown.get(experiment, experiment), begun.get(experiment, {}), within, now)
        for experiment in sorted({*begun, *shown})
    ]
    found = [experiment for experiment in found if experiment.trials]
    if not found:
        raise StoreError(f"no trial under {', '.join(map(str, roots))}; `meshfit run` makes them")
    return found


def _experiment(
    folder: Path, begun: dict[Path, TrialFolder], within: Sequence[Path], now: datetime
) -> ExperimentOverview:
    plan = read_plan(folder)
    absolute = _absolute(folder)
    planned = {absolute / trial.folder: trial for trial in plan.trials} if plan else {}
    folders = dict(begun)
    for path, trial in planned.items():
        if path not in folders and any(path.is_relative_to(root) for root in within):
            # Not there when it was looked for, or reached by a link: links are not followed.
            folders[path] = TrialFolder(folder / trial.folder, frozenset())
    trials = (Standing(found, state_of(found, now), planned.get(path)) for path, found in folders.items())
    ordered = sorted(trials, key=lambda trial: trial.folder.order)
    return ExperimentOverview(absolute.name, folder, plan, tuple(ordered))


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))  # noqa: PTH100  as written: a run directory may be a link


FEWEST_DIGITS = 4
_MOST_LISTED = 5
_IDENTITY = re.compile(rf"[0-9a-f]{{{FEWEST_DIGITS},64}}")


def find_trial(text: str, runs: Path, now: datetime) -> tuple[ExperimentOverview, Standing]:
    """The trial that is meant, and the experiment that it is part of.

    Args:
        text: a trial's folder, a file in it, or at least the first four digits of its identity.
        runs: where to look for an identity.
        now: the time, by which it is told what runs.

    Raises:
        ConfigError: no trial is meant by it, or several are.
        StoreError: there is no run directory to look in.
    """
    path = Path(text)
    if path.exists():
        return _in_folder(path if path.is_dir() else path.parent, now)
    every = list(_trials(overview([runs], now)))
    digits = text.lower()
    if _IDENTITY.fullmatch(digits):
        found = [one for one in every if _begins(one[1].identity, digits)]
    else:
        found = [one for one in every if os.path.abspath(one[1].path) == os.path.abspath(path)]  # noqa: PTH100
    if len(found) == 1:
        return found[0]
    if found:
        raise ConfigError(f"{len(found)} trials under {runs} begin with {text}: {_listed(found)}")
    needed = f"a trial's folder, a file in it, or {FEWEST_DIGITS} or more digits of its identity are needed"
    raise ConfigError(f"no trial under {runs} is '{text}'; {needed}; there are: {_listed(every)}")


def _in_folder(folder: Path, now: datetime) -> tuple[ExperimentOverview, Standing]:
    found = list(_trials(overview([folder], now)))
    exact = [one for one in found if one[1].path == folder]
    if len(exact) == 1:
        return exact[0]
    raise ConfigError(f"{folder}: not the folder of a trial, but one above it; there are: {_listed(found)}")


def _trials(experiments: Iterable[ExperimentOverview]) -> Iterable[tuple[ExperimentOverview, Standing]]:
    return ((experiment, trial) for experiment in experiments for trial in experiment.trials)


def _begins(identity: str, digits: str) -> bool:
    """Whether an identity begins so, of which only the first digits may be known."""
    return bool(identity) and (identity.startswith(digits) or digits.startswith(identity))


def _listed(found: Sequence[tuple[ExperimentOverview, Standing]]) -> str:
    shown = [f"{trial.identity[:10]} ({experiment.name}, {trial.label})" for experiment, trial in found[:_MOST_LISTED]]
    more = len(found) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")
