"""`meshfit animate`: a fit as a film, from the snapshots that were taken of it."""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from meshfit.cli.console import err, out
from meshfit.cli.options import DEFAULT_RUNS, Runs, TrialName
from meshfit.errors import ConfigError

if TYPE_CHECKING:
    from meshfit.experiment.status.scan import ScannedTrial

_MOMENTS = 60

_T = TypeVar("_T")


def animate(
    trial: TrialName,
    output: Annotated[Path, typer.Option("--output", "-o", help="The film to write: .mp4 or .gif.", metavar="FILE")],
    fps: Annotated[int, typer.Option("--fps", min=1, max=60, help="Pictures a second, 1 to 60.", metavar="N")] = 12,
    size: Annotated[
        int, typer.Option("--size", min=64, max=2160, help="Width and height in pixels, 64 to 2160.", metavar="PIXELS")
    ] = 640,
    edges: Annotated[
        bool | None,
        typer.Option(
            "--edges/--no-edges",
            help="Draw the edges of faces.",
            show_default="where faces change, all but the result",
        ),
    ] = None,
    runs: Runs = DEFAULT_RUNS,
) -> int:
    """Write a film of a fit, from source to result.

    All of it is seen from where the target looks best, with step, loss or distance, and verts below; the second engine
    shows its levels. The trial needs snapshots: run it with --set fit.snapshots=20, a picture every 20 steps.
    Needs the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit run quickstart --set fit.snapshots=20 --force

        meshfit animate runs/quickstart/bunny/loop/seed-0-* -o fit.mp4

        meshfit animate 3f9a -o fit.gif --size 320 --edges
    """
    from meshfit.experiment.status.scan import find_trial
    from meshfit.report.figures.animation import course_of, frames_of, require_film, write_film
    from meshfit.units import size_text

    require_film(output)
    _, found = find_trial(trial, runs, datetime.now(UTC))
    _require_snapshots(found)
    course = course_of(found.path)
    frames = frames_of(course, size=size, fps=fps, edges=edges)
    count = write_film(_told(frames, len(course.moments)), output, fps)
    film = f"{count} frames, {count / fps:.1f} s, {size_text(output.stat().st_size)}"
    out.print(f"wrote {output}: {film}", soft_wrap=True, markup=False)
    return 0


def _require_snapshots(trial: "ScannedTrial") -> None:
    from meshfit.config.loading import bundled_configs
    from meshfit.experiment.storage.checkpoint import snapshots_in
    from meshfit.experiment.storage.result import read_result
    from meshfit.experiment.trial_status import TrialStatus

    if trial.status is not TrialStatus.COMPLETE:
        said = f"{trial.label}: {trial.status.value}, not complete"
        raise ConfigError(f"{said}; run it first, with --set fit.snapshots=20")
    if snapshots_in(trial.path):
        return
    result = read_result(trial.path) or {}
    name = str(result.get("experiment", "my"))
    config = name if name in bundled_configs() else f"{name}.yaml"
    settings: dict[str, object] = {"fit.snapshots": max(1, result["fit"]["steps"] // _MOMENTS)}
    settings |= {"targets": f"[{trial.target}]", "schemes": f"[{trial.scheme}]", "seeds": f"[{trial.seed}]"}
    sets = " ".join(f"--set {key}={value}" for key, value in settings.items())
    raise ConfigError(f"{trial.label}: no snapshots were taken; to take some: meshfit run {config} {sets} --force")


def _told(frames: Iterator[_T], count: int) -> Iterator[_T]:
    """The same, with the number of the one that is being drawn on a terminal."""
    with err.status("drawing") as status:
        for number, frame in enumerate(frames, start=1):
            status.update(f"drawing {number} of {count}")
            yield frame
