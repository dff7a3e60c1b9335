"""The figure of some runs: target, source and results in a row for each target, and below where results are off."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshfit.measuring.metrics import METRICS
from meshfit.mesh.mesh import Mesh
from meshfit.report.camera import Camera, camera_of
from meshfit.report.numbers import plain
from meshfit.report.picks import Pick, TargetPicks
from meshfit.report.plate import ColourBar, Panel, Row
from meshfit.report.surface_errors import distances_to, shared_limit
from meshfit.report.trial_meshes import TrialMeshes, trial_meshes
from meshfit.report.typeset import DPI, column_width, write_plate
from meshfit.report.view import View

WIDTH = 7.0
"""Of a figure over both columns of a paper, in inches."""

_TALLEST = 9.0
_FONT = 8.0
_MOST_SOURCES = 2


@dataclass(frozen=True)
class Strip:
    """What a figure shows of a target.

    Attributes:
        shown: the picks, and what they are called.
        trials: the meshes of each pick.
        sources: the sources that differ, each with the names of its schemes.
        camera: the view of all its meshes.
        aspect: width by height of a picture.
    """

    shown: TargetPicks
    trials: tuple[TrialMeshes, ...]
    sources: tuple[tuple[str, Mesh], ...]
    camera: Camera
    aspect: float

    @property
    def columns(self) -> int:
        """How many pictures are side by side."""
        return 1 + len(self.sources) + len(self.trials)


def read_strips(picked: Iterable[TargetPicks]) -> tuple[Strip, ...]:
    """Read the meshes that a figure shows, and find the view of each target.

    Raises:
        StoreError, MeshError: a result or a mesh cannot be read.
    """
    strips = []
    for shown in picked:
        trials = tuple(trial_meshes(pick.folder) for pick in shown.picks)
        view = camera_of(trials[0].target)
        camera, aspect = view.framing(trials[0].target, *(trial.result for trial in trials))
        strips.append(Strip(shown, trials, tuple(_sources(shown.picks, trials)), camera, aspect))
    return tuple(strips)


def write_figure(strips: Sequence[Strip], path: Path, metric: str) -> None:
    """Draw the figure and write it.

    Args:
        strips: from top to bottom.
        path: .pdf, .svg or .png.
        metric: a name of `METRICS`, of which each result tells its value.

    Raises:
        ConfigError: a library is missing, or the file cannot be written.
    """
    columns = max(strip.columns for strip in strips)
    widest = column_width(WIDTH, columns)
    # Pictures get smaller where all of them would be more than a page is high.
    tall = 2 * sum(widest / strip.aspect for strip in strips)
    across = widest * min(1.0, (_TALLEST - 0.5 * len(strips)) / tall)
    rows = [row for strip in strips for row in _rows(strip, metric, across, columns)]
    write_plate(rows, path, width=WIDTH, font=_FONT)


def _sources(picks: Sequence[Pick], trials: Sequence[TrialMeshes]) -> Iterator[tuple[str, Mesh]]:
    """The sources that differ, or the first where there is no room for more."""
    named: list[tuple[list[str], Mesh]] = []
    for pick, trial in zip(picks, trials, strict=True):
        same = next((names for names, mesh in named if np.array_equal(mesh.verts, trial.source.verts)), None)
        if same is None:
            named.append(([pick.scheme], trial.source))
        else:
            same.append(pick.scheme)
    if len(named) == 1:
        yield "source", named[0][1]
        return
    for names, mesh in named if len(named) <= _MOST_SOURCES else named[:1]:
        yield f"source, {', '.join(names)}", mesh


def _rows(strip: Strip, metric: str, across: float, columns: int) -> Iterator[Row]:
    view = View(strip.camera, (round(across * DPI), max(1, round(across * DPI / strip.aspect))))
    picked = list(zip(strip.shown.picks, strip.trials, strict=True))
    target = view.plain(strip.trials[0].target, strip.shown.title)
    sources = [view.fitting(mesh).plain(mesh, name) for name, mesh in strip.sources]
    results = [view.plain(trial.result, pick.scheme, _figure(pick, metric)) for pick, trial in picked]
    yield Row(_filled([target, *sources, *results], columns))
    distances = [distances_to(trial.result, trial.target) for trial in strip.trials]
    limit = shared_limit(distances)
    coloured = [view.coloured(trial.result, each, limit) for trial, each in zip(strip.trials, distances, strict=True)]
    bar = ColourBar(limit, "distance to the target", more=any(each.max() > limit for each in distances))
    yield Row(_filled([*[None] * (1 + len(sources)), *coloured], columns), bar)


def _figure(pick: Pick, metric: str) -> str:
    title = METRICS[metric].title
    value = plain(pick.value, whole=METRICS[metric].format == "d")
    return f"{title} {value}" if len(title) < 20 else value


def _filled(panels: Sequence[Panel | None], columns: int) -> tuple[Panel | None, ...]:
    return (*panels, *[None] * (columns - len(panels)))
