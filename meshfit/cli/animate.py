"""`meshfit animate`: a video of a fit from its snapshots, or from shape to shape."""

import os
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from meshfit.cli import completions
from meshfit.cli.console import err, out
from meshfit.cli.options import DEFAULT_RUNS, Runs, UpAxis, say_turned
from meshfit.errors import ConfigError
from meshfit.paths import shell_path

if TYPE_CHECKING:
    from meshfit.experiment.status.scan import ScannedTrial
    from meshfit.experiment.storage.plan_file import UpChoice
    from meshfit.report.figures.animation import Animation
    from meshfit.report.figures.shape_animation import NamedShape

BETWEEN = "From shape to shape"

_STEPS, _STEPS_IN_ROW = 24, 4
_SUGGESTED_SNAPSHOTS = 60

_T = TypeVar("_T")


def animate(
    trials: Annotated[
        list[str],
        typer.Argument(
            help="A trial's folder, a file in it, or the first digits of its identity (4 or more); with --between, "
            "trials or mesh files.",
            metavar="TRIAL",
            autocompletion=completions.trials,
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Video to write: .mp4 or .gif; with --between also a .png, .pdf or .svg of a row.",
            metavar="FILE",
        ),
    ] = None,
    between: Annotated[
        bool,
        typer.Option(
            "--between",
            help="Go from shape to shape: the results of these trials, or mesh files with the same faces; with one "
            "trial, from its source to its result.",
            rich_help_panel=BETWEEN,
        ),
    ] = False,
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            min=1,
            max=10_000,
            help="Steps from each shape to the next.",
            show_default="24, or 4 in a row",
            metavar="N",
            rich_help_panel=BETWEEN,
        ),
    ] = None,
    back: Annotated[
        bool, typer.Option("--back", help="Return to the first shape in the end.", rich_help_panel=BETWEEN)
    ] = False,
    align: Annotated[
        bool,
        typer.Option(
            "--align", help="Give all shapes the position, rotation and size of the first.", rich_help_panel=BETWEEN
        ),
    ] = False,
    meshes: Annotated[
        Path | None,
        typer.Option(
            "--meshes",
            help="Write the shapes as shape-000.ply and so on to this folder.",
            metavar="FOLDER",
            rich_help_panel=BETWEEN,
        ),
    ] = None,
    view: Annotated[
        str,
        typer.Option(
            "--view",
            help="best, front, back, left, right, top, bottom, or AZIMUTH,ELEVATION in degrees.",
            metavar="VIEW",
        ),
    ] = "best",
    fps: Annotated[int, typer.Option("--fps", min=1, max=60, help="Frames per second, 1 to 60.", metavar="N")] = 12,
    size: Annotated[
        int, typer.Option("--size", min=64, max=2160, help="Width and height in pixels, 64 to 2160.", metavar="PIXELS")
    ] = 640,
    edges: Annotated[
        bool | None,
        typer.Option(
            "--edges/--no-edges",
            help="Draw the edges of faces.",
            show_default="if the faces change, except in the result",
        ),
    ] = None,
    up: UpAxis = None,
    runs: Runs = DEFAULT_RUNS,
) -> int:
    """Write a video of a fit, or from shape to shape.

    A fit goes from source to result. The camera is the best view of the target. The caption gives the step, the loss or
    distance, and the number of vertices; for the Gauss–Newton engine also the level. The trial must have snapshots: run
    it with --set fit.snapshots=20 for one every 20 steps.

    With --between, shapes with the same faces change into each other. Parts turn as rigidly as possible in place of
    vertices on straight lines. Trials are in their normalised frames, files in their own coordinates.
    Requires the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit run quickstart --set fit.snapshots=20 --force
        meshfit animate runs/quickstart/bunny/loop/seed-0-* -o fit.mp4
        meshfit animate 3f9a -o fit.gif --size 320 --edges
        meshfit animate --between template.obj registered.obj -o change.gif --back --align
    """
    options = _Drawing(output, fps, size, edges, up, view)
    if between:
        return _animate_between(trials, options, runs, _Way(steps, meshes, back=back, align=align))
    for option, given in (("--steps", steps), ("--back", back), ("--align", align), ("--meshes", meshes)):
        if given:
            raise ConfigError(f"{option}: requires --between")
    if len(trials) > 1:
        raise ConfigError(f"expected one trial, got {len(trials)}; --between goes from shape to shape")
    return _animate_fit(trials[0], options, runs)


@dataclass(frozen=True)
class _Drawing:
    output: Path | None
    fps: int
    size: int
    edges: bool | None
    up: "UpChoice | None"
    view: str


@dataclass(frozen=True)
class _Way:
    steps: int | None
    meshes: Path | None
    back: bool
    align: bool


def _animate_fit(name: str, options: _Drawing, runs: Path) -> int:
    from meshfit.experiment.status.scan import find_trial
    from meshfit.report.figures.animation import read_animation, require_video_suffix

    if options.output is None:
        raise ConfigError("-o: expected the video to write, such as -o fit.mp4")
    require_video_suffix(options.output)
    _, scanned = find_trial(name, runs, datetime.now(UTC))
    _require_snapshots(scanned)
    animation = replace(read_animation(scanned.path, options.up), view=options.view)
    _write_video(animation, options, options.output)
    say_turned([scanned.label] if animation.is_turned else [])
    return 0


