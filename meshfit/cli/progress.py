"""Progress on stderr: bars on a terminal; elsewhere plain lines for a log, slow enough to be read."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Column

from meshfit.cli.console import err
from meshfit.experiment.trial_status import Outcome, TrialStatus
from meshfit.fitting.callbacks import Step
from meshfit.fitting.gauss_newton.schedule import stage_before_end
from meshfit.fitting.settings import ExternalSettings, GaussNewtonSettings
from meshfit.units import duration_text

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.running.backends import ProgressReader
    from meshfit.experiment.running.scheduler import Watcher

_LINES_AT_ONCE = 20
_SECONDS_PER_LINE = 5.0
_SECONDS_OF_SILENCE = 60.0
_LINES_BELOW_BARS = 4


def bars_with_states(speed_estimate_period: float = 30.0) -> Progress:
    """Return bars of tasks with a field `state`, whose remaining time is judged by so many seconds."""
    columns = (
        TextColumn("{task.description}", table_column=Column(no_wrap=True, ratio=1)),
        BarColumn(bar_width=10),
        TextColumn("{task.fields[state]}", table_column=Column(no_wrap=True)),
        TextColumn("ETA"),
        TimeRemainingColumn(compact=True, elapsed_when_finished=False),
    )
    return Progress(*columns, console=err, transient=True, expand=True, speed_estimate_period=speed_estimate_period)


@contextmanager
def show_progress(trials: Sequence["Trial"], *, quiet: bool) -> Iterator["Watcher"]:
    """Show the progress of trials within a `with` block."""
    if quiet:
        yield lambda *_: None
    elif err.is_terminal and not err.is_dumb_terminal:
        with bars_with_states() as bars:
            yield TrialBars(trials, bars).update
    else:
        yield TrialLines(trials).update


@contextmanager
def show_parts(*, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Show the progress of work that has parts: called with a part's name, the steps done, and the steps in all."""
    if quiet:
        yield lambda *_: None
    elif err.is_terminal and not err.is_dumb_terminal:
        with Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), console=err, transient=True
        ) as bars:
            task = bars.add_task("", total=None)
            yield lambda name, done, total: bars.update(task, description=name, completed=done, total=total)
    else:
        lines = Lines()
        yield lambda name, done, total: lines.print(f"{name}: {done} of {total}", even_if_fast=done == total)


