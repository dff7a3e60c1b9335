"""Progress of an experiment: a bar for each running trial and one for all, or plain lines without a terminal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Column

from meshfit.cli.console import err
from meshfit.cli.progress_lines import Lines
from meshfit.experiment.progress import Outcome, Phase
from meshfit.fitting.gauss_newton.stages import stage_at
from meshfit.fitting.progress import Step
from meshfit.fitting.settings import GaussNewtonSettings

if TYPE_CHECKING:
    from meshfit.experiment.crews import ProgressBoard
    from meshfit.experiment.plan import Trial

Watch = Callable[["ProgressBoard", Mapping[int, Outcome]], None]

_RUNNING = (Phase.FITTING, Phase.MEASURING)
_LINES_FOR_OTHERS = 4


@contextmanager
def shown_progress(trials: Sequence["Trial"], *, quiet: bool) -> Iterator[Watch]:
    """What `run_trials` calls to show where trials are."""
    if quiet:
        yield lambda *_: None
    elif err.is_terminal:
        with _bars() as bars:
            yield _Bars(trials, bars).update
    else:
        yield Lines(trials).update


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


class _Bars:
    """Bars on a terminal; those of trials that have ended make room for others, as far as there is room."""

    def __init__(self, trials: Sequence["Trial"], bars: Progress) -> None:
        self._trials, self._bars = trials, bars
        self._tasks: dict[int, TaskID] = {}
        self._failures: set[int] = set()
        self._total = bars.add_task("[bold]all trials", total=len(trials), state="")

    def update(self, board: "ProgressBoard", outcomes: Mapping[int, Outcome]) -> None:
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
