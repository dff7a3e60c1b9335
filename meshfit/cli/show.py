"""One trial, in the words and the lines of `meshfit show`, and as plain data."""

import json
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Annotated

import typer
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from meshfit.cli.console import out
from meshfit.cli.options import DEFAULT_RUNS, AsJson, Runs, TrialName
from meshfit.cli.status import STYLES
from meshfit.config.experiment import non_default_settings
from meshfit.config.strict_yaml import dump
from meshfit.experiment.status.cleaning import is_half_written
from meshfit.experiment.status.scan import ScannedExperiment, ScannedTrial
from meshfit.experiment.storage.checkpoint import SNAPSHOTS, snapshots_in
from meshfit.experiment.storage.failure import Failure, read_failure
from meshfit.experiment.storage.result import end_time, read_result, read_settings
from meshfit.experiment.storage.run_directory import LOCK, Result
from meshfit.experiment.storage.trial_log import read_progress
from meshfit.experiment.trial_status import TrialStatus
from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.grouping import flatten
from meshfit.units import size_text

_FILES = {
    "result.json": "every figure; written last",
    "failure.json": "why it failed",
    "trial.log": "what was said while it ran",
    "config.yaml": "every setting",
    "trace.csv": "every loss term by step",
    "source.ply": "the source, refined and placed",
    "result.ply": "the result",
    "control.ply": "the control mesh of the result",
    "last_good.ply": "the mesh before it diverged",
    "checkpoint.pt": "where it goes on when it is run again",
    "progress.json": "its last sign of life",
}
_UNFINISHED = "half written, when its process was killed"


def print_trial(experiment: ScannedExperiment, trial: ScannedTrial, *, every: bool) -> None:
    """Print all that is known of a trial; of its settings those that are not at their defaults, or every one."""
    result = read_result(trial.path)
    settings = read_settings(trial.path, result)
    out.print(Text.assemble((trial.label, "bold"), "  ", (trial.status.value, f"bold {STYLES[trial.status]}".strip())))
    out.print(_grid(_facts(experiment, trial, result)))
    if trial.status is TrialStatus.FAILED:
        _print_failure(read_failure(trial.path))
    if result is not None:
        _heading("metrics")
        out.print(_metrics(result))
    if settings:
        _heading("settings" if every else "settings that are not at their defaults; --all shows every one")
        text = dump(settings if every else non_default_settings(settings))
        out.print(Padding(Text(text.rstrip()), (0, 0, 0, 2)))
    if files := _files(trial):
        _heading("files")
        out.print(_file_grid(files))


def plain_trial(experiment: ScannedExperiment, trial: ScannedTrial) -> dict[str, object]:
    """All that is known of a trial as plain data, fit for JSON."""
    result = read_result(trial.path)
    when, progress = end_time(trial.path), read_progress(trial.path)
    return {
        "experiment": experiment.name,
        "target": trial.target,
        "scheme": trial.scheme,
        "seed": trial.seed,
        "variant": trial.variant,
        "identity": _identity(trial, result),
        "folder": str(trial.path),
        "state": trial.status.value,
        "ended": when.isoformat() if when else None,
        "progress": progress.to_dict() if progress else None,
        "failure": read_failure(trial.path).record if trial.status is TrialStatus.FAILED else None,
        "settings": read_settings(trial.path, result),
        "result": result,
        "files": [{"name": name, "bytes": count, "what": what} for name, count, what in _files(trial)],
    }


def _identity(trial: ScannedTrial, result: Result | None) -> str:
    return str(result["identity"]) if result and "identity" in result else trial.identity


def _facts(experiment: ScannedExperiment, trial: ScannedTrial, result: Result | None) -> Iterator[tuple[str, str]]:
    yield "experiment", experiment.name
    yield "identity", _identity(trial, result)
    yield "folder", str(trial.path)
    if when := end_time(trial.path):
        yield "ended", f"{when:%Y-%m-%d %H:%M} UTC"
    if progress := read_progress(trial.path):
        yield "started", f"{progress.started:%Y-%m-%d %H:%M} UTC"
        yield "at", f"{progress.status}, step {progress.step.done:,} of {progress.step.steps:,}"
        yield "runs on" if trial.status is TrialStatus.RUNNING else "ran on", f"{progress.host}, process {progress.pid}"
    if result is not None:
        yield from _work(result)


