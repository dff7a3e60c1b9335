"""Estimated time: until an experiment is complete, and of a run that has not started."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from meshfit.errors import StoreError, TrialError
from meshfit.experiment.status.scan import ScannedExperiment, ScannedTrial
from meshfit.experiment.storage.run_directory import RESULT, Result, RunDirectory, read_json
from meshfit.experiment.storage.trial_log import LastProgress, read_progress
from meshfit.experiment.trial_status import Progress, TrialStatus
from meshfit.fitting.callbacks import Interrupted, Step
from meshfit.fitting.settings import ExternalSettings, FirstOrderSettings
from meshfit.units import count_text

if TYPE_CHECKING:  # `meshfit status` does not load what only `estimate` uses
    from meshfit.config.source_settings import SourceSettings
    from meshfit.experiment.plan import Trial
    from meshfit.subdivision.registry import NamedScheme

_Key = tuple[Path, str, int]
"""Folder of target and scheme, or none for all of them; variant; steps."""

_ANYWHERE = Path()
_ANY: _Key = (_ANYWHERE, "", 0)
_PROBE_SECONDS = {"first-order": 2.0, "gauss-newton": 8.0}
_WARM_UP_STEPS = 3
_SPHERE_LEVEL, _MOST_FACES = 5, 200_000
_MOST_FACES_PROBED = 1_000_000
_START_SECONDS = 3.0
_VERTS_PER_SAMPLE = 4  # in a step, a vertex costs about a quarter of a sample: see the table of `make bench`


@dataclass(frozen=True)
class _Cost:
    """The total cost of some trials: seconds of fitting and of measuring, steps, and the number of trials."""

    fit: float
    measure: float
    steps: int
    trials: int = 1

    def __add__(self, other: "_Cost") -> "_Cost":
        return _Cost(
            self.fit + other.fit, self.measure + other.measure, self.steps + other.steps, self.trials + other.trials
        )


_Costs = dict[_Key, _Cost]


def seconds_left(experiment: ScannedExperiment) -> float | None:
    """Estimate the seconds until every running or planned trial of an experiment is done; None if nothing is known.

    A trial is assumed to cost as much as complete trials of the same target, scheme, variant and steps, or at least of
    the same variant and steps. Without these, its cost per step is that of all complete trials; without any, that of
    the running ones.
    """
    unfinished = _unfinished(experiment)
    if not unfinished:
        return 0.0
    progress = {trial: read_progress(trial.path) for trial in unfinished if trial.status is TrialStatus.RUNNING}
    workers = experiment.plan.workers if experiment.plan else max(1, len(progress))
    costs = _costs_of_complete(experiment) or _costs_of_running(progress, workers)
    if not costs:
        return None
    seconds = [_seconds_of(trial, progress.get(trial), costs) for trial in unfinished]
    # The longest trial does not end sooner because other workers are idle.
    return max(sum(seconds) / workers, *seconds)


def _unfinished(experiment: ScannedExperiment) -> list[ScannedTrial]:
    """Running trials, and planned ones that have not ended; where there is no plan, those that were begun."""
    not_run = (TrialStatus.WAITING, TrialStatus.INTERRUPTED, TrialStatus.DAMAGED)
    stopped = [trial for status in not_run for trial in experiment.of(status)]
    planned = [trial for trial in stopped if trial.planned or experiment.plan is None]
    return experiment.of(TrialStatus.RUNNING) + planned


def _costs_of_complete(experiment: ScannedExperiment) -> _Costs:
    """Costs of complete trials: of those in the plan, if there are any, since others may have other settings."""
    complete = experiment.of(TrialStatus.COMPLETE)
    costs: _Costs = {}
    for trial in [trial for trial in complete if trial.planned] or complete:
        if cost := _cost(trial):
            _add(costs, cost, (trial.path.parent, trial.variant, cost.steps), (_ANYWHERE, trial.variant, cost.steps))
    return costs


def _overhead(seconds: Mapping[str, Any]) -> float:
    """Return the seconds of a trial before and after its fit."""
    return float(seconds["measure"]) + float(seconds.get("prepare", 0.0))


def _add(costs: _Costs, cost: _Cost, *keys: _Key) -> None:
    for key in (_ANY, *keys):
        costs[key] = costs[key] + cost if key in costs else cost


def _cost(trial: ScannedTrial) -> _Cost | None:
    try:
        result: Mapping[str, Any] = read_json(trial.path / RESULT)
        seconds = result["seconds"]
        return _Cost(float(seconds["fit"]), _overhead(seconds), int(result["fit"]["steps"]))
    except (StoreError, KeyError, TypeError, ValueError):
        return None  # not needed for an estimate; commands that show the result report the damage


def _costs_of_running(running: Mapping[ScannedTrial, LastProgress | None], workers: int) -> _Costs:
    """Costs of whole trials that run; trials of a batch share a worker's time, as in the costs of complete ones."""
    share = min(1.0, workers / max(1, len(running)))
    costs: _Costs = {}
    for trial, progress in running.items():
        if progress is not None and progress.step.done > 0 and progress.running_seconds > 0:
            planned_steps = trial.planned.steps if trial.planned else progress.step.steps
            seconds = share * progress.running_seconds / _share_done(progress)
            _add(costs, _Cost(seconds, 0.0, planned_steps))
    return costs


