"""Objectives of a search: a metric, its direction, and one value for the trials of a point."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from meshfit.errors import ConfigError
from meshfit.experiment.storage.run_directory import Result
from meshfit.measuring.metrics import METRICS, require_metric


@dataclass(frozen=True)
class Objective:
    """A metric that is to become as small, or as large, as possible.

    Attributes:
        metric: a name in `METRICS`.
        maximise: whether larger values are better.
    """

    metric: str
    maximise: bool

    @property
    def is_geometric(self) -> bool:
        """Whether its means are geometric: lengths, angles, times; not shares and counts, which may be 0 or below."""
        return METRICS[self.metric].unit != ""

    def text(self, value: float) -> str:
        """Return a value as text; means of counts are no integers."""
        if METRICS[self.metric].whole:
            return format(value, ".4g")
        spec = METRICS[self.metric].format
        # With all digits, so that values below each other are aligned.
        return format(value, f"#{spec}").removesuffix(".") if spec.endswith("g") else format(value, spec)

    def gain(self, value: float, other: float) -> float:
        """How much better a value is than another; below 0 if it is worse."""
        return value - other if self.maximise else other - value


def objectives_of(metrics: Sequence[str], maximise: Sequence[str], minimise: Sequence[str]) -> tuple[Objective, ...]:
    """Return the objectives that options give.

    Args:
        metrics: metrics whose better direction is known.
        maximise: metrics to be as large as possible.
        minimise: metrics to be as small as possible.

    Raises:
        ConfigError: an unknown metric, one without a better direction, or one in both directions.
    """
    found: dict[str, Objective] = {}
    for metric in (*metrics, *maximise, *minimise):
        require_metric(metric)
        smaller = METRICS[metric].smaller_is_better
        if metric in maximise and metric in minimise:
            raise ConfigError(f"{metric}: expected --maximise or --minimise, got both")
        if smaller is None and metric not in maximise and metric not in minimise:
            raise ConfigError(
                f"{metric}: neither smaller nor larger is better; give --minimise {metric} or --maximise {metric}"
            )
        found[metric] = Objective(metric, metric in maximise or (metric not in minimise and smaller is False))
    return tuple(found.values())


def value_of(result: Mapping[str, Any], metric: str) -> float | None:
    """Return a metric of a result; None if it has none."""
    value: Any = result
    for key in metric.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return None if value is None else float(value)


def score(results: Sequence[Result], objective: Objective) -> float | None:
    """Return the objective of a point; None if a result lacks the metric.

    Each cell, one target and one scheme, is the mean over its seeds, as in tables. The score is the mean over the
    cells: the geometric one, in which a factor counts the same on each target, unless the metric is a share or a count.
    """
    cells: dict[tuple[str, str], list[float]] = {}
    for result in results:
        value = value_of(result, objective.metric)
        if value is None:
            return None
        cells.setdefault((result["target"], result["scheme"]), []).append(value)
    means = [fmean(values) for values in cells.values()]
    if not objective.is_geometric or min(means) < 0:
        return fmean(means)
    return math.exp(fmean(map(math.log, means))) if min(means) > 0 else 0.0


def front(values: Sequence[Sequence[float]], objectives: Sequence[Objective]) -> list[int]:
    """Return the indices of the points that no other is better than in one objective and as good as in the others."""
    costs = [[-v if o.maximise else v for v, o in zip(point, objectives, strict=True)] for point in values]
    return [i for i, cost in enumerate(costs) if not any(_dominates(other, cost) for other in costs)]


def _dominates(first: Sequence[float], second: Sequence[float]) -> bool:
    return first != second and all(a <= b for a, b in zip(first, second, strict=True))
