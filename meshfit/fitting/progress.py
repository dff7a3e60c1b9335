"""Progress of one fit for `progress=True`: a bar on a terminal, one line in a notebook, plain lines elsewhere."""

import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from meshfit.fitting.callbacks import Step
from meshfit.fitting.gauss_newton.schedule import rough_verts, schedule
from meshfit.fitting.registration.plan import planned_steps
from meshfit.fitting.settings import FitSettings, GaussNewtonSettings
from meshfit.subdivision.growth import growth
from meshfit.subdivision.registry import Scheme, resolve
from meshfit.units import duration_text

# Seconds of a Gauss–Newton step of n vertices on one core, which sets up and factorises a sparse system, as factors of
# 1, n and n^1.5; of a remesh, without and with a map to the sphere, and of placing faces by that map, of 1 and n. Only
# their ratios matter once steps have been timed.
_STEP = (0.05, 1.5e-5, 3.8e-7)
_REMESH, _MAPPED, _PLACE = (0.22, 8e-5), (0.5, 1e-4), (0.5, 1e-3)
# Weight that the time of a step keeps when the next one has been timed.
_KEPT = 0.95
_SECONDS_BETWEEN_LINES = 5.0
_SECONDS_BETWEEN_UPDATES = 0.2
_BAR = 24


def step_costs(
    settings: FitSettings, attempt: int = 0, *, source_verts: int = 642, scheme: str | Scheme = "loop"
) -> list[float]:
    """Return the relative cost of each step, by its number of vertices and the remesh that it begins with.

    Args:
        settings: settings of the fit.
        attempt: number of the search for the rough shape, from 0, whose steps are among them; those of others are not.
        source_verts: number of vertices of the source.
        scheme: the scheme of the levels.
    """
    if not isinstance(settings, GaussNewtonSettings):
        return [1.0] * settings.steps
    settings, attempt = _as_known(settings, attempt)
    per_level = growth(resolve(scheme), 1)
    rough = rough_verts(settings, source_verts, growth(resolve(scheme), settings.levels))
    verts = float(source_verts)
    costs = _registration_costs(settings, verts)
    for stage in schedule(settings):
        wanted = rough * stage.share * per_level**stage.refined
        if stage.change == "start":
            verts = min(float(source_verts), wanted)
        elif stage.change in ("remesh", "decimate"):
            verts = wanted
        elif stage.change == "place":
            verts = float(source_verts)
        elif stage.change == "refine":
            verts *= per_level
        elif stage.change == "control":
            verts *= per_level**settings.levels
        if stage.attempt not in (None, attempt) or stage.change == "register":
            continue
        part = [_cost_of_step(verts)] * len(stage.weights)
        if part and stage.change in ("remesh", "decimate", "place"):
            mapped = settings.connectivity == "fixed"
            fixed, per_vert = _PLACE if stage.change == "place" else _MAPPED if mapped else _REMESH
            part[0] += fixed + per_vert * verts
        costs += part
    return costs


def _as_known(settings: GaussNewtonSettings, attempt: int) -> tuple[GaussNewtonSettings, int]:
    """Take a fit for a registration until its steps turn out to be others, which counts as a further search."""
    if settings.register != "auto" or settings.prior is None:
        return settings, attempt
    return settings.model_copy(update={"register": "off" if attempt else settings.prior}), max(0, attempt - 1)


def _registration_costs(settings: GaussNewtonSettings, verts: float) -> list[float]:
    planned = [] if settings.prior is None else planned_steps(settings.prior)
    return [_cost_of_step(verts) * step.cost for step in planned]


def _cost_of_step(verts: float) -> float:
    return float(_STEP[0] + _STEP[1] * verts + _STEP[2] * verts**1.5)


def measuring_cost(settings: FitSettings, target_faces: int) -> float:
    """Return the cost of measuring a result against a target, in the unit of `step_costs`."""
    verts = settings.verts if isinstance(settings, GaussNewtonSettings) else 2562
    return 0.8 + 5e-5 * verts + 3.5e-7 * target_faces * math.sqrt(verts)