def _share_done(progress: LastProgress) -> float:
    """Return the share of the steps of a trial that are done, of those that it is known to need."""
    return min(progress.step.done / max(progress.step.steps, 1), 1.0)


def _seconds_of(trial: ScannedTrial, progress: LastProgress | None, costs: _Costs) -> float:
    steps = trial.planned.steps if trial.planned else progress.step.steps if progress else None
    keys = ((folder, trial.variant, steps or 0) for folder in (trial.path.parent, _ANYWHERE))
    same = next((costs[key] for key in keys if key in costs), None)
    cost = same or costs[_ANY]
    # A single step is the run of another tool, which is not that much shorter than a fit of many steps.
    scale = 1.0 if same or steps in (None, 1) or not cost.steps else (steps or 1) * cost.trials / cost.steps
    fit, measure = scale * cost.fit / cost.trials, cost.measure / cost.trials
    if progress is None or not steps:
        return fit + measure
    if progress.status is TrialStatus.MEASURING:
        return measure
    if steps == 1:
        return measure + max(0.0, fit - progress.running_seconds)
    return measure + fit * (1 - _share_done(progress))


@dataclass(frozen=True)
class Estimate:
    """The estimated time of a run.

    Attributes:
        seconds: until all trials are done, except those that it leaves out; None if it leaves out all.
        workers: the number of trials that run side by side.
        basis: the basis of the estimate, such as `12 complete trials` or `a probe of 1 trial`.
        unknown: the number of trials that it leaves out.
        left_out: which trials these are, in words.
    """

    seconds: float | None
    workers: int
    basis: str
    unknown: int = 0
    left_out: str = ""


@dataclass(frozen=True)
class _Pace:
    """The pace of trials of one fitting method: seconds per unit of work, and seconds outside the fit."""

    per_work: float
    overhead: float


