"""About how long an experiment still takes, from what its complete trials took and from how far others are."""

import time
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from meshfit.config.experiment import SourceSettings
from meshfit.errors import StoreError, TrialError
from meshfit.experiment.plan import Trial
from meshfit.experiment.running.device_assignment import workers_and_threads
from meshfit.experiment.running.environment import ONE_THREAD, environment
from meshfit.experiment.running.process_pool import LocalExecutor
from meshfit.experiment.running.progress import Board
from meshfit.experiment.status.scan import ExperimentOverview, Standing, State
from meshfit.experiment.storage.run_directory import RESULT, Result, RunDirectory, read_json
from meshfit.experiment.storage.trial_log import LastProgress, read_progress
from meshfit.experiment.trial_status import Phase, Progress
from meshfit.fitting.callbacks import Interrupted
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.subdivision.registry import NamedScheme
from meshfit.units import count_text

_Key = tuple[Path, str, int]
"""Folder of the scheme, which lies in that of the target; variant; steps."""

_ANY: _Key = (Path(), "", 0)
"""In place of a key: whatever the trial."""


@dataclass(frozen=True)
class _Cost:
    """What trials took in all: seconds of the fit and of the measurement, steps, and how many trials these were."""

    fit: float
    measure: float
    steps: int
    trials: int = 1

    def __add__(self, other: "_Cost") -> "_Cost":
        return _Cost(
            self.fit + other.fit, self.measure + other.measure, self.steps + other.steps, self.trials + other.trials
        )


_Known = dict[_Key, _Cost]


def seconds_left(experiment: ExperimentOverview) -> float | None:
    """Seconds until every trial is done that runs, or that the plan still has to run; None where nothing is known.

    A trial is taken to need what complete ones of the same target, scheme, variant and steps needed; else what any
    needed, by their steps; else, where none is complete, what running ones need a step.
    """
    to_do = _to_do(experiment)
    if not to_do:
        return 0.0
    progress = {trial: read_progress(trial.path) for trial in to_do if trial.state is State.RUNNING}
    workers = experiment.plan.workers if experiment.plan else max(1, len(progress))
    known = _known(experiment) or _so_far(progress.values(), workers)
    if not known:
        return None
    left = [_left(trial, progress.get(trial), known) for trial in to_do]
    # The last one does not end sooner for the help of idle workers.
    return max(sum(left) / workers, *left)


def _to_do(experiment: ExperimentOverview) -> list[Standing]:
    """What runs, and what the plan still has to run; where there is no plan, what was begun."""
    unfinished = (*experiment.of(State.WAITING), *experiment.of(State.INTERRUPTED))
    planned = [trial for trial in unfinished if trial.planned or experiment.plan is None]
    return experiment.of(State.RUNNING) + planned


def _known(experiment: ExperimentOverview) -> _Known:
    """What complete trials took; those of the plan, if there are any, since others may be of other settings."""
    complete = experiment.of(State.COMPLETE)
    known: _Known = {}
    for trial in [trial for trial in complete if trial.planned] or complete:
        if cost := _cost(trial):
            _add(known, cost, (trial.path.parent, trial.variant, cost.steps))
    return known


def _add(known: _Known, cost: _Cost, *keys: _Key) -> None:
    for key in (_ANY, *keys):
        known[key] = known[key] + cost if key in known else cost


def _cost(trial: Standing) -> _Cost | None:
    try:
        found: Mapping[str, Any] = read_json(trial.path / RESULT)
        seconds = found["seconds"]
        return _Cost(float(seconds["fit"]), float(seconds["measure"]), int(found["fit"]["steps"]))
    except (StoreError, KeyError, TypeError, ValueError):
        return None  # an estimate can do without it; whatever needs the figures themselves will say so


def _so_far(running: Collection[LastProgress | None], workers: int) -> _Known:
    """What running trials took up to now; those of one batch share a worker, as in the figures of complete ones."""
    share = min(1.0, workers / max(1, len(running)))
    known: _Known = {}
    for found in running:
        if found is not None and found.step > 0 and found.running_seconds > 0:
            _add(known, _Cost(share * found.running_seconds, 0.0, found.step))
    return known


def _left(trial: Standing, progress: LastProgress | None, known: _Known) -> float:
    steps = trial.planned.steps if trial.planned else progress.steps if progress else None
    alike = known.get((trial.path.parent, trial.variant, steps or 0))
    cost = alike or known[_ANY]
    scale = 1.0 if alike or steps is None or not cost.steps else steps * cost.trials / cost.steps
    fit, measure = scale * cost.fit / cost.trials, cost.measure / cost.trials
    if progress is None or not steps:
        return fit + measure
    return measure + (0.0 if progress.phase == "measuring" else fit * (1 - min(progress.step / steps, 1.0)))


_PROBE_SECONDS = {"first-order": 2.0, "gauss-newton": 8.0}
_WARM_UP_STEPS = 3
_START_SECONDS = 3.0

# In a step, a vertex costs about a quarter of what a sample does: see the table of `make bench`.
_VERTS_PER_SAMPLE = 4


@dataclass(frozen=True)
class Estimate:
    """How long trials will take.

    Attributes:
        seconds: until all are done.
        workers: how many run side by side.
        basis: what it was told from, such as `12 complete trials` or `a probe of 1 trial`.
    """

    seconds: float
    workers: int
    basis: str


