"""The points that a search asks for: first those of a space-filling design, then those of Optuna's TPE sampler.

Each batch depends only on the points before it and on (seed, batch), so neither workers nor interruptions change it.
"""

import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import Any

import numpy as np

from meshfit.config.sweep_samples import SampleSettings, limits, rounded, sampled_points
from meshfit.experiment.tuning.objectives import Objective
from meshfit.experiment.tuning.search_file import COMPLETE, FAILED, Point
from meshfit.optional import import_optional

FIRST, BATCH = 16, 8
"""Points of the design, and of each batch after it; powers of two fill ranges most evenly."""
_MOST_REPEATS = 64
_MOST_COUNTED = 10_000

Changes = dict[str, Any]


def import_optuna() -> Any:  # noqa: ANN401  an optional library
    """Import Optuna.

    Raises:
        ConfigError: it is not installed.
    """
    with _without_warnings():
        return import_optional("optuna", "a search needs", "'meshfit[tune]'")


def ask(
    points: Sequence[Point],
    ranges: Mapping[str, Any],
    objectives: Sequence[Objective],
    sample: SampleSettings,
    batch: int,
) -> list[Changes]:
    """Return the points of a batch, none of which was asked before; fewer or none where there are no others.

    Args:
        points: those of all earlier batches, complete or failed.
        ranges: the ranges, from `read_ranges`.
        objectives: the objectives.
        sample: seed and design of the search.
        batch: number of the batch, from 0.

    Raises:
        ConfigError: Optuna is not installed.
    """
    if batch == 0:
        return sampled_points({"points": FIRST, "seed": sample.seed, "method": sample.method}, ranges)
    known, found = {_key(point.changes) for point in points}, list[Changes]()
    left = [changes for changes in _combinations(ranges) if _key(changes) not in known]
    if len(left) <= BATCH and _num_combinations(ranges) <= _MOST_COUNTED:
        return left
    optuna = import_optuna()
    with _without_warnings():
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        seed = int(np.random.SeedSequence([sample.seed, batch]).generate_state(1)[0])
        sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True, n_startup_trials=0)
        directions = ["maximize" if objective.maximise else "minimize" for objective in objectives]
        study = optuna.create_study(directions=directions, sampler=sampler)
        axes = {key: _distribution(optuna, values) for key, values in ranges.items()}
        for point in points:
            _add(optuna, study, axes, ranges, point)
        for _ in range(BATCH + _MOST_REPEATS):
            if len(found) == BATCH:
                break
            asked = study.ask(axes)
            changes = {key: _value(ranges[key], value) for key, value in asked.params.items()}
            if _key(changes) not in known:
                known.add(_key(changes))
                found.append(changes)
    return found


def _num_combinations(ranges: Mapping[str, Any]) -> float:
    """The number of points that there are; infinite if a range is continuous."""
    return math.prod(_num_values(values) for values in ranges.values())


def _num_values(values: Any) -> float:  # noqa: ANN401  any YAML values
    if isinstance(values, list):
        return len(values)
    low, high, _, integer = limits(values)
    return high - low + 1 if integer else math.inf


def _combinations(ranges: Mapping[str, Any]) -> Iterator[Changes]:
    """Yield all points there are, unless they are too many to be counted."""
    if _num_combinations(ranges) <= _MOST_COUNTED:
        lists = [each if isinstance(each, list) else _integers(each) for each in ranges.values()]
        yield from (dict(zip(ranges, values, strict=True)) for values in product(*lists))


def _integers(values: Mapping[str, Any]) -> list[int]:
    low, high, _, _ = limits(values)
    return list(range(int(low), int(high) + 1))


def _add(
    optuna: Any,  # noqa: ANN401  an optional library
    study: Any,  # noqa: ANN401
    axes: Mapping[str, Any],
    ranges: Mapping[str, Any],
    point: Point,
) -> None:
    """Tell a study of a point; a failed one is pruned, which the sampler takes for worse than any complete one."""
    params = {key: _parameter(ranges[key], value) for key, value in point.changes.items()}
    states = {COMPLETE: optuna.trial.TrialState.COMPLETE, FAILED: optuna.trial.TrialState.PRUNED}
    values = list(point.values) if point.state == COMPLETE else None
    study.add_trial(
        optuna.trial.create_trial(state=states[point.state], values=values, params=params, distributions=axes)
    )


def _distribution(optuna: Any, values: Any) -> Any:  # noqa: ANN401  an optional library
    """Return the distribution of a range; lists of numbers are ordered, other lists are categories."""
    if isinstance(values, list):
        if _is_ordered(values):
            return optuna.distributions.IntDistribution(0, len(values) - 1)
        return optuna.distributions.CategoricalDistribution(list(map(json.dumps, values)))
    low, high, is_log, integer = limits(values)
    if integer:
        return optuna.distributions.IntDistribution(int(low), int(high), log=is_log)
    return optuna.distributions.FloatDistribution(low, high, log=is_log)


def _is_ordered(values: Sequence[Any]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _value(values: Any, parameter: Any) -> Any:  # noqa: ANN401  any YAML values
    """Return the value of a setting from Optuna's parameter."""
    if isinstance(values, list):
        return sorted(values)[parameter] if _is_ordered(values) else json.loads(parameter)
    low, high, _, integer = limits(values)
    return int(parameter) if integer else rounded(parameter, low, high)


def _parameter(values: Any, value: Any) -> Any:  # noqa: ANN401  any YAML values
    """Return Optuna's parameter from the value of a setting."""
    if isinstance(values, list):
        return sorted(values).index(value) if _is_ordered(values) else json.dumps(value)
    return value


def _key(changes: Mapping[str, Any]) -> str:
    return json.dumps(changes, sort_keys=True)


@contextmanager
def _without_warnings() -> Iterator[None]:
    """Hide the notes of Optuna on features that may still change."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