def _write_video(animation: "Animation", options: _Drawing, output: Path) -> None:
    from meshfit.report.figures.animation import draw_animation, write_video
    from meshfit.units import size_text

    images = draw_animation(animation, size=options.size, fps=options.fps, edges=options.edges)
    count = write_video(_with_progress(images, len(animation.frames)), output, options.fps)
    length = f"{count} frames, {count / options.fps:.1f} s, {size_text(output.stat().st_size)}"
    out.print(f"wrote {output}: {length}", soft_wrap=True, markup=False)


def _animate_between(names: list[str], options: _Drawing, runs: Path, way: _Way) -> int:
    from meshfit.report.figures import shape_animation as shapes_of
    from meshfit.report.figures.animation import require_video_suffix
    from meshfit.report.figures.layout import DPI

    output = options.output
    if output is None and way.meshes is None:
        raise ConfigError("--between: expected -o FILE, a video or a picture, or --meshes FOLDER")
    in_row = output is not None and output.suffix.lower() in DPI
    if output is not None and not in_row:
        require_video_suffix(output)
    shapes = [shape for name in names for shape in _shapes(name, runs, both=len(names) == 1)]
    if way.align:
        shapes = shapes_of.aligned(shapes)
    count = way.steps or (_STEPS_IN_ROW if in_row else _STEPS)
    steps = list(shapes_of.steps_between(shapes, count, back=way.back))
    if way.meshes is not None:
        shapes_of.write_meshes(steps, way.meshes)
        out.print(f"wrote {len(steps)} meshes to {way.meshes}", soft_wrap=True, markup=False)
    if output is None:
        return 0
    animation = shapes_of.shape_animation(steps, options.up or "auto", options.view)
    if in_row:
        up, edges = animation.up, bool(options.edges)
        shapes_of.write_row(steps, output, size=options.size, up=up, view=options.view, edges=edges)
        out.print(f"wrote {output}", soft_wrap=True, markup=False)
    else:
        _write_video(animation, options, output)
    say_turned([shapes[0].title] if animation.is_turned else [])
    return 0


def _shapes(name: str, runs: Path, *, both: bool) -> list["NamedShape"]:
    """Return the shape of a mesh file or of a trial; of a trial that is alone, its source too."""
    from meshfit.experiment.status.scan import find_trial
    from meshfit.experiment.trial_status import TrialStatus
    from meshfit.paths import MESH_SUFFIXES, format_suffix, is_regular_file
    from meshfit.report.figures.shape_animation import shape_of_file, shapes_of_trial

    path = Path(name)
    if is_regular_file(path) and format_suffix(path) in MESH_SUFFIXES:
        if both:
            raise ConfigError(f"{name}: --between goes from one shape to others; give two mesh files or more")
        return [shape_of_file(path)]
    _, scanned = find_trial(name, runs, datetime.now(UTC))
    if scanned.status is not TrialStatus.COMPLETE:
        raise ConfigError(f"{scanned.label}: {scanned.status.value}, not complete; run it first")
    source, result = shapes_of_trial(scanned.path)
    return [source, result] if both else [result]


def _require_snapshots(trial: "ScannedTrial") -> None:
    from meshfit.experiment.storage.checkpoint import snapshots_in
    from meshfit.experiment.storage.plan_file import planned_up
    from meshfit.experiment.storage.run_directory import CONFIG, RESULT, read_json
    from meshfit.experiment.trial_status import TrialStatus

    if trial.status is not TrialStatus.COMPLETE:
        state = f"{trial.label}: {trial.status.value}, not complete"
        raise ConfigError(f"{state}; run it first, with --set fit.snapshots=20")
    if snapshots_in(trial.path):
        return
    result = read_json(trial.path / RESULT)
    if "tool" in result:
        raise ConfigError(f"{trial.label}: a fit by another tool has no steps to animate")
    every = max(1, result["fit"]["steps"] // _SUGGESTED_SNAPSHOTS)
    # The config in the trial's folder is of this trial alone, whatever the command that ran it.
    name, place = shlex.quote(result["experiment"]), shell_path(trial.path)
    root = Path(os.path.abspath(trial.path)).parents[3]  # noqa: PTH100  a run directory may be a link
    runs = shell_path(os.path.relpath(root))
    command = f"meshfit run {place}/{CONFIG} --name {name} --runs {runs} --set fit.snapshots={every} --force"
    if (up := planned_up(trial.path)) != "auto":
        command += f" --set view.up={up}"
    raise ConfigError(f"{trial.label}: no snapshots; to take some: {command}")


def _with_progress(images: Iterator[_T], count: int) -> Iterator[_T]:
    """Pass images on, with a progress line on a terminal."""
    with err.status("drawing") as status:
        for number, image in enumerate(images, start=1):
            status.update(f"drawing {number} of {count}")
            yield image
