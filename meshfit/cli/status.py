"""`meshfit status`: status of experiments and their remaining time."""

import json
import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from meshfit.cli.console import out
from meshfit.cli.options import AsJson, takes_run_dirs
from meshfit.experiment.status.eta import seconds_left
from meshfit.experiment.status.scan import ScannedExperiment, ScannedTrial, scan_experiments
from meshfit.experiment.storage.failure import read_failure
from meshfit.experiment.storage.run_directory import RESULT, damage
from meshfit.experiment.storage.trial_log import LastProgress, read_progress
from meshfit.experiment.trial_status import TrialStatus
from meshfit.units import duration_text

MOST_LISTED = 20
STYLES = {
    TrialStatus.COMPLETE: "green",
    TrialStatus.RUNNING: "cyan",
    TrialStatus.FAILED: "red",
    TrialStatus.DAMAGED: "red",
    TrialStatus.INTERRUPTED: "magenta",
    TrialStatus.WAITING: "",
}
_HOST_WIDTH = 12
_LABEL_WIDTH = len("  no sign of life for 59 min")


@takes_run_dirs
def status(
    runs: list[Path],
    list_all: Annotated[
        bool, typer.Option("--all", help=f"List all running and failed trials, not only {MOST_LISTED} of a kind.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Show experiment status and time remaining.

    Trials are complete, running, failed, damaged, interrupted or waiting. Only the run directory is read, which is safe
    while trials run. An interrupted trial was started and has not ended, and a damaged one has a result that cannot be
    read: rerun the same command to resume or repeat it.

    Examples:
        meshfit status
        meshfit status runs/table1 --all
        meshfit status --runs elsewhere
        watch -n 5 meshfit status  # refreshed every 5 seconds
    """
    now = datetime.now(UTC)
    experiments = scan_experiments(runs, now)
    if as_json:
        typer.echo(json.dumps([_plain_experiment(experiment) for experiment in experiments], indent=2))
        return 0
    most = None if list_all else MOST_LISTED
    width = max(len(experiment.name) for experiment in experiments)
    for experiment in experiments:
        details = [*_running(experiment, now, most), *_failed(experiment, most), *_damaged(experiment, most)]
        for line in (_summary(experiment, width), *details):
            out.print(line, soft_wrap=isinstance(line, Text))
        if details and experiment is not experiments[-1]:
            out.print()
    return 0


def _summary(experiment: ScannedExperiment, width: int) -> Text:
    """Line with the counts of trials, and the time left unless all have ended."""
    counts = [Text(f"{count:,} {status}", STYLES[status]) for status, count in experiment.counts.items() if count]
    line = Text.assemble((experiment.name.ljust(width), "bold"), "  ", Text(" · ").join(counts))
    seconds = seconds_left(experiment)
    if seconds != 0:
        left = "time left unknown" if seconds is None else f"about {duration_text(seconds)} left"
        left = left if experiment.counts[TrialStatus.RUNNING] else f"stopped, {left}"
        fits = line.cell_len + 2 + len(left) <= out.width
        line.append(f"  {left}" if fits else f"\n{' ' * width}  {left}", "bold")
    return line


def _running(experiment: ScannedExperiment, now: datetime, most: int | None) -> Iterator[RenderableType]:
    """Table of running trials."""
    running = experiment.of(TrialStatus.RUNNING)
    if not running:
        return
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(overflow="fold", min_width=_LABEL_WIDTH)
    for _ in range(3):
        table.add_column(justify="right", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row(*(Text(heading, "bold") for heading in ("running", "step", "loss", "for", "where")))
    for trial in running[:most]:
        progress = read_progress(trial.path)
        table.add_row(Text(trial.label, "cyan"), *_progress_cells(progress, now))
        if progress is not None and progress.is_stale(now):
            table.add_row(Text(f"  no sign of life for {duration_text(progress.age_seconds(now))}", "bold magenta"))
    yield Padding(table, (0, 0, 0, 2))
    yield from _more(len(running), most)


def _progress_cells(progress: LastProgress | None, now: datetime) -> Sequence[Text]:
    if progress is None:
        return [Text("starting")]
    step = progress.step
    activity = f"{step.done:,}/{step.steps:,}" if progress.status is TrialStatus.FITTING else progress.status.value
    loss = f"{step.loss:.3g}" if math.isfinite(step.loss) else ""
    host = progress.host.partition(".")[0]
    host = host if len(host) <= _HOST_WIDTH else f"{host[: _HOST_WIDTH - 1]}…"
    running_for = duration_text((now - progress.started).total_seconds())
    return [Text(activity), Text(loss), Text(running_for), Text(f"{host}:{progress.pid}")]


def _failed(experiment: ScannedExperiment, most: int | None) -> Iterator[RenderableType]:
    """Failed trials by kind of failure, each message printed once."""
    for kind, failures in experiment.failures_by_kind().items():
        yield Text.assemble("  ", (f"failed: {kind}", "bold red"), f" ({len(failures):,})")
        message = ""
        for trial, failure in sorted(failures[:most], key=lambda pair: pair[1].message):
            if failure.message != message:
                message = failure.message
                yield Padding(Text(message), (0, 0, 0, 4))
            step = "" if failure.step is None else f", step {failure.step:,}"
            yield Text.assemble("      ", (trial.label, "red"), step)
            yield Text(f"        {failure.path}")
        yield from _more(len(failures), most)


def _damaged(experiment: ScannedExperiment, most: int | None) -> Iterator[RenderableType]:
    """Trials whose result is damaged, each with the damage."""
    damaged = experiment.of(TrialStatus.DAMAGED)
    if damaged:
        yield Text.assemble("  ", ("damaged", "bold red"), f" ({len(damaged):,})")
        yield Padding(Text("the next `meshfit run` repeats them"), (0, 0, 0, 4))
        for trial in damaged[:most]:
            yield Text.assemble("      ", (trial.label, "red"))
            yield Text(f"        {damage(trial.path / RESULT) or 'complete by now'}")
        yield from _more(len(damaged), most)


def _more(count: int, most: int | None) -> Iterator[Text]:
    if most is not None and count > most:
        yield Text(f"  and {count - most:,} more; --all lists them")


def _plain_experiment(experiment: ScannedExperiment) -> dict[str, object]:
    return {
        "experiment": experiment.name,
        "folder": str(experiment.folder),
        "workers": experiment.plan.workers if experiment.plan else None,
        "counts": {status.value: count for status, count in experiment.counts.items()},
        "seconds_left": seconds_left(experiment),
        "trials": [_plain_trial(trial) for trial in experiment.trials],
    }


def _plain_trial(trial: ScannedTrial) -> dict[str, object]:
    plain: dict[str, object] = {"folder": str(trial.path), "identity": trial.identity, "state": trial.status.value}
    plain |= {"target": trial.target, "scheme": trial.scheme, "seed": trial.seed, "variant": trial.variant}
    if trial.status is TrialStatus.RUNNING:
        progress = read_progress(trial.path)
        plain["progress"] = progress.to_dict() if progress else None
    elif trial.status is TrialStatus.FAILED:
        failure = read_failure(trial.path)
        plain["failure"] = {
            "kind": failure.kind,
            "message": failure.message,
            "step": failure.step,
            "see": str(failure.path),
        }
    elif trial.status is TrialStatus.DAMAGED:
        plain["damage"] = damage(trial.path / RESULT)
    return plain
