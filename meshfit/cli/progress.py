"""Progress without a terminal: lines for a log, at a rate at which they can be read."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Column

from meshfit.cli.console import err
from meshfit.experiment.trial_status import Outcome, Phase
from meshfit.fitting.callbacks import Step
from meshfit.fitting.gauss_newton.schedule import stage_at
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.units import duration_text

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.running.backends import ProgressBoard


_AT_ONCE = 20
_SECONDS_PER_LINE = 5.0
_SECONDS_BETWEEN_SIGNS = 60.0


class PlainProgress:
    """A line for every trial that ends, or for several if they end faster than that; one a minute if none ends."""

    def __init__(self, trials: Sequence["Trial"], clock: Callable[[], float] = time.monotonic) -> None:
        self._trials, self._clock = trials, clock
        self._started = self._said = self._filled = clock()
        self._before: int | None = None
        self._told: set[int] = set()
        self._allowed = float(_AT_ONCE)

    def update(self, board: "ProgressBoard", outcomes: Mapping[int, Outcome]) -> None:
        """Say what is new."""
        now = self._clock()
        self._allowed = min(float(_AT_ONCE), self._allowed + (now - self._filled) / _SECONDS_PER_LINE)
        self._filled = now
        self._begin(outcomes, board)
        new = [i for i in outcomes if i not in self._told]
        for i in [i for i in new if outcomes[i].phase is Phase.FAILED]:
            self._tell([i], f"{self._trials[i].label}: failed: {outcomes[i].message}")
        self._tell_others([i for i in new if i not in self._told], outcomes)
        if now - self._said >= _SECONDS_BETWEEN_SIGNS:
            self._tell([], self._sign_of_life(board, outcomes, now))

    def _begin(self, outcomes: Mapping[int, Outcome], board: "ProgressBoard") -> None:
        """What was complete before this run began has not been posted to its board."""
        if self._before is None:
            early = [i for i in outcomes if board.phase(i) is Phase.WAITING]
            self._before = len(early)
            if early:
                self._tell(early, "complete already")

    def _tell_others(self, ended: Sequence[int], outcomes: Mapping[int, Outcome]) -> None:
        if len(ended) <= self._allowed:
            for i in ended:
                self._tell([i], f"{self._trials[i].label}: {outcomes[i].phase.name.lower()}")
        elif self._allowed >= 1 or len(outcomes) == len(self._trials):
            self._tell(ended, f"{len(ended)} more are complete")

    def _tell(self, ended: Sequence[int], text: str) -> None:
        self._told |= set(ended)
        self._allowed -= 1
        self._said = self._clock()
        err.print(f"[{len(self._told)}/{len(self._trials)}] {text}", soft_wrap=True, markup=False)

    def _sign_of_life(self, board: "ProgressBoard", outcomes: Mapping[int, Outcome], now: float) -> str:
        waiting = [i for i in range(len(self._trials)) if i not in outcomes]
        running = [i for i in waiting if board.phase(i) in (Phase.FITTING, Phase.MEASURING)]
        parts = sum(board.step(i).done / max(self._trials[i].settings.fit.steps, 1) for i in running)
        done = len(outcomes) - (self._before or 0) + parts
        left = (now - self._started) * (len(waiting) - parts) / done if done else None
        text = f"{len(running)} running, {len(waiting) - len(running)} waiting"
        return text if left is None else f"{text}; about {duration_text(left)} left"


Watch = Callable[["ProgressBoard", Mapping[int, Outcome]], None]

_RUNNING = (Phase.FITTING, Phase.MEASURING)
_LINES_FOR_OTHERS = 4


@contextmanager
def show_progress(trials: Sequence["Trial"], *, quiet: bool) -> Iterator[Watch]:
    """What `run_trials` calls to show where trials are."""
    if quiet:
        yield lambda *_: None
    elif err.is_terminal:
        with _bars() as bars:
            yield BarProgress(trials, bars).update
    else:
        yield PlainProgress(trials).update


def _bars() -> Progress:
    return Progress(
        TextColumn("{task.description}", table_column=Column(no_wrap=True, ratio=1)),
        BarColumn(bar_width=10),
        TextColumn("{task.fields[state]}", table_column=Column(no_wrap=True)),
        TextColumn("ETA"),
        TimeRemainingColumn(compact=True, elapsed_when_finished=False),
        console=err,
        transient=True,
        expand=True,
    )


class BarProgress:
    """Bars on a terminal; those of trials that have ended make room for others, as far as there is room."""

    def __init__(self, trials: Sequence["Trial"], bars: Progress) -> None:
        self._trials, self._bars = trials, bars
        self._tasks: dict[int, TaskID] = {}
        self._failures: set[int] = set()
        self._total = bars.add_task("[bold]all trials", total=len(trials), state="")

    def update(self, board: "ProgressBoard", outcomes: Mapping[int, Outcome]) -> None:
        """Move the bars and print new failures above them."""
        running = [i for i in range(len(self._trials)) if i not in outcomes and board.phase(i) in _RUNNING]
        self._tell_failures(outcomes)
        parts = sum(board.step(i).done / max(self._trials[i].settings.fit.steps, 1) for i in running)
        done = min(len(outcomes) + parts, len(self._trials))
        self._bars.update(self._total, completed=done, state=self._counts(outcomes, running))
        for i in [i for i in self._tasks if i not in running]:
            self._bars.remove_task(self._tasks.pop(i))
        for i in running:
            if i in self._tasks or len(self._tasks) < max(1, err.height - _LINES_FOR_OTHERS):
                self._show(i, self._trials[i], board, board.phase(i))

    def _counts(self, outcomes: Mapping[int, Outcome], running: Sequence[int]) -> str:
        failed = f" [red]{len(self._failures)} failed[/]" if self._failures else ""
        hidden = len(running) - len(self._tasks)
        more = f" {len(running)} running" if hidden > 0 else ""
        return f"{len(outcomes)}/{len(self._trials)}{more}{failed}"

    def _tell_failures(self, outcomes: Mapping[int, Outcome]) -> None:
        for i, outcome in outcomes.items():
            if outcome.phase is Phase.FAILED and i not in self._failures:
                self._failures.add(i)
                text = f"[red]failed[/] {escape(self._trials[i].label)}: {escape(outcome.message)}"
                self._bars.console.print(text, soft_wrap=True)

    def _show(self, i: int, trial: "Trial", board: "ProgressBoard", phase: Phase) -> None:
        steps = trial.settings.fit.steps
        if i not in self._tasks:
            self._tasks[i] = self._bars.add_task(escape(trial.label), total=steps, state="")
        step = board.step(i)
        fitting = f"{step.done}/{steps} {_figure(trial, step)}" if step.done else "loading"
        state = "measuring" if phase is Phase.MEASURING else fitting
        self._bars.update(self._tasks[i], completed=step.done, state=state)


def _figure(trial: "Trial", step: Step) -> str:
    """The figure that falls, and where it has several stages, the one that a trial is in."""
    settings = trial.settings.fit
    if isinstance(settings, GaussNewtonSettings):
        return f"{stage_at(settings, step.done).name}, distance {step.loss:.1e}"
    return f"loss {step.loss:.1e}"