@dataclass(frozen=True)
class _Pace:
    """What trials of one method take: seconds for each unit of work, and seconds besides."""

    per_work: float
    besides: float


def estimate(
    trials: Sequence[Trial], results: Sequence[tuple[Trial, Result]], *, jobs: int | None = None
) -> Estimate | None:
    """Estimate how long trials will take on the CPU of this machine.

    Args:
        trials: those to run.
        results: those of the same plan that are complete, with their results.
        jobs: how many processes; None leaves it to the settings.

    Returns:
        The estimate; None where there is nothing to run, or a trial may run on a GPU.

    Raises:
        TrialError: the trial that was probed fails.
    """
    if not trials or any(trial.settings.device not in ("cpu", "auto") for trial in trials):
        return None
    workers, threads = workers_and_threads(trials, jobs)
    paces = _paces_of(results)
    missing = dict.fromkeys(trial.settings.fit.method for trial in trials if trial.settings.fit.method not in paces)
    for method in missing:
        alike = sorted((trial for trial in trials if trial.settings.fit.method == method), key=_work)
        pace = _probed(alike[len(alike) // 2], threads)
        if pace is None:
            return None
        paces[method] = pace
    each = [paces[trial.settings.fit.method] for trial in trials]
    seconds = [pace.besides + pace.per_work * _work(trial) for pace, trial in zip(each, trials, strict=True)]
    wall = max(sum(seconds) / workers, *seconds) + _START_SECONDS
    told = [count_text(len(results), "complete trial")] if results else []
    probed = [f"a probe of {count_text(len(missing), 'trial')}"] if missing else []
    return Estimate(wall, workers, " and ".join(told + probed))


def _paces_of(results: Sequence[tuple[Trial, Result]]) -> dict[str, _Pace]:
    found: dict[str, list[_Pace]] = {}
    for trial, result in results:
        seconds = result["seconds"]
        pace = _Pace(seconds["fit"] / max(_work(trial), 1.0), seconds["measure"])
        found.setdefault(trial.settings.fit.method, []).append(pace)
    return {
        method: _Pace(median(pace.per_work for pace in paces), median(pace.besides for pace in paces))
        for method, paces in found.items()
    }


def _work(trial: Trial) -> float:
    """What the time of a fit is proportional to."""
    fit, verts = trial.settings.fit, _num_verts(trial.settings.source, trial.named_scheme)
    if isinstance(fit, FirstOrderSettings):
        return fit.steps * (fit.samples + verts / _VERTS_PER_SAMPLE)
    if fit.connectivity == "remeshed":
        return float(fit.steps * fit.verts)
    from meshfit.subdivision.refine import growth

    return float(fit.steps * verts * growth(trial.named_scheme.resolve(), fit.levels))


@cache
def _num_verts(source: SourceSettings, scheme: NamedScheme) -> int:
    from meshfit.experiment.source import build_source

    return build_source(source, scheme.resolve()).num_verts


def _probed(trial: Trial, threads: int) -> _Pace | None:
    """In a worker, as trials are: with the same environment, and without the wait for torch here."""
    with environment(ONE_THREAD):
        executor = LocalExecutor(1, Board.of(1))
        try:
            if trial.settings.device == "auto" and executor.count_gpus():
                return None
            fit, besides = executor.submit(_probe, trial, threads).result()
        except BrokenProcessPool:
            raise TrialError(f"{trial.label}: the process that probed it was killed") from None
        finally:
            executor.shutdown()
    return _Pace(fit / max(_work(trial), 1.0), besides)


def _probe(trial: Trial, threads: int) -> tuple[float, float]:
    """Seconds of the whole fit, going by its first steps, and of what is done before and after."""
    from meshfit.experiment.running.batch_runner import run_together

    started, steps = time.perf_counter(), list[tuple[int, float]]()

    def on_progress(_: int, progress: Progress) -> None:
        if progress.phase is Phase.FITTING and progress.step is not None:
            steps.append((progress.step.done, time.perf_counter()))
            if steps[-1][1] - steps[0][1] > _PROBE_SECONDS[trial.settings.fit.method]:
                raise Interrupted

    with TemporaryDirectory(prefix="meshfit-") as folder:
        store = RunDirectory(Path(folder))
        (outcome,) = run_together([trial], store, on_progress, device="cpu", threads=threads)
        result = store.result(trial)
    if result is not None:
        whole = time.perf_counter() - started
        return result["seconds"]["fit"], whole - result["seconds"]["fit"]
    if outcome.phase is Phase.FAILED or len(steps) < 2:
        raise TrialError(f"{trial.label}: {outcome.message or 'no steps to go by'}")
    first, last = steps[min(_WARM_UP_STEPS, len(steps) - 2)], steps[-1]
    per_step = (last[1] - first[1]) / (last[0] - first[0])
    before = steps[0][1] - started
    return per_step * trial.settings.fit.steps, before + _seconds_to_measure(trial)


def _seconds_to_measure(trial: Trial) -> float:
    """Of the target against itself, which a good result is like."""
    from meshfit.measuring.measure import measure
    from meshfit.mesh.targets import load_target

    target = load_target(trial.where(trial.target))
    start = time.perf_counter()
    measure(target, target, trial.settings.measure)
    return time.perf_counter() - start
