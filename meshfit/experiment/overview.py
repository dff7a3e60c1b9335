"""How experiments stand: the trials that were planned or begun, each with its state. Reads plans and names only."""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from meshfit.errors import StoreError
from meshfit.experiment.folders import State, TrialFolder, scan, state_of
from meshfit.experiment.plan_file import PlanFile, PlannedTrial, read_plan


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
