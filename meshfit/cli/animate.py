"""`meshfit animate`: a video of a fit, from its snapshots."""

import os
import shlex
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from meshfit.cli.console import err, out
from meshfit.cli.options import DEFAULT_RUNS, Runs, TrialName, UpAxis, say_turned
from meshfit.errors import ConfigError
from meshfit.paths import shell_path

if TYPE_CHECKING:
    from meshfit.experiment.status.scan import ScannedTrial

_SUGGESTED_SNAPSHOTS = 60

_T = TypeVar("_T")


def animate(
    trial: TrialName,
    output: Annotated[Path, typer.Option("--output", "-o", help="Video to write: .mp4 or .gif.", metavar="FILE")],
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
    """Write a video of a fit, from source to result.

    The camera is the best view of the target. The caption gives the step, the loss or distance, and the number of
    vertices; for the Gauss–Newton engine also the level. The trial must have snapshots: run it with
    --set fit.snapshots=20 for one every 20 steps. Requires the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit run quickstart --set fit.snapshots=20 --force
        meshfit animate runs/quickstart/bunny/loop/seed-0-* -o fit.mp4
        meshfit animate 3f9a -o fit.gif --size 320 --edges
    """
    from meshfit.experiment.status.scan import find_trial
    from meshfit.report.figures.animation import draw_animation, read_animation, require_video_suffix, write_video
    from meshfit.units import size_text

    require_video_suffix(output)
    _, scanned = find_trial(trial, runs, datetime.now(UTC))
    _require_snapshots(scanned)
    animation = read_animation(scanned.path, up)
    images = draw_animation(animation, size=size, fps=fps, edges=edges)
    count = write_video(_with_progress(images, len(animation.frames)), output, fps)
    say_turned([scanned.label] if animation.is_turned else [])
    length = f"{count} frames, {count / fps:.1f} s, {size_text(output.stat().st_size)}"
    out.print(f"wrote {output}: {length}", soft_wrap=True, markup=False)
    return 0


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
