"""`meshfit show`: everything that is known about one trial."""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from meshfit.cli.console import out, print_warning
from meshfit.cli.options import DEFAULT_RUNS, AsJson, Runs, TrialName
from meshfit.cli.status import STYLES
from meshfit.config.experiment import non_default_settings
from meshfit.config.strict_yaml import dump
from meshfit.errors import ConfigError, StoreError
from meshfit.experiment.status.scan import ScannedExperiment, ScannedTrial, find_trial
from meshfit.experiment.storage.checkpoint import SNAPSHOTS, snapshots_in
from meshfit.experiment.storage.failure import Failure, read_failure
from meshfit.experiment.storage.frame import written_frame
from meshfit.experiment.storage.measurement import AGAIN
from meshfit.experiment.storage.result import end_time, read_result_or_warn, read_settings
from meshfit.experiment.storage.run_directory import LOCK, Result, is_half_written
from meshfit.experiment.storage.targets import find_carried
from meshfit.experiment.storage.trial_log import read_progress
from meshfit.experiment.trial_status import TrialStatus
from meshfit.images.folders import IMAGE_REFERENCES, PACK_SUFFIX
from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.grouping import flatten
from meshfit.report.tables.heads import FRAMES
from meshfit.units import count_text, size_text

_FILES = {
    "result.json": "every measurement; written last",
    "measurement.json": "a later measurement, whose values are shown",
    "failure.json": "why the trial failed",
    "trial.log": "log of the trial",
    "config.yaml": "every setting",
    "trace.csv": "every loss term by step",
    "times.csv": "seconds of the fit by step",
    "source.ply": "the source, refined and aligned",
    "source.attributes.npz": "texture coordinates, colours and the like of the source",
    "result.ply": "the result",
    "result.attributes.npz": "those of the result; `meshfit save` writes both in any format",
    "correspondence.csv": "the target's face or point nearest to each vertex of the result",
    "control.ply": "the control mesh; refined by the scheme, it is the result",
    "control.attributes.npz": "texture coordinates, colours and the like of the control mesh",
    "last_good.ply": "the mesh before the fit diverged",
    "checkpoint.pt": "where a rerun resumes",
    "progress.json": "the latest progress",
}
_HALF_WRITTEN = "half-written, left by a killed process"


