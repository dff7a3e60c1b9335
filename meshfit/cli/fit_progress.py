"""Progress of one fit on stderr: a bar on a terminal, a plain line now and then elsewhere."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import BarColumn, Progress, TextColumn

from meshfit.cli.console import err
from meshfit.cli.progress import Lines
from meshfit.experiment.trial_status import Outcome, TrialStatus
from meshfit.fitting.gauss_newton.schedule import stage_at
from meshfit.fitting.progress import Course
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.units import duration_text

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.running.backends import ProgressReader
    from meshfit.experiment.running.scheduler import Watcher

_SECONDS_BETWEEN_LINES = 5.0
_BAR = 24


@contextmanager
def show_fit(trial: "Trial", *, quiet: bool) -> Iterator["Watcher"]:
    """Show the progress of one fit within a `with` block."""
    if quiet:
        yield lambda *_: None
        return
    fit = _Fit(trial)
    if not err.is_terminal:
        lines = Lines()

        def print_line(progress: "ProgressReader", _: Mapping[int, Outcome]) -> None:
            text = fit.update(progress)
            if lines.seconds_of_silence >= _SECONDS_BETWEEN_LINES:
                lines.print(f"{100 * fit.share:.0f} %  {text}")

        yield print_line
        return
    columns = (
        TextColumn("fit"),
        BarColumn(bar_width=_BAR),
        TextColumn("{task.percentage:3.0f} %  {task.fields[state]}"),
    )
    with Progress(*columns, console=err, transient=True) as bars:
        task = bars.add_task("", total=1.0, state="loading")

        def move_bar(progress: "ProgressReader", _: Mapping[int, Outcome]) -> None:
            text = fit.update(progress)
            bars.update(task, completed=fit.share, state=text)

        yield move_bar


class _Fit:
    """The state of a fit in words; its steps are weighed by their cost."""

    def __init__(self, trial: "Trial") -> None:
        self._settings = trial.settings.fit
        self._course = Course(self._settings)

    @property
    def share(self) -> float:
        return self._course.share

    def update(self, progress: "ProgressReader") -> str:
        status, step, course = progress[0].status, progress[0].step, self._course
        if status is TrialStatus.MEASURING:
            return "measuring"
        if not step.done:
            return "loading"
        if course.step is None or course.step.done != step.done:
            course.update(step)
        words = [f"step {step.done:,} of {step.steps:,}"]
        if isinstance(self._settings, GaussNewtonSettings):
            words.insert(0, stage_at(self._settings, step.done).name.replace("last", "last steps"))
        left = course.seconds_left
        if left is not None and step.done < step.steps:
            words.append(f"about {duration_text(left)} left, then measuring")
        return ", ".join(words)
