"""Progress of an experiment: a bar for each running trial and one for all, or plain lines without a terminal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Column

from meshfit.cli.console import err
from meshfit.experiment.crews import ProgressBoard
from meshfit.experiment.progress import Outcome, Phase
from meshfit.fitting.gauss_newton.stages import stage_at
from meshfit.fitting.progress import Step
from meshfit.fitting.settings import GaussNewtonSettings

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

Watch = Callable[[ProgressBoard, Mapping[int, Outcome]], None]


@contextmanager
def shown_progress(trials: Sequence["Trial"], *, quiet: bool) -> Iterator[Watch]:
    """What `run_trials` calls to show where trials are."""
    if quiet:
        yield lambda *_: None
    elif err.is_terminal:
        with _bars() as bars:
            yield _Bars(trials, bars).update
    else:
        yield _Lines(trials).update


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
    """Bars on a terminal; those of trials that have ended make room for others."""

    def __init__(self, trials: Sequence["Trial"], bars: Progress) -> None:
        self._trials, self._bars = trials, bars
        self._tasks: dict[int, TaskID] = {}
        self._total = bars.add_task("[bold]all trials", total=len(trials), state="")

    def update(self, board: ProgressBoard, outcomes: Mapping[int, Outcome]) -> None:
        failed = sum(outcome.phase is Phase.FAILED for outcome in outcomes.values())
        state = f"{len(outcomes)}/{len(self._trials)}" + (f" [red]{failed} failed[/]" if failed else "")
        parts = sum(board.step(i).done / max(self._trials[i].settings.fit.steps, 1) for i in self._tasks)
        self._bars.update(self._total, completed=min(len(outcomes) + parts, len(self._trials)), state=state)
        for i, trial in enumerate(self._trials):
            phase = Phase.COMPLETE if i in outcomes else board.phase(i)
            if phase in (Phase.FITTING, Phase.MEASURING):
                self._show(i, trial, board, phase)
            elif i in self._tasks:
                self._bars.remove_task(self._tasks.pop(i))

    def _show(self, i: int, trial: "Trial", board: ProgressBoard, phase: Phase) -> None:
        steps = trial.settings.fit.steps
        if i not in self._tasks:
            self._tasks[i] = self._bars.add_task(trial.label, total=steps, state="")
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


class _Lines:
    """A line for every trial that ends, for logs."""

    def __init__(self, trials: Sequence["Trial"]) -> None:
        self._trials = trials
        self._told: set[int] = set()

    def update(self, board: ProgressBoard, outcomes: Mapping[int, Outcome]) -> None:  # noqa: ARG002  as `_Bars` has it
        for i in sorted(set(outcomes) - self._told):
            self._told.add(i)
            outcome = outcomes[i]
            said = f": {outcome.message}" if outcome.message else ""
            line = (
                f"[{len(self._told)}/{len(self._trials)}] {self._trials[i].label}: {outcome.phase.name.lower()}{said}"
            )
            err.print(line, soft_wrap=True, markup=False)
