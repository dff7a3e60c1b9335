"""Progress of one fit on stderr: a bar on a terminal, a plain line now and then elsewhere."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Column

from meshfit.cli.console import err
from meshfit.cli.progress import Lines
from meshfit.experiment.input_checks import checked_target
from meshfit.experiment.source import expected_verts
from meshfit.experiment.trial_status import Outcome, TrialStatus
from meshfit.fitting.gauss_newton.schedule import stage_before_end
from meshfit.fitting.progress import Course, measuring_cost
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.units import duration_text

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.running.backends import ProgressReader
    from meshfit.experiment.running.scheduler import Watcher

_SECONDS_BETWEEN_LINES = 5.0
_BAR, _NARROW_BAR, _WIDE = 24, 5, 90
# Samples on each surface that the cost of measuring is known for.
_SAMPLES = 200_000


@contextmanager
def show_fit(trial: "Trial", *, quiet: bool) -> Iterator["Watcher"]:
    """Show the progress of one fit within a `with` block."""
    if quiet:
        yield lambda *_: None
        return
    fit = FitProgress(trial)
    if not err.is_terminal or err.is_dumb_terminal:
        lines = Lines()

        def print_line(progress: "ProgressReader", _: Mapping[int, Outcome]) -> None:
            text = fit.update(progress)
            if lines.seconds_of_silence >= _SECONDS_BETWEEN_LINES:
                lines.print(f"{100 * fit.share:.0f} %  {text}")

        yield print_line
        return
    columns = (
        TextColumn("fit"),
        BarColumn(bar_width=_BAR if err.width >= _WIDE else _NARROW_BAR),
        TextColumn("{task.percentage:3.0f} %  {task.fields[state]}", table_column=Column(no_wrap=True)),
    )
    with Progress(*columns, console=err, transient=True) as bars:
        task = bars.add_task("", total=1.0, state="loading")

        def move_bar(progress: "ProgressReader", _: Mapping[int, Outcome]) -> None:
            text = fit.update(progress)
            bars.update(task, completed=fit.share, state=text)

        yield move_bar


class FitProgress:
    """The state of a fit in words; its steps, and measuring after them, are weighed by their cost."""

    def __init__(self, trial: "Trial", clock: Callable[[], float] = time.monotonic) -> None:
        settings, scheme = trial.settings, trial.named_scheme.resolve()
        self._settings = settings.fit
        faces = checked_target(trial.target, settings.cleaning).faces
        self._after = measuring_cost(self._settings, faces) * settings.measure.samples / _SAMPLES
        source_verts = expected_verts(settings.source, scheme)
        self._clock, self._preparing_since = clock, -1.0
        self._course = Course(self._settings, source_verts=source_verts, scheme=scheme, after=self._after)

    @property
    def share(self) -> float:
        """Share of the work that is done."""
        return self._course.share

    def update(self, progress: "ProgressReader") -> str:
        """Return the present phase in words."""
        status, step, course = progress[0].status, progress[0].step, self._course
        if status is TrialStatus.PREPARING:
            if self._preparing_since < 0:
                self._preparing_since = self._clock()
            return f"making the control mesh, {duration_text(self._clock() - self._preparing_since)}"
        if status is not TrialStatus.MEASURING and not step.done:
            if course.step is not None:
                return "writing"
            return "loading" if self._preparing_since < 0 else "starting the fit"
        if step.done and (course.step is None or course.step.done != step.done):
            course.update(step)
        left = course.seconds_left
        if status is TrialStatus.MEASURING:
            return "measuring" + (f", about {duration_text(left)} left" if left else "")
        words = [f"step {step.done:,} of {step.steps:,}"]
        if isinstance(self._settings, GaussNewtonSettings):
            name = stage_before_end(self._settings, step.steps - step.done).name
            words.insert(0, name.replace("last", "last steps"))
        if left:
            words.insert(0, f"about {duration_text(left)} left")
        return ", ".join(words)
