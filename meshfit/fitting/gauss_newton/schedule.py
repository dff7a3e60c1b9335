"""The schedule of a Gauss–Newton fit: its stages, the change that each begins with, and the weights of each step."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Literal, NamedTuple

from meshfit.fitting.registration.plan import Prior, planned_steps
from meshfit.fitting.settings import GaussNewtonSettings

Change = Literal["none", "start", "remesh", "place", "refine", "control", "decimate", "register"]

_STEPS_BETWEEN_REMESHES = 5
# Number of vertices during each search for the rough shape, relative to that at its end: more where the last search
# left parts unmatched, as coarse surfaces pinch thin parts such as legs and fold inside them.
_ROUGH_SHARES = (0.5, 1.0, 2.0)
# Fairness at the start of the coarse stages, and its factor per step; the factor in later stages.
_COARSE, _COARSE_FACTOR = 10.0, 0.8
_LEVEL_FACTOR = 0.7
# Weight of residuals along the target: at the start, its factor per step, and the least.
_POINT, _LAST_POINT = (0.5, 0.85, 0.05), (0.05, 0.85, 0.01)
# Fairness and point weight fall faster on the fine surface, which is near the target.
_FINE_FACTOR, _FINE_POINT = 0.5, (0.05, 0.7, 0.01)
# Residuals beyond so many robust standard deviations count little, on noisy targets: at the levels, and in the last
# steps.
_ROBUST, _LAST_ROBUST = 6.0, 3.0
# Number of steps after decimation, and number of vertices before it beyond which it gains too little for its time.
_STEPS_DECIMATED, _MOST_FINE = 2, 60_000

# Name of the last stage.
_LAST = "last"

Weights = tuple[tuple[float, float], ...]


class LevelFairness(NamedTuple):
    """Fairness at the start and at the end of a level, and at the end of the last steps."""

    start: float
    level: float
    last: float


_FAR, _NEAR = LevelFairness(0.2, 0.1, 0.02), LevelFairness(0.05, 0.02, 0.005)
"""Defaults, for sources that are far from the target, and for those that are near and have little to lose."""
_REGISTERED = LevelFairness(0.5, 0.2, 0.1)
"""Defaults after registration, for the smoothness of displacements."""


@dataclass(frozen=True)
class Stage:
    """Some steps on one connectivity.

    Attributes:
        name: name in progress messages.
        change: change before the first step: `none`; `start` from the source, remeshed; `remesh`; `place` the source's
            connectivity on the surface; `refine` by the scheme; make it the `control` mesh of its refinement;
            `decimate` by quadrics to the wanted number of vertices; or `register` the source, in the steps of
            `planned_steps`.
        share: for `remesh`, the number of vertices relative to that at the end of the rough shape.
        sized: for `remesh`, whether edges are shorter where the target is curved.
        weights: fairness and point weight of each step.
        attempt: number of the search for the rough shape, from 0; None in later stages.
        settles: whether the remaining steps are left out once the surface hardly moves; of the search for the rough
            shape, once all of it is matched.
        refined: for `remesh`, number of subdivision levels by which the number of vertices grows beyond `share`.
        robust: number of robust standard deviations beyond which residuals of noisy targets count little; None for all.
        registered: whether it is part of a registration.
    """

    name: str
    change: Change
    share: float
    sized: bool
    weights: Weights
    attempt: int | None = None
    settles: bool = False
    refined: int = 0
    robust: float | None = None
    registered: bool = False

    @property
    def is_last(self) -> bool:
        """Whether the faces are those of the result, and the surface is about to end."""
        return self.name == _LAST


def fairness_of(settings: GaussNewtonSettings, *, near: bool) -> LevelFairness:
    """Return the weights of smoothness: those that are set, else the defaults for a far or a near source."""
    given = (settings.start_fairness, settings.fairness, settings.last_fairness)
    usual = _REGISTERED if settings.prior is not None else _NEAR if near else _FAR
    return LevelFairness(*(default if value is None else value for value, default in zip(given, usual, strict=True)))


def schedule(settings: GaussNewtonSettings, *, near: bool = False) -> list[Stage]:
    """Return all stages of a fit, coarsest first.

    Args:
        settings: of the fit.
        near: whether the source is near to the target; the search for the rough shape is skipped then, but counted.
    """
    if settings.prior is not None:
        stages = _registration(settings, settings.prior)
        if settings.register == "auto":  # it may turn out that there is nothing to register
            stages += schedule(settings.model_copy(update={"register": "off"}), near=near)
        return stages
    fairness = fairness_of(settings, near=near)
    stages = [stage for attempt in range(settings.tries) for stage in _coarse(settings, attempt)]
    remeshed = settings.connectivity == "remeshed"
    weights = _weights((fairness.start, _LEVEL_FACTOR, fairness.level), _POINT, settings.level_steps)
    last = _weights((fairness.level / 2, _LEVEL_FACTOR, fairness.last), _LAST_POINT, settings.last_steps)
    change: Change = "remesh" if remeshed else "place"
    stages.append(Stage("level 0", change, 1.0, remeshed, weights, settles=remeshed, robust=_ROBUST))
    if settings.variables == "control":
        return [*stages, Stage("control mesh", "control", 1.0, sized=False, weights=weights + last, robust=_ROBUST)]
    names = [f"level {k}" for k in range(1, settings.levels + 1)]
    stages += [
        Stage(name, "refine", 1.0, sized=False, weights=weights, settles=remeshed, robust=_ROBUST) for name in names
    ]
    if not remeshed:
        return [*stages, Stage(_LAST, "none", 1.0, sized=False, weights=last, robust=_LAST_ROBUST)]
    share = min(settings.decimate_from, max(1.0, _MOST_FINE / settings.verts))
    after = min(_STEPS_DECIMATED, settings.last_steps - 1)
    if share == 1 or after < 1:
        return [
            *stages,
            Stage(_LAST, "remesh", 1.0, sized=True, weights=last, refined=settings.levels, robust=_LAST_ROBUST),
        ]
    least = _NEAR.last if settings.last_fairness is None else settings.last_fairness
    last = _weights((fairness.level / 4, _FINE_FACTOR, least), _FINE_POINT, settings.last_steps)
    stages.append(
        Stage("fine", "remesh", share, sized=True, weights=last[:-after], refined=settings.levels, robust=_LAST_ROBUST)
    )
    return [
        *stages,
        Stage(_LAST, "decimate", 1.0, sized=True, weights=last[-after:], refined=settings.levels, robust=_LAST_ROBUST),
    ]


def _registration(settings: GaussNewtonSettings, prior: Prior) -> list[Stage]:
    """Return the stages of a registration: of the source as it is, then of each level of the scheme."""
    fairness = fairness_of(settings, near=True)
    groups = groupby(planned_steps(prior), lambda planned: planned.stage)
    stages = [
        Stage(name, "register", 1.0, sized=False, weights=((0.0, 0.0),) * len(list(group)), registered=True)
        for name, group in groups
    ]
    weights = _weights((fairness.start, _LEVEL_FACTOR, fairness.level), _LAST_POINT, settings.level_steps)
    last = _weights((fairness.level, _LEVEL_FACTOR, fairness.last), _LAST_POINT, settings.last_steps)
    for level in range(1, settings.levels + 1):
        steps = weights + last if level == settings.levels else weights
        stages.append(Stage(f"level {level}", "refine", 1.0, sized=False, weights=steps, registered=True))
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
    """Return the stage of the step after the first `done` steps of the schedule."""
    plan = [stage for stage in schedule(settings) for _ in stage.weights]
    return plan[min(done, len(plan) - 1)]


def stage_before_end(settings: GaussNewtonSettings, left: int) -> Stage:
    """Return the stage of the step that has `left` steps until the end, itself among them."""
    plan = [stage for stage in schedule(settings) for _ in stage.weights]
    return plan[max(0, len(plan) - max(left, 1))]


def _coarse(settings: GaussNewtonSettings, attempt: int) -> Iterator[Stage]:
    count = settings.coarse_steps
    least = fairness_of(settings, near=False).level
    weights = _weights((_COARSE, _COARSE_FACTOR, least), _POINT, count)
    share = _ROUGH_SHARES[min(attempt, len(_ROUGH_SHARES) - 1)]
    for start in range(0, count, _STEPS_BETWEEN_REMESHES):
        sized = start > count // 2
        part = weights[start : start + _STEPS_BETWEEN_REMESHES]
        change: Change = "remesh" if start else "start"
        yield Stage("rough shape", change, share, sized, part, attempt, settles=part[0][0] <= least)


def _weights(fairness: tuple[float, float, float], points: tuple[float, float, float], count: int) -> Weights:
    """Return fairness and point weight of each step; both fall by a factor per step, from a start to a least value."""
    falls = (tuple(max(start * factor**k, least) for k in range(count)) for start, factor, least in (fairness, points))
    return tuple(zip(*falls, strict=True))