class Lines:
    """Lines on stderr for a log: a burst at first, then one every few seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._filled = self._printed = clock()
        self._allowed = float(_LINES_AT_ONCE)

    @property
    def allowed(self) -> float:
        """Number of lines that may be printed now."""
        now = self._clock()
        self._allowed = min(float(_LINES_AT_ONCE), self._allowed + (now - self._filled) / _SECONDS_PER_LINE)
        self._filled = now
        return self._allowed

    @property
    def seconds_of_silence(self) -> float:
        """Seconds since the last line."""
        return self._clock() - self._printed

    def print(self, text: str, *, even_if_fast: bool = False) -> None:
        """Print a line, unless lines come too fast and `even_if_fast` is not set."""
        if self.allowed >= 1 or even_if_fast:
            self._allowed -= 1
            self._printed = self._clock()
            err.print(text, soft_wrap=True, markup=False)


class TrialLines:
    """One line per trial that ends, or for several that end too fast; one per minute while none ends."""

    def __init__(self, trials: Sequence["Trial"], clock: Callable[[], float] = time.monotonic) -> None:
        self._trials, self._clock, self._lines = trials, clock, Lines(clock)
        self._started = clock()
        self._complete_before: int | None = None
        self._reported: set[int] = set()

    def update(self, progress: "ProgressReader", outcomes: Mapping[int, Outcome]) -> None:
        """Print the outcomes not yet printed."""
        if self._complete_before is None:
            # Trials that were complete before this run have no progress.
            before = [i for i in outcomes if progress[i].status is TrialStatus.WAITING]
            self._complete_before = len(before)
            if before:
                self._print(before, "complete already")
        for i in [i for i in outcomes if i not in self._reported and outcomes[i].status is TrialStatus.FAILED]:
            self._print([i], f"{self._trials[i].label}: failed: {outcomes[i].message}")
        self._print_ended([i for i in outcomes if i not in self._reported], outcomes)
        if self._lines.seconds_of_silence >= _SECONDS_OF_SILENCE:
            self._print([], self._summary(progress, outcomes))

    def _print_ended(self, ended: Sequence[int], outcomes: Mapping[int, Outcome]) -> None:
        if not ended:
            return
        allowed = self._lines.allowed
        if len(ended) <= allowed:
            for i in ended:
                self._print([i], f"{self._trials[i].label}: {outcomes[i].status}")
        elif allowed >= 1 or len(outcomes) == len(self._trials):
            self._print(ended, "1 more is complete" if len(ended) == 1 else f"{len(ended)} more are complete")

    def _print(self, ended: Sequence[int], text: str) -> None:
        self._reported |= set(ended)
        self._lines.print(f"[{len(self._reported)}/{len(self._trials)}] {text}", even_if_fast=True)

    def _summary(self, progress: "ProgressReader", outcomes: Mapping[int, Outcome]) -> str:
        running = _running(self._trials, progress, outcomes)
        parts = _parts_done(progress, running)
        unfinished = len(self._trials) - len(outcomes)
        done = len(outcomes) - (self._complete_before or 0) + parts
        text = f"{len(running)} running, {unfinished - len(running)} waiting"
        if not done:
            return text
        return f"{text}; about {duration_text((self._clock() - self._started) * (unfinished - parts) / done)} left"


class TrialBars:
    """One bar for all trials, and one per running trial as far as the terminal has room."""

    def __init__(self, trials: Sequence["Trial"], bars: Progress) -> None:
        self._trials, self._bars = trials, bars
        self._tasks: dict[int, TaskID] = {}
        self._failures: set[int] = set()
        self._total = bars.add_task("[bold]all trials", total=len(trials), state="")

    def update(self, progress: "ProgressReader", outcomes: Mapping[int, Outcome]) -> None:
        """Move the bars and print new failures above them."""
        running = _running(self._trials, progress, outcomes)
        self._print_failures(outcomes)
        done = min(len(outcomes) + _parts_done(progress, running), len(self._trials))
        self._bars.update(self._total, completed=done, state=self._counts(outcomes, running))
        for i in [i for i in self._tasks if i not in running]:
            self._bars.remove_task(self._tasks.pop(i))
        for i in running:
            if i in self._tasks or len(self._tasks) < max(1, err.height - _LINES_BELOW_BARS):
                self._update_bar(i, progress)

    def _counts(self, outcomes: Mapping[int, Outcome], running: Sequence[int]) -> str:
        failed = f" [red]{len(self._failures)} failed[/]" if self._failures else ""
        more = f" {len(running)} running" if len(running) > len(self._tasks) else ""
        return f"{len(outcomes)}/{len(self._trials)}{more}{failed}"

    def _print_failures(self, outcomes: Mapping[int, Outcome]) -> None:
        for i, outcome in outcomes.items():
            if outcome.status is TrialStatus.FAILED and i not in self._failures:
                self._failures.add(i)
                text = f"[red]failed[/] {escape(self._trials[i].label)}: {escape(outcome.message)}"
                self._bars.console.print(text, soft_wrap=True)

    def _update_bar(self, i: int, progress: "ProgressReader") -> None:
        trial, step = self._trials[i], progress[i].step
        steps = step.steps or trial.settings.fit.steps
        if i not in self._tasks:
            self._tasks[i] = self._bars.add_task(escape(trial.label), total=steps, state="")
        fitting = f"{step.done}/{steps} {_stage_and_loss(trial, step)}" if step.done else "loading"
        if isinstance(trial.settings.fit, ExternalSettings):
            fitting = f"running {escape(trial.settings.fit.name)}" if step.steps else "loading"
        others = {TrialStatus.MEASURING: "measuring", TrialStatus.PREPARING: "making the control mesh"}
        state = others.get(progress[i].status, fitting)
        self._bars.update(self._tasks[i], completed=step.done, total=steps, state=state)


def _running(trials: Sequence["Trial"], progress: "ProgressReader", outcomes: Mapping[int, Outcome]) -> list[int]:
    return [i for i in range(len(trials)) if i not in outcomes and progress[i].status.is_running]


def _parts_done(progress: "ProgressReader", running: Sequence[int]) -> float:
    """Return the sum over running trials of the fraction of steps done."""
    return sum(progress[i].step.done / max(progress[i].step.steps, 1) for i in running)


def _stage_and_loss(trial: "Trial", step: Step) -> str:
    settings = trial.settings.fit
    if isinstance(settings, GaussNewtonSettings):
        return f"{stage_before_end(settings, step.steps - step.done).name}, distance {step.loss:.1e}"
    return f"loss {step.loss:.1e}"
