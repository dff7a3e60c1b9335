"""The search: ask for a batch of points, run their trials, tell their values, and ask again."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from meshfit.config.loading import Experiment
from meshfit.config.sweep_samples import SampleSettings
from meshfit.config.sweeps import point_name
from meshfit.errors import ConfigError, MeshfitError
from meshfit.experiment.input_checks import CopyFinder
from meshfit.experiment.plan import Trial, plan, require_usable
from meshfit.experiment.storage.failure import RETRIED, read_failure
from meshfit.experiment.storage.plan_file import write_plan
from meshfit.experiment.storage.run_directory import FAILURE, RunDirectory, read_result
from meshfit.experiment.target_labels import target_label
from meshfit.experiment.trial_status import Outcome, TrialStatus
from meshfit.experiment.tuning.objectives import Objective, score
from meshfit.experiment.tuning.sampler import BATCH, FIRST, ask, import_optuna
from meshfit.experiment.tuning.search_file import (
    ASKED,
    COMPLETE,
    FAILED,
    OWN,
    Point,
    Search,
    read_search,
    search_path,
    write_search,
)

Run = Callable[[Sequence[Trial]], Mapping[int, Outcome]]
"""Runs trials that are not complete, and returns the outcome of each by its index."""


@dataclass(frozen=True)
class Problem:
    """The problem that a search solves.

    Attributes:
        experiment: the experiment; its sweep is not used.
        ranges: the ranges, from `read_ranges`.
        objectives: the objectives.
        sample: seed and design of the first points.
        remote: whether trials will run on other machines.
        copy_of: finds the copy of a target whose file is missing; None for no copies.
    """

    experiment: Experiment
    ranges: Mapping[str, Any]
    objectives: tuple[Objective, ...]
    sample: SampleSettings
    remote: bool = False
    copy_of: CopyFinder | None = None

    def point(self, changes: Mapping[str, Any], batch: int) -> Point:
        """Return a point to be tried."""
        axes = {key: values if isinstance(values, list) else [] for key, values in self.ranges.items()}
        return Point(changes, point_name(changes, axes), batch=batch)

    def trials(self, point: Point) -> list[Trial]:
        """Return the trials of a point.

        Raises:
            MeshfitError: a target or a source cannot be used with its settings.
        """
        settings = self.experiment.settings.model_copy(update={"sweep": {"variants": {point.name: point.changes}}})
        trials = plan([replace(self.experiment, settings=settings)], remote=self.remote, copy_of=self.copy_of)
        require_usable(trials)  # a metric over all targets is not known without one of them
        return trials


def start_search(problem: Problem, root: Path, *, new: bool = False) -> Search:
    """Read the search from its file, or begin it.

    Args:
        problem: the problem.
        root: the run directory.
        new: begin it again, even if there is a file.

    Raises:
        MeshfitError: no point can be planned, or the file cannot be read.
    """
    import_optuna()
    experiment, settings = problem.experiment, problem.experiment.settings
    own = Point({}, OWN)
    first = [problem.point(changes, 0) for changes in ask((), problem.ranges, problem.objectives, problem.sample, 0)]
    definition = {
        "trials": [trial.identity for trial in _first_trials(problem, [own, *first])],
        "objectives": [asdict(objective) for objective in problem.objectives],
        "ranges": problem.ranges,
        "sample": [problem.sample.seed, problem.sample.method, FIRST, BATCH],
    }
    key = hashlib.sha256(json.dumps(definition).encode()).hexdigest()[:8]
    path = search_path(root, experiment.name, key)
    if path.is_file() and not new:
        return read_search(path)
    cells: dict[str, Sequence[Any]] = {
        "targets": list(map(target_label, settings.targets)),
        "schemes": list(settings.schemes),
        "seeds": list(settings.seeds),
    }
    return Search(experiment.name, key, problem.objectives, problem.ranges, cells, own, tuple(first))


def _first_trials(problem: Problem, points: Sequence[Point]) -> list[Trial]:
    """Return the trials of the first point that can be run.

    Raises:
        MeshfitError: there is none, for the reason of the first.
    """
    errors: list[MeshfitError] = []
    for point in points:
        try:
            return problem.trials(point)
        except MeshfitError as error:
            errors.append(error)
    raise errors[0]


def run_search(
    problem: Problem,
    search: Search,
    total: int,
    store: RunDirectory,
    run: Run,
    watch: Callable[[Search], None] = lambda _: None,
    *,
    new: bool = False,
) -> Search:
    """Try points until there are enough.

    The points of a batch are told in the order in which they were asked. The file is written after each batch is asked
    and after it is told, so that a killed search goes on with the same points.

    Args:
        problem: the problem.
        search: the search, from `start_search`.
        total: number of points, including those already tried.
        store: the run directory.
        run: runs trials.
        watch: called with the search after each batch.
        new: rerun trials that are complete or failed.

    Returns:
        The search; it has fewer complete and failed points than `total` only if there are no others.

    Raises:
        ConfigError: no trial has a metric.
    """
    runner = _Runner(problem, store, run, new)
    if search.own.state == ASKED:
        pending = _pending(search, total)
        own, *told = runner.told([search.own, *(search.points[i] for i in pending)])
        search = _replaced(replace(search, own=own), pending, told)
        _save(runner, search, store)
        watch(search)
    while True:
        if pending := _pending(search, total):
            search = _replaced(search, pending, runner.told([search.points[i] for i in pending]))
            _save(runner, search, store)
            watch(search)
            continue
        if len(search.points) >= total:
            return search
        batch = search.points[-1].batch + 1
        asked = ask(search.points, problem.ranges, problem.objectives, problem.sample, batch)
        if not asked:
            return search
        search = search.with_points([*search.points, *(problem.point(changes, batch) for changes in asked)])
        write_search(store.root, search)


def _pending(search: Search, total: int) -> list[int]:
    """Return the indices of points that have been asked, but not told; those of one batch."""
    return [i for i, point in enumerate(search.points[:total]) if point.state == ASKED]


def _replaced(search: Search, indices: Sequence[int], told: Sequence[Point]) -> Search:
    points = dict(zip(indices, told, strict=True))
    return search.with_points([points.get(i, point) for i, point in enumerate(search.points)])


def _save(runner: "_Runner", search: Search, store: RunDirectory) -> None:
    write_search(store.root, search)
    # The plan of the last batch becomes that of all points, in their order.
    points = [point for point in (search.own, *search.points) if point.state == COMPLETE]
    if trials := [trial for point in points for trial in runner.trials(point)]:
        write_plan(trials, store, 1)


@dataclass
class _Runner:
    """Runs the trials of points, and returns the points with their values."""

    problem: Problem
    store: RunDirectory
    run: Run
    new: bool

    def __post_init__(self) -> None:
        self._trials: dict[str, list[Trial]] = {}

    def trials(self, point: Point) -> list[Trial]:
        key = json.dumps(point.changes, sort_keys=True)
        if key not in self._trials:
            self._trials[key] = self.problem.trials(point)
        return self._trials[key]

    def told(self, points: Sequence[Point]) -> list[Point]:
        """Run the trials of points, and return the points with their values."""
        planned: list[list[Trial] | str] = [self._planned(point) for point in points]
        trials = {trial.folder: trial for each in planned if not isinstance(each, str) for trial in each}
        reasons = {} if self.new else {place: why for place in trials if (why := self._failed_before(trials[place]))}
        pending = [trial for place, trial in trials.items() if place not in reasons]
        outcomes = self.run(pending) if pending else {}
        for i, outcome in outcomes.items():
            if outcome.status is TrialStatus.FAILED:
                reasons[pending[i].folder] = outcome.message
        told = [self._told(*each, reasons) for each in zip(points, planned, strict=True)]
        lacking = [point for point in told if point.reason.startswith(_NO_VALUE)]
        if lacking and not any(point.state == COMPLETE for point in told):
            raise ConfigError(f"{lacking[0].reason.removeprefix(_NO_VALUE)}; choose another --metric")
        return told

    def _planned(self, point: Point) -> list[Trial] | str:
        try:
            return self.trials(point)
        except MeshfitError as error:
            return error.faults[0]

    def _failed_before(self, trial: Trial) -> str:
        """Return why a trial failed in an earlier run, if it would fail again."""
        folder = self.store.folder(trial)
        if not (folder / FAILURE).is_file() or self.store.is_complete(trial):
            return ""
        failure = read_failure(folder)
        recurs = failure.record.get("identity") == trial.identity and failure.kind not in RETRIED
        return f"{failure.kind}: {failure.message}" if recurs else ""

    def _told(self, point: Point, planned: list[Trial] | str, reasons: Mapping[Path, str]) -> Point:
        if isinstance(planned, str):
            return replace(point, state=FAILED, reason=planned)
        failed = [trial for trial in planned if trial.folder in reasons]
        if failed:
            more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
            reason = f"{_cell(failed[0])}: {reasons[failed[0].folder]}{more}"
            return replace(point, state=FAILED, reason=reason)
        results = [result for trial in planned if (result := read_result(self.store.folder(trial))) is not None]
        values = [score(results, objective) for objective in self.problem.objectives]
        for objective, value in zip(self.problem.objectives, values, strict=True):
            if value is None:
                return replace(point, state=FAILED, reason=f"{_NO_VALUE}{objective.metric}: the results have no value")
        return replace(point, state=COMPLETE, values=tuple(value for value in values if value is not None))


_NO_VALUE = "no value: "


def _cell(trial: Trial) -> str:
    return f"{target_label(trial.target)}, {trial.scheme}, seed {trial.seed}"
