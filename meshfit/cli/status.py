"""How experiments stand, in the words and the lines of `meshfit status`, and as plain data."""

import json
import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Annotated

import typer
from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from meshfit.cli.console import out
from meshfit.cli.options import DEFAULT_RUNS, AsJson, OptionalRunDirs
from meshfit.experiment.status.eta import seconds_left
from meshfit.experiment.status.scan import ScannedExperiment, ScannedTrial
from meshfit.experiment.storage.failure import Failure, read_failure
from meshfit.experiment.storage.trial_log import LastProgress, read_progress
from meshfit.experiment.trial_status import TrialStatus
from meshfit.units import duration_text

_MOST_OF_HOST = 12
_LEAST_OF_LABEL = len("  no sign of life for 59 min")
STYLES = {
    TrialStatus.COMPLETE: "green",
    TrialStatus.RUNNING: "cyan",
    TrialStatus.FAILED: "red",
    TrialStatus.INTERRUPTED: "magenta",
    TrialStatus.WAITING: "",
}


def print_overview(experiments: Sequence[ScannedExperiment], now: datetime, most: int | None) -> None:
    """Print a line for each experiment, and below it what runs and what failed.

    Args:
        experiments: what to print.
        now: the time, by which the age of a sign of life is told.
        most: how many trials to list at most that run, or that failed in one way; None for all.
    """
    width = max(len(experiment.name) for experiment in experiments)
    for place, experiment in enumerate(experiments):
        details = [*_running(experiment, now, most), *_failed(experiment, most)]
        for line in (_summary(experiment, width), *details):
            out.print(line, soft_wrap=isinstance(line, Text))
        if details and place < len(experiments) - 1:
            out.print()


def _summary(experiment: ScannedExperiment, width: int) -> Text:
    counts = [Text(f"{count:,} {state}", STYLES[state]) for state, count in experiment.counts.items() if count]
    line = Text.assemble((experiment.name.ljust(width), "bold"), "  ", Text(" · ").join(counts))
    if left := _time_left(experiment):
        fits = line.cell_len + 2 + len(left) <= out.width
        line.append(f"  {left}" if fits else f"\n{' ' * width}  {left}", "bold")
    return line


def _time_left(experiment: ScannedExperiment) -> str:
    seconds = seconds_left(experiment)
    if seconds == 0:
        return ""
    left = "time left unknown" if seconds is None else f"about {duration_text(seconds)} left"
    return left if experiment.counts[TrialStatus.RUNNING] else f"stopped, {left}"


def _running(experiment: ScannedExperiment, now: datetime, most: int | None) -> Iterator[RenderableType]:
    running = experiment.of(TrialStatus.RUNNING)
    if not running:
        return
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(overflow="fold", min_width=_LEAST_OF_LABEL)
    for _ in range(3):
        grid.add_column(justify="right", no_wrap=True)
    grid.add_column(overflow="fold")
    grid.add_row(*(Text(heading, "bold") for heading in ("running", "step", "loss", "for", "where")))
    for trial in running[:most]:
        progress = read_progress(trial.path)
        grid.add_row(Text(trial.label, "cyan"), *_last_said(progress, now))
        if progress is not None and progress.is_stale(now):
            grid.add_row(Text(f"  no sign of life for {duration_text(progress.age_seconds(now))}", "bold magenta"))
    yield Padding(grid, (0, 0, 0, 2))
    yield from _more(len(running), most)


def _last_said(progress: LastProgress | None, now: datetime) -> Sequence[Text]:
    if progress is None:
        return [Text("starting")]
    step = progress.step
    activity = f"{step.done:,}/{step.steps:,}" if progress.status is TrialStatus.FITTING else progress.status.value
    loss = f"{step.loss:.3g}" if math.isfinite(step.loss) else ""
    host = progress.host.partition(".")[0]
    host = host if len(host) <= _MOST_OF_HOST else f"{host[: _MOST_OF_HOST - 1]}…"
    return [
        Text(activity),
        Text(loss),
        Text(duration_text((now - progress.started).total_seconds())),
        Text(f"{host}:{progress.pid}"),
    ]


def _failed(experiment: ScannedExperiment, most: int | None) -> Iterator[RenderableType]:
    for kind, failures in experiment.failures_by_kind().items():
        yield Text.assemble("  ", (f"failed: {kind}", "bold red"), f" ({len(failures):,})")
        said = ""
        # Those that failed in the same words below each other, so that the words stand there once.
        for trial, failure in sorted(failures[:most], key=lambda found: found[1].message):
            if failure.message != said:
                said = failure.message
                yield Padding(Text(said), (0, 0, 0, 4))
            step = "" if failure.step is None else f", step {failure.step:,}"
            yield Text.assemble("      ", (trial.label, "red"), step)
            yield Text(f"        {failure.path}")
        yield from _more(len(failures), most)


def _more(count: int, most: int | None) -> Iterator[Text]:
    if most is not None and count > most:
        yield Text(f"  and {count - most:,} more; --all lists them")


def plain_overview(experiment: ScannedExperiment) -> dict[str, object]:
    """An experiment and its trials as plain data, fit for JSON."""
    return {
        "experiment": experiment.name,
        "folder": str(experiment.folder),
        "workers": experiment.plan.workers if experiment.plan else None,
        "counts": {state.value: count for state, count in experiment.counts.items()},
        "seconds_left": seconds_left(experiment),
        "trials": [_plain_trial(trial) for trial in experiment.trials],
    }


def _plain_trial(trial: ScannedTrial) -> dict[str, object]:
    facts: dict[str, object] = {"folder": str(trial.path), "identity": trial.identity, "state": trial.status.value}
    facts |= {"target": trial.target, "scheme": trial.scheme, "seed": trial.seed, "variant": trial.variant}
    if trial.status is TrialStatus.RUNNING:
        progress = read_progress(trial.path)
        return facts | {"progress": progress.to_dict() if progress else None}
    if trial.status is TrialStatus.FAILED:
        return facts | {"failure": _plain_failure(read_failure(trial.path))}
    return facts


def _plain_failure(failure: Failure) -> dict[str, object]:
    return {"kind": failure.kind, "message": failure.message, "step": failure.step, "see": str(failure.path)}


MOST_LISTED = 20


def status(
    runs: OptionalRunDirs = None,
    every: Annotated[
        bool, typer.Option("--all", help=f"List all that run and all that failed, not just {MOST_LISTED} of a kind.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Say how experiments stand, and about how long is left.

    It tells what is complete, running, failed, interrupted or waiting. It reads the run directory alone, at any
    time, while others write there. Interrupted trials are those that were begun and have not ended: the command that
    ran them goes on with them.

    Examples:
        meshfit status

        meshfit status runs/table1 --all

        watch -n 5 meshfit status  # again every 5 seconds
    """
    from meshfit.experiment.status.scan import scan_experiments

    now = datetime.now(UTC)
    found = scan_experiments(runs or [DEFAULT_RUNS], now)
    if as_json:
        typer.echo(json.dumps([plain_overview(experiment) for experiment in found], indent=2))
    else:
        print_overview(found, now, None if every else MOST_LISTED)
    return 0