def show(
    trial: TrialName,
    runs: Runs = DEFAULT_RUNS,
    all_settings: Annotated[
        bool, typer.Option("--all", help="Show every setting, not only those changed from their defaults.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Show one trial: status, metrics, settings, files, failure.

    Examples:
        meshfit show runs/table1/bunny/loop/seed-0-*
        meshfit show 3f9a  # the trial whose identity starts with 3f9a
        meshfit show 3f9a --all --runs elsewhere
    """
    experiment, scanned = find_trial(trial, runs, datetime.now(UTC))
    result = read_result_or_warn(scanned.path)
    settings = _settings(scanned.path, result)
    if as_json:
        typer.echo(json.dumps(_plain(experiment, scanned, result, settings), indent=2))
        return 0
    style = f"bold {STYLES[scanned.status]}".strip()
    out.print(Text.assemble((scanned.label, "bold"), "  ", (scanned.status.value, style)))
    out.print(_grid(((Text(name, "bold"), Text(text)) for name, text in _facts(experiment, scanned, result)), indent=0))
    if scanned.status is TrialStatus.FAILED:
        _print_failure(read_failure(scanned.path))
    if result is not None:
        _print_heading("metrics")
        out.print(_grid(_metrics(result), right=True))
    if settings:
        _print_heading("settings" if all_settings else "settings changed from their defaults; --all shows every one")
        text = dump(settings if all_settings else non_default_settings(settings))
        out.print(Padding(Text(text.rstrip()), (0, 0, 0, 2)))
    if files := _files(scanned):
        _print_heading("files")
        rows = ((Text(name), Text(size_text(count)), Text(meaning)) for name, count, meaning in files)
        out.print(_grid(rows, right=True))
    return 0


def _settings(folder: Path, result: Result | None) -> dict[str, Any]:
    try:
        return read_settings(folder, result)
    except (StoreError, ConfigError) as error:  # damaged, and written again by the next run
        print_warning(f"settings left out: {error}")
        return {}


def _plain(
    experiment: ScannedExperiment, trial: ScannedTrial, result: Result | None, settings: dict[str, Any]
) -> dict[str, object]:
    ended, progress = end_time(trial.path), read_progress(trial.path)
    return {
        "experiment": experiment.name,
        "target": trial.target,
        "scheme": trial.scheme,
        "seed": trial.seed,
        "variant": trial.variant,
        "identity": _identity(trial, result),
        "folder": str(trial.path),
        "state": trial.status.value,
        "ended": ended.isoformat() if ended else None,
        "progress": progress.to_dict() if progress else None,
        "failure": read_failure(trial.path).record if trial.status is TrialStatus.FAILED else None,
        "settings": settings,
        "result": None if result is None else {key: value for key, value in result.items() if key != "folder"},
        "files": [{"name": name, "bytes": count, "what": meaning} for name, count, meaning in _files(trial)],
    }


def _identity(trial: ScannedTrial, result: Result | None) -> str:
    return str(result["identity"]) if result and "identity" in result else trial.identity


def _facts(experiment: ScannedExperiment, trial: ScannedTrial, result: Result | None) -> Iterator[tuple[str, str]]:
    yield "experiment", experiment.name
    yield "identity", _identity(trial, result)
    yield "folder", str(trial.path)
    if ended := end_time(trial.path):
        yield "ended", f"{ended:%Y-%m-%d %H:%M} UTC"
    if result is not None and AGAIN in result:
        yield "measured again", f"{result[AGAIN]['finished']}; the values of the fit are in result.json"
    if progress := read_progress(trial.path):
        yield "started", f"{progress.started:%Y-%m-%d %H:%M} UTC"
        yield "at", f"{progress.status}, step {progress.step.done:,} of {progress.step.steps:,}"
        yield "runs on" if trial.status is TrialStatus.RUNNING else "ran on", f"{progress.host}, process {progress.pid}"
    if result is None:
        return
    yield from _carried(trial, result)
    yield from _frame(result)
    yield from _inputs(result)
    machine, versions = result.get("platform", {}), result.get("versions", {})
    device = result.get("fit", {}).get("device")
    parts = [str(machine.get("system", "")), f"device {device}" if device else ""]
    parts += [f"{name} {versions[name]}" for name in ("meshfit", "torch", "python") if name in versions]
    yield "ran on", ", ".join(filter(None, parts))
    if tool := result.get("tool"):
        yield "tool", ", version ".join(filter(None, (tool["name"], tool["version"])))
    if seconds := result.get("seconds"):
        yield "seconds", ", ".join(f"{name} {value:.3g}" for name, value in seconds.items())
    if memory := result.get("peak_memory_mb"):
        yield "memory", size_text(memory * 1e6)
    for text in result.get("warnings", ()):
        yield "warning", str(text)


def _carried(trial: ScannedTrial, result: Result) -> Iterator[tuple[str, str]]:
    """Yield the copies of the target in the run directory."""
    if carried := find_carried(trial.path, result):
        yield "target", str(carried)
        if (pack := carried.with_suffix(PACK_SUFFIX)).is_file():
            yield "views", str(pack)


def _inputs(result: Result) -> Iterator[tuple[str, str]]:
    """Yield what a source was made from, its alignment, and the points of a target that is a cloud."""
    if "made_from" in (source := result.get("source", {})):
        wrap = "".join(f", {name} {value:.3g}" for name, value in source.get("wrap", {}).items())
        yield "source", f"from the {source['made_from']} ({source['reason']}){wrap}"
    if align := source.get("align"):
        turn = f"turned by {align['turn_degrees']:.3g}°, scaled by {align['scale']:.4g}"
        other = align["other_turn_degrees"]
        if other is not None:
            distances = f"distance {align['distance']:.2g}, and {align['other_distance']:.2g}"
            turn += f" ({distances} of the next best pose, {other:.0f}° from it)"
        yield "aligned", f"{align['method']}: {turn}"
    if images := result.get("images"):
        counts = f"{count_text(images['views'], 'view')}, {images['held_out']:,} held out"
        yield "images", f"{counts}; distances are to the {IMAGE_REFERENCES[images['compared_with']]}"
    if cloud := result.get("cloud"):
        normals = "its own normals" if cloud["normals"] == "own" else "estimated normals"
        yield "points", f"{cloud['points']:,}, about {cloud['spacing']:.3g} apart, {normals}"


def _frame(result: Result) -> Iterator[tuple[str, str]]:
    """The frame of the numbers and of the meshes."""
    with suppress(KeyError):
        normalise = result["frame"]["normalise"]
        yield "lengths", f"in {FRAMES.get(normalise, normalise)}"
        in_target_frame = written_frame(result) == "target"
        yield "meshes", "in the frame and unit of the target's file" if in_target_frame else "in the unit of lengths"


def _print_failure(failure: Failure) -> None:
    _print_heading("failure")
    step = "" if failure.step is None else f", at step {failure.step:,}"
    out.print(Padding(Text.assemble((failure.kind, "bold red"), step), (0, 0, 0, 2)))
    out.print(Padding(Text(failure.message), (0, 0, 0, 2)))
    out.print(Text(f"  see {failure.path}"), soft_wrap=True)


def _metrics(result: Result) -> Iterator[tuple[Text, Text]]:
    values = flatten({key: value for key, value in result.items() if isinstance(value, Mapping) and key != "settings"})
    for name, metric in METRICS.items():
        if (value := values.get(name)) is not None and not name.startswith("seconds."):
            text = str(value) if isinstance(value, bool) else format(value, metric.format)
            yield Text(metric.title), Text(text, "bold")


def _files(trial: ScannedTrial) -> list[tuple[str, int, str]]:
    """Name, size in bytes and meaning of each file, in the order of `_FILES`, and of the folder of snapshots."""
    names = [name for name in trial.folder.files if name != LOCK and (trial.path / name).is_file()]
    order = {name: i for i, name in enumerate(_FILES)}
    files = [
        (name, (trial.path / name).stat().st_size, _FILES.get(name, _HALF_WRITTEN if is_half_written(name) else ""))
        for name in sorted(names, key=lambda name: (order.get(name, len(order)), name))
    ]
    if snapshots := snapshots_in(trial.path):
        steps = list(snapshots)
        count = f"{count_text(len(steps), 'snapshot')}, steps {steps[0]} to {steps[-1]}"
        files.append((f"{SNAPSHOTS}/", sum(path.stat().st_size for path in snapshots.values()), count))
    return files


def _grid(rows: Iterable[tuple[Text, ...]], *, right: bool = False, indent: int = 2) -> Padding:
    """Two or three columns of text without headings."""
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column()
    grid.add_column(justify="right" if right else "left", overflow="fold")
    for row in rows:
        grid.add_row(*row)
    return Padding(grid, (0, 0, 0, indent))


def _print_heading(text: str) -> None:
    out.print(Text(f"\n{text}", "bold"))