class Course:
    """The share of a fit's work that is done, and the seconds that remain.

    Costs of steps are known in advance up to a factor, the pace, which is that of the latest steps.

    Args:
        settings: settings of the fit.
        clock: returns seconds.
        source_verts: number of vertices of the source.
        scheme: the scheme of the levels.
        after: cost of what follows the last step, in seconds where steps go at the expected pace.

    Attributes:
        step: the last step reported; None before the first.
        share: share of the work that is done, from 0 to 1.
    """

    def __init__(
        self,
        settings: FitSettings,
        clock: Callable[[], float] = time.monotonic,
        *,
        source_verts: int = 642,
        scheme: str | Scheme = "loop",
        after: float = 0.0,
    ) -> None:
        self._clock, self._start, self._settings = clock, clock(), settings
        self._source_verts, self._scheme, self._after = source_verts, scheme, after
        self._attempt = 0
        self._costs = self._costs_of_attempt()
        self._last: Step | None = None
        self._at = self._spent = self._timed = self._expected = 0.0
        self.step: Step | None = None
        self.share = 0.0

    def _costs_of_attempt(self) -> list[float]:
        """Return the costs of the steps from the start of the present search for the rough shape to the end."""
        return step_costs(self._settings, self._attempt, source_verts=self._source_verts, scheme=self._scheme)

    def _left(self, step: Step) -> float:
        """Return the cost of the steps that are left."""
        return float(sum(self._costs[max(0, len(self._costs) - (step.steps - step.done)) :]))

    def update(self, step: Step) -> None:
        """Take note of a step."""
        now, self.step, last = self._clock(), step, self._last
        if last is not None and step.done > last.done:
            made, left = step.done - last.done, last.steps - last.done
            if step.steps > last.steps:  # a further search has begun
                self._attempt += 1
                self._costs = self._costs_of_attempt()
                left = step.steps - last.done
            first = max(0, len(self._costs) - left)
            cost = sum(self._costs[first : first + made])
            self._spent += cost
            if cost:
                kept = _KEPT**made
                self._timed, self._expected = kept * self._timed + now - self._at, kept * self._expected + cost
        elif last is None:  # the first step prepares what the others use
            end = max(0, len(self._costs) - (step.steps - step.done))
            self._spent = sum(self._costs[max(0, end - step.done) : end])
        if last is None or step.done > last.done:
            self._last, self._at = step, now
        self.share = max(self.share, self._spent / (self._spent + self._left(step) + self._after or 1.0))

    @property
    def _pace(self) -> float:
        return self._timed / self._expected if self._expected else 1.0

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._start

    @property
    def seconds_left(self) -> float | None:
        """Estimated seconds until the end; None where nothing is known."""
        if self.step is None or self._last is None or not self._expected:
            return None
        left = self._pace * (self._left(self.step) + self._after)
        return max(0.0, left - (self._clock() - self._at))

    @property
    def text(self) -> str:
        """Stage, step, loss and remaining time in words."""
        if self.step is None:
            return "starting"
        step = self.step
        words = [step.stage, f"step {step.done:,} of {step.steps:,}"]
        words.append(f"{'distance' if step.stage else 'loss'} {step.loss:.2e}")
        left = self.seconds_left
        words.append(f"about {duration_text(left)} left" if left is not None and step.done < step.steps else "")
        return ", ".join(word for word in words if word)

    @property
    def summary(self) -> str:
        """Number of steps and seconds, at the end."""
        done = 0 if self.step is None else self.step.done
        return f"fit: {done:,} steps in {duration_text(self.seconds)}"


@contextmanager
def shown_progress(
    settings: FitSettings,
    on_step: Callable[[Step], None] | None,
    *,
    source_verts: int = 642,
    scheme: str | Scheme = "loop",
) -> Iterator[Callable[[Step], None]]:
    """Show the progress of a fit within a `with` block; yield a callback that also calls the caller's own."""
    course = Course(settings, source_verts=source_verts, scheme=scheme)
    with _display(course) as show:

        def step_made(step: Step) -> None:
            course.update(step)
            show()
            if on_step is not None:
                on_step(step)

        yield step_made


@contextmanager
def _display(course: Course) -> Iterator[Callable[[], None]]:
    display = _notebook_display()
    if display is not None:
        with _notebook_line(course, display) as show:
            yield show
    elif sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
        with _bar(course) as show:
            yield show
    else:
        yield _lines(course)


def _notebook_display() -> Callable[..., Any] | None:
    """Return IPython's `display` in a notebook, which rich cannot update without widgets; None elsewhere."""
    ipython: Any = sys.modules.get("IPython")  # loaded by every notebook
    shell = ipython.get_ipython() if ipython is not None else None
    return ipython.display.display if shell is not None and hasattr(shell, "kernel") else None


@contextmanager
def _notebook_line(course: Course, display: Callable[..., Any]) -> Iterator[Callable[[], None]]:
    handle = display({"text/plain": course.text}, raw=True, display_id=True)
    last = [time.monotonic()]

    def show() -> None:
        if time.monotonic() - last[0] > _SECONDS_BETWEEN_UPDATES:
            last[0] = time.monotonic()
            filled = round(_BAR * course.share)
            bar = "█" * filled + "░" * (_BAR - filled)
            handle.update({"text/plain": f"{bar} {100 * course.share:3.0f} %  {course.text}"}, raw=True)

    try:
        yield show
    finally:
        handle.update({"text/plain": course.summary}, raw=True)


@contextmanager
def _bar(course: Course) -> Iterator[Callable[[], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (
        TextColumn("fit"),
        BarColumn(bar_width=_BAR),
        TextColumn("{task.percentage:3.0f} %  {task.fields[state]}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task("", total=1.0, state=course.text)
        yield lambda: bars.update(task, completed=course.share, state=course.text)


def _lines(course: Course) -> Callable[[], None]:
    last = [time.monotonic()]

    def show() -> None:
        step = course.step
        is_last = step is not None and step.done == step.steps
        if sys.stderr is not None and (is_last or time.monotonic() - last[0] > _SECONDS_BETWEEN_LINES):
            last[0] = time.monotonic()
            print(course.summary if is_last else f"fit: {course.text}", file=sys.stderr, flush=True)  # noqa: T201

    return show
