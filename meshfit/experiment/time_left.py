"""About how long an experiment still takes, from what its complete trials took and from how far others are."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from meshfit.errors import StoreError
from meshfit.experiment.folders import State
from meshfit.experiment.overview import ExperimentOverview, Standing
from meshfit.experiment.progress_file import LastProgress, read_progress
from meshfit.experiment.store import RESULT, read_json

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
