"""The plan of a fit: what is done to the surface before which steps, and how stiff it is at each of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from meshfit.fitting.settings import GaussNewtonSettings

Change = Literal["none", "start", "remesh", "place", "refine", "control"]

_STEPS_BETWEEN_REMESHES = 5
# While the rough shape is found, surfaces have half as many verts as at the end of it.
_ROUGH_SHARE = 0.5
# Fairness, by stage: from, times a factor with each step.
_COARSE, _COARSE_FACTOR = 10.0, 0.8
_LEVEL, _LEVEL_FACTOR = 0.2, 0.7
# Weights of residuals along the target, likewise, and the least.
_POINT, _POINT_FACTOR, _POINT_LEAST = 0.5, 0.85, 0.05
_LAST_POINT, _LAST_POINT_LEAST = 0.05, 0.01


@dataclass(frozen=True)
class Stage:
    """Some steps on one connectivity.

    Attributes:
        name: what progress calls it.
        change: what is done first: nothing; `start` from the source, remeshed; `remesh`; `place` the source's
            connectivity on the surface; `refine` it by the scheme; or make it the `control` mesh of its refinement.
        share: for `remesh`, the number of verts wanted as a share of that at the end of the coarse stage.
        sized: for `remesh`, whether edges are to be shorter where the target is curved.
        weights: fairness and point weight of each step.
        attempt: the number of the try at the rough shape, from 0; None where that has been found.
        refined: for `remesh`, levels of the scheme by which there are to be more verts than that share.
    """

    name: str
    change: Change
    share: float
    sized: bool
    weights: tuple[tuple[float, float], ...]
    attempt: int | None = None
    refined: int = 0


def schedule(settings: GaussNewtonSettings) -> list[Stage]:
    """All stages of a fit, coarsest first."""
    found = [stage for attempt in range(settings.tries) for stage in _coarse(settings, attempt)]
    remeshed = settings.connectivity == "remeshed"
    level = _falling(_LEVEL, _LEVEL_FACTOR, settings.fairness, settings.level_steps)
    points = _falling(_POINT, _POINT_FACTOR, _POINT_LEAST, settings.level_steps)
    weights = tuple(zip(level, points, strict=True))
    found.append(Stage("level 0", "remesh" if remeshed else "place", 1.0, remeshed, weights))
    if settings.variables == "control":
        return [*found, Stage("control mesh", "control", 1.0, sized=False, weights=weights + _last(settings))]
    found += [Stage(f"level {k}", "refine", 1.0, sized=False, weights=weights) for k in range(1, settings.levels + 1)]
    weights = _last(settings)
    change: Change = "remesh" if remeshed else "none"
    found.append(Stage("last", change, 1.0, remeshed, weights, refined=settings.levels))
    return found


def _last(settings: GaussNewtonSettings) -> tuple[tuple[float, float], ...]:
    fairness = _falling(settings.fairness / 2, _LEVEL_FACTOR, settings.last_fairness, settings.last_steps)
    return tuple(
        zip(fairness, _falling(_LAST_POINT, _POINT_FACTOR, _LAST_POINT_LEAST, settings.last_steps), strict=True)
    )


def stage_at(settings: GaussNewtonSettings, done: int) -> Stage:
    """The stage of the step that follows so many."""
    plan = [stage for stage in schedule(settings) for _ in stage.weights]
    return plan[min(done, len(plan) - 1)]


def _coarse(settings: GaussNewtonSettings, attempt: int) -> Iterator[Stage]:
    count = settings.coarse_steps
    fairness = _falling(_COARSE, _COARSE_FACTOR, settings.fairness, count)
    weights = tuple(zip(fairness, _falling(_POINT, _POINT_FACTOR, _POINT_LEAST, count), strict=True))
    for start in range(0, count, _STEPS_BETWEEN_REMESHES):
        sized = start > count // 2
        part = weights[start : start + _STEPS_BETWEEN_REMESHES]
        yield Stage("rough shape", "remesh" if start else "start", _ROUGH_SHARE, sized, part, attempt)


def _falling(start: float, factor: float, least: float, count: int) -> tuple[float, ...]:
    return tuple(max(start * factor**step, least) for step in range(count))
