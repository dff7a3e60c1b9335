"""Progress of one fit for `progress=True`: a bar on a terminal, one line in a notebook, plain lines elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from meshfit.fitting.callbacks import Step
from meshfit.fitting.gauss_newton.schedule import schedule, stage_at
from meshfit.fitting.settings import FitSettings, GaussNewtonSettings
from meshfit.units import duration_text

# Cost of a step relative to one of level 0: of the search for the rough shape, and of each further level.
_ROUGH, _PER_LEVEL = 0.6, 2.5
_SECONDS_BETWEEN_LINES = 5.0
_SECONDS_BETWEEN_UPDATES = 0.2
_BAR = 24


def step_costs(settings: FitSettings, tries: int | None = None) -> list[float]:
    """Return the relative cost of each step, for an estimate of the remaining time: finer levels take longer.

    Steps of searches for the rough shape after the first `tries` cost nothing: most fits leave them out.
    """
    if not isinstance(settings, GaussNewtonSettings):
        return [1.0] * settings.steps
    costs, level = list[float](), 0
    for stage in schedule(settings):
        level += stage.change in ("refine", "control")
        cost = _ROUGH if stage.attempt is not None else _PER_LEVEL**level
        if tries is not None and stage.attempt is not None and stage.attempt >= tries:
            cost = 0.0
        costs += [cost] * len(stage.weights)
    return costs


class Course:
    """The share of a fit's work that is done, and the seconds that remain.

    Attributes:
        step: the last step reported; None before the first.
        share: share of the work that is done, from 0 to 1.
    """

    def __init__(self, settings: FitSettings, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._start, self._costs = clock, clock(), step_costs(settings, 1)
        self._settings, self._tries = settings, 1
        self._first: tuple[float, float] | None = None
        self.step: Step | None = None
        self.share = 0.0

    def update(self, step: Step) -> None:
        """Take note of a step."""
        if isinstance(self._settings, GaussNewtonSettings) and step.done:
            attempt = stage_at(self._settings, step.done - 1).attempt
            if attempt is not None and attempt >= self._tries:  # a further search has begun
                self._tries = attempt + 1
                self._costs = step_costs(self._settings, self._tries)
        total = sum(self._costs) or 1.0
        self.step, self.share = step, sum(self._costs[: step.done]) / total
        if self._first is None:  # the first step prepares what the others use
            self._first = self.share, self._clock()

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._start

    @property
    def seconds_left(self) -> float | None:
        """Estimated seconds until the end; None where nothing is known."""
        if self._first is None or self.share <= self._first[0]:
            return None
        share, since = self._first
        return (self._clock() - since) / (self.share - share) * (1 - self.share)

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
def shown_progress(settings: FitSettings, on_step: Callable[[Step], None] | None) -> Iterator[Callable[[Step], None]]:
    """Show the progress of a fit within a `with` block; yield a callback that also calls the caller's own."""
    course = Course(settings)
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
    elif sys.stderr is not None and sys.stderr.isatty():
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