def _work(result: Result) -> Iterator[tuple[str, str]]:
    machine, versions = result.get("platform", {}), result.get("versions", {})
    device = result.get("fit", {}).get("device")
    where = [str(machine.get("system", "")), f"device {device}" if device else ""]
    where += [f"{name} {versions[name]}" for name in ("meshfit", "torch", "python") if name in versions]
    yield "ran on", ", ".join(filter(None, where))
    if seconds := result.get("seconds"):
        yield "seconds", ", ".join(f"{name} {value:.3g}" for name, value in seconds.items())
    if memory := result.get("peak_memory_mb"):
        yield "memory", size_text(memory * 1e6)
    for text in result.get("warnings", ()):
        yield "warning", str(text)


def _print_failure(failure: Failure) -> None:
    _heading("failure")
    step = "" if failure.step is None else f", at step {failure.step:,}"
    out.print(Padding(Text.assemble((failure.kind, "bold red"), step), (0, 0, 0, 2)))
    out.print(Padding(Text(failure.message), (0, 0, 0, 2)))
    out.print(Text(f"  see {failure.path}"), soft_wrap=True)


def _metrics(result: Result) -> Padding:
    found = flatten({key: value for key, value in result.items() if isinstance(value, Mapping) and key != "settings"})
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column()
    grid.add_column(justify="right", style="bold")
    for name, metric in METRICS.items():
        if (value := found.get(name)) is not None:
            grid.add_row(metric.title, str(value) if isinstance(value, bool) else format(value, metric.format))
    return Padding(grid, (0, 0, 0, 2))


def _files(trial: ScannedTrial) -> list[tuple[str, int, str]]:
    """Name, bytes and meaning of each file, in the order of `_FILES`."""
    found = [name for name in trial.folder.files if name != LOCK and (trial.path / name).is_file()]
    places = list(_FILES)
    ordered = sorted(found, key=lambda name: (places.index(name) if name in _FILES else len(places), name))
    listed = [(name, (trial.path / name).stat().st_size, _meaning(name)) for name in ordered]
    return [*listed, *_snapshots(trial)]


def _snapshots(trial: ScannedTrial) -> Iterator[tuple[str, int, str]]:
    """The folder of snapshots as one entry."""
    if found := snapshots_in(trial.path):
        steps = list(found)
        count = f"{len(found):,} meshes" if len(found) > 1 else "a mesh"
        yield (
            f"{SNAPSHOTS}/",
            sum(path.stat().st_size for path in found.values()),
            f"{count}, steps {steps[0]} to {steps[-1]}",
        )


def _meaning(name: str) -> str:
    return _FILES.get(name, _UNFINISHED if is_half_written(name) else "")


def _file_grid(files: list[tuple[str, int, str]]) -> Padding:
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column()
    grid.add_column(justify="right")
    grid.add_column()
    for name, count, what in files:
        grid.add_row(Text(name), size_text(count), what)
    return Padding(grid, (0, 0, 0, 2))


def _grid(facts: Iterator[tuple[str, str]]) -> Table:
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(style="bold")
    grid.add_column(overflow="fold")
    for name, text in facts:
        grid.add_row(name, Text(text))
    return grid


def _heading(text: str) -> None:
    out.print(Text(f"\n{text}", "bold"))


def show(
    trial: TrialName,
    runs: Runs = DEFAULT_RUNS,
    every: Annotated[bool, typer.Option("--all", help="Every setting, not only those not at their defaults.")] = False,
    as_json: AsJson = False,
) -> int:
    """Show one trial: state, figures, settings, files, why it failed.

    Examples:
        meshfit show runs/table1/bunny/loop/seed-0-*

        meshfit show 3f9a  # the trial whose identity begins so

        meshfit show 3f9a --all --runs elsewhere
    """
    from meshfit.experiment.status.scan import find_trial

    now = datetime.now(UTC)
    experiment, found = find_trial(trial, runs, now)
    if as_json:
        typer.echo(json.dumps(plain_trial(experiment, found), indent=2))
    else:
        print_trial(experiment, found, every=every)
    return 0