def estimate(
    trials: Sequence["Trial"], results: Sequence[tuple["Trial", Result]], *, jobs: int | None = None
) -> Estimate | None:
    """Estimate the time that trials will take on the CPU of this machine, from results or else from a probe of a trial.

    Args:
        trials: the trials to run.
        results: complete trials of the same plan, with their results.
        jobs: the number of processes; None takes it from the settings.

    Returns:
        The estimate; None where there is nothing to run, or a trial may run on a GPU. Without results of their method,
        it leaves out runs of other tools, whose time no probe can tell, and trials with very large targets.

    Raises:
        TrialError: the probed trial fails.
    """
    from meshfit.experiment.running.device_assignment import workers_and_threads

    if not trials or any(trial.settings.device not in ("cpu", "auto") for trial in trials):
        return None
    workers, threads = workers_and_threads(trials, jobs)
    paces = _paces_of(results)
    known, of_tools, large = list["Trial"](), 0, 0
    for trial in trials:
        if _pace_key(trial) in paces:
            known.append(trial)
        elif isinstance(trial.settings.fit, ExternalSettings):
            of_tools += 1
        elif _is_large(trial):
            large += 1
        else:
            known.append(trial)
    trials, left_out = known, _left_out(of_tools, large)
    if not trials:
        return Estimate(None, workers, "", of_tools + large, left_out)
    missing = dict.fromkeys(_pace_key(trial) for trial in trials if _pace_key(trial) not in paces)
    for method in missing:
        by_work = sorted((trial for trial in trials if _pace_key(trial) == method), key=_work)
        pace = _probed_pace(by_work[len(by_work) // 2], threads)
        if pace is None:
            return None
        paces[method] = pace
    pace_of_trial = [(paces[_pace_key(trial)], trial) for trial in trials]
    seconds = [pace.overhead + pace.per_work * _work(trial) for pace, trial in pace_of_trial]
    total = max(sum(seconds) / workers, *seconds) + _START_SECONDS
    basis = [count_text(len(results), "complete trial")] if results else []
    basis += [f"a probe of {count_text(len(missing), 'trial')}"] if missing else []
    return Estimate(total, workers, " and ".join(basis), of_tools + large, left_out)


def _is_large(trial: "Trial") -> bool:
    """Whether a target is so large that a probe takes minutes and gigabytes."""
    from meshfit.experiment.input_checks import checked_target

    checked = checked_target(trial.target, trial.settings.cleaning)
    return max(checked.faces, checked.points) > _MOST_FACES_PROBED


def _left_out(of_tools: int, large: int) -> str:
    """Return in words which trials an estimate leaves out, and why."""
    parts = [f"{count_text(of_tools, 'run')} of other tools"] if of_tools else []
    parts += [f"{count_text(large, 'run')} with targets of more than {_MOST_FACES_PROBED:,} faces"] if large else []
    return f"{' and '.join(parts)} not counted: their time is known after the first" if parts else ""


def _paces_of(results: Sequence[tuple["Trial", Result]]) -> dict[str, _Pace]:
    paces: dict[str, list[_Pace]] = {}
    for trial, result in results:
        seconds = result["seconds"]
        pace = _Pace(seconds["fit"] / max(_work(trial), 1.0), _overhead(seconds))
        paces.setdefault(_pace_key(trial), []).append(pace)
    return {
        method: _Pace(median(pace.per_work for pace in of_method), median(pace.overhead for pace in of_method))
        for method, of_method in paces.items()
    }


def _pace_key(trial: "Trial") -> str:
    """The method of a trial, and for other tools the settings as well."""
    fit = trial.settings.fit
    return fit.model_dump_json() if isinstance(fit, ExternalSettings) else fit.method


def _work(trial: "Trial") -> float:
    """The work of a fit, to which its time is proportional; the same for all runs of another tool."""
    from meshfit.subdivision.growth import growth

    fit = trial.settings.fit
    if isinstance(fit, ExternalSettings):
        return 1.0
    verts = _num_verts(trial.settings.source, trial.named_scheme)
    if isinstance(fit, FirstOrderSettings):
        return fit.steps * (fit.samples + verts / _VERTS_PER_SAMPLE)
    if fit.connectivity == "remeshed":
        return float(fit.steps * fit.verts)
    return float(fit.steps * verts * growth(trial.named_scheme.resolve(), fit.levels))


@cache
def _num_verts(source: "SourceSettings", scheme: "NamedScheme") -> int:
    from meshfit.experiment.source import expected_verts

    return expected_verts(source, scheme.resolve())


def _probed_pace(trial: "Trial", threads: int) -> _Pace | None:
    """Probe a trial in a worker, where trials run; None if it would run on a GPU."""
    from meshfit.experiment.running.process_pool import ONE_THREAD, ProcessPool, environment
    from meshfit.experiment.running.shared_progress import SharedProgress

    with environment(ONE_THREAD):
        pool = ProcessPool(1, SharedProgress.of(1))
        try:
            if trial.settings.device == "auto" and pool.count_gpus():
                return None
            fit, overhead = pool.call(_probe, trial, threads)
        finally:
            pool.close()
    return _Pace(fit / max(_work(trial), 1.0), overhead)


def _probe(trial: "Trial", threads: int) -> tuple[float, float]:
    """Seconds of the whole fit, extrapolated from its first steps, and seconds before and after it."""
    from meshfit.experiment.running.batch_runner import run_batch

    started, steps = time.perf_counter(), list[tuple[Step, float]]()

    def on_progress(_: int, progress: Progress) -> None:
        if progress.status is TrialStatus.FITTING and progress.step.done:
            steps.append((progress.step, time.perf_counter()))
            if steps[-1][1] - steps[0][1] > _PROBE_SECONDS[trial.settings.fit.method]:
                raise Interrupted

    with TemporaryDirectory(prefix="meshfit-") as folder:
        store = RunDirectory(Path(folder))
        (outcome,) = run_batch([trial], store, on_progress, device="cpu", threads=threads)
        result = store.result(trial)
    if result is not None:
        whole = time.perf_counter() - started
        return result["seconds"]["fit"], whole - result["seconds"]["fit"]
    if outcome.status is TrialStatus.FAILED or len(steps) < 2:
        raise TrialError(f"{trial.label}: {outcome.message or 'too few steps to estimate the time'}")
    first, last = steps[min(_WARM_UP_STEPS, len(steps) - 2)], steps[-1]
    per_step = (last[1] - first[1]) / max(last[0].done - first[0].done, 1)
    before = steps[0][1] - started
    return per_step * last[0].steps, before + _seconds_to_measure(trial)


def _seconds_to_measure(trial: "Trial") -> float:
    """Seconds to measure the target against itself, which a good result is close to.

    Points, and more faces than results have, among which to look for crossings takes minutes, are measured against a
    sphere.
    """
    from meshfit.images.targets import load_reference
    from meshfit.measuring.measure import measure
    from meshfit.mesh.point_cloud import PointCloud
    from meshfit.subdivision.sphere import icosphere

    target = load_reference(trial.current_path(trial.target), trial.settings.cleaning)
    start = time.perf_counter()
    sphere = icosphere(_SPHERE_LEVEL)
    surface = sphere if isinstance(target, PointCloud) or target.num_faces > _MOST_FACES else target
    measure(surface, target, trial.settings.measure)
    return time.perf_counter() - start
