"""The schedule of a Gauss–Newton fit: its stages, the change that each begins with, and the weights of each step."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from meshfit.fitting.settings import GaussNewtonSettings

Change = Literal["none", "start", "remesh", "place", "refine", "control"]

_STEPS_BETWEEN_REMESHES = 5
# Number of vertices during the search for the rough shape, relative to that at its end.
_ROUGH_SHARE = 0.5
# Fairness at the start of the coarse stages, and its factor per step; the factor in later stages.
_COARSE, _COARSE_FACTOR = 10.0, 0.8
_LEVEL_FACTOR = 0.7
# Weight of residuals along the target: at the start, its factor per step, and the least.
_POINT, _LAST_POINT = (0.5, 0.85, 0.05), (0.05, 0.85, 0.01)

Weights = tuple[tuple[float, float], ...]


class LevelFairness(NamedTuple):
    """Fairness at the start and at the end of a level, and at the end of the last steps."""

    start: float
    level: float
    last: float


_FAR, _NEAR = LevelFairness(0.2, 0.1, 0.02), LevelFairness(0.05, 0.02, 0.005)
"""Defaults, for sources that are far from the target, and for those that are near and have little to lose."""


@dataclass(frozen=True)
class Stage:
    """Some steps on one connectivity.

    Attributes:
        name: name in progress messages.
        change: change before the first step: `none`; `start` from the source, remeshed; `remesh`; `place` the source's
            connectivity on the surface; `refine` by the scheme; or make it the `control` mesh of its refinement.
        share: for `remesh`, the number of vertices relative to that at the end of the rough shape.
        sized: for `remesh`, whether edges are shorter where the target is curved.
        weights: fairness and point weight of each step.
        attempt: number of the search for the rough shape, from 0; None in later stages.
        refined: for `remesh`, number of subdivision levels by which the number of vertices grows beyond `share`.
    """

    name: str
    change: Change
    share: float
    sized: bool
    weights: Weights
    attempt: int | None = None
    refined: int = 0


def fairness_of(settings: GaussNewtonSettings, *, near: bool) -> LevelFairness:
    """Return the weights of smoothness: those that are set, else the defaults for a far or a near source."""
    given = (settings.start_fairness, settings.fairness, settings.last_fairness)
    usual = _NEAR if near else _FAR
    return LevelFairness(*(default if value is None else value for value, default in zip(given, usual, strict=True)))


def schedule(settings: GaussNewtonSettings, *, near: bool = False) -> list[Stage]:
    """Return all stages of a fit, coarsest first.

    Args:
        settings: of the fit.
        near: whether the source is near to the target; the search for the rough shape is skipped then, but counted.
    """
    fairness = fairness_of(settings, near=near)
    stages = [stage for attempt in range(settings.tries) for stage in _coarse(settings, attempt)]
    remeshed = settings.connectivity == "remeshed"
    weights = _weights((fairness.start, _LEVEL_FACTOR, fairness.level), _POINT, settings.level_steps)
    last = _weights((fairness.level / 2, _LEVEL_FACTOR, fairness.last), _LAST_POINT, settings.last_steps)
    stages.append(Stage("level 0", "remesh" if remeshed else "place", 1.0, remeshed, weights))
    if settings.variables == "control":
        return [*stages, Stage("control mesh", "control", 1.0, sized=False, weights=weights + last)]
    stages += [Stage(f"level {k}", "refine", 1.0, sized=False, weights=weights) for k in range(1, settings.levels + 1)]
    change: Change = "remesh" if remeshed else "none"
    stages.append(Stage("last", change, 1.0, remeshed, last, refined=settings.levels))
    return stages


def rough_verts(settings: GaussNewtonSettings, source_verts: int, growth: float) -> float:
    """Return the number of vertices at the end of the rough shape.

    Args:
        settings: settings of the fit.
        source_verts: number of vertices of the source.
        growth: factor by which all levels of the scheme multiply vertices.
    """
    if settings.connectivity == "fixed":
        # A coarse source is no reason to miss thin parts.
        return max(float(source_verts), settings.verts / 4.0)
    return settings.verts / (1.0 if settings.variables == "control" else growth)


def stage_at(settings: GaussNewtonSettings, done: int) -> Stage:
    """Return the stage of the step after `done` steps."""
    plan = [stage for stage in schedule(settings) for _ in stage.weights]
    return plan[min(done, len(plan) - 1)]


def _coarse(settings: GaussNewtonSettings, attempt: int) -> Iterator[Stage]:
    count = settings.coarse_steps
    weights = _weights((_COARSE, _COARSE_FACTOR, fairness_of(settings, near=False).level), _POINT, count)
    for start in range(0, count, _STEPS_BETWEEN_REMESHES):
        sized = start > count // 2
        part = weights[start : start + _STEPS_BETWEEN_REMESHES]
        yield Stage("rough shape", "remesh" if start else "start", _ROUGH_SHARE, sized, part, attempt)


def _weights(fairness: tuple[float, float, float], points: tuple[float, float, float], count: int) -> Weights:
    """Return fairness and point weight of each step; both fall by a factor per step, from a start to a least value."""
    falls = (tuple(max(start * factor**k, least) for k in range(count)) for start, factor, least in (fairness, points))
    return tuple(zip(*falls, strict=True))
