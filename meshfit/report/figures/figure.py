"""The figure of some runs: target, source and results in a row for each target, and below where results are off."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from meshfit.measuring.metrics import METRICS
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.mesh import Mesh
from meshfit.report.figures.camera import Camera, camera_of
from meshfit.report.figures.layout import DPI, ColourBar, Panel, Row, column_width, write_plate
from meshfit.report.figures.representative_trial import Pick, TargetPicks
from meshfit.report.figures.surface_errors import distances_to, shared_limit
from meshfit.report.figures.trial_meshes import TrialMeshes, trial_meshes
from meshfit.report.figures.view import View
from meshfit.report.tables.formats.latex import escape
from meshfit.report.tables.notes import FRAMES
from meshfit.report.tables.numbers import format_number

WIDTH = 7.0
"""Of a figure over both columns of a paper, in inches."""

_TALLEST = 9.0
_FONT = 8.0
_MOST_SOURCES = 2
_ALIKE = 0.01


@dataclass(frozen=True)
class Strip:
    """What a figure shows of a target.

    Attributes:
        shown: the picks, and what they are called.
        trials: the meshes of each pick.
        sources: the sources that look unlike, each with its title; only the first where there is no room for more.
        hidden: whether there are more of them.
        camera: the view of all its meshes.
        aspect: width by height of a picture.
    """

    shown: TargetPicks
    trials: tuple[TrialMeshes, ...]
    sources: tuple[tuple[str, Mesh], ...]
    hidden: bool
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
    read = [(shown, tuple(trial_meshes(pick.folder) for pick in shown.picks)) for shown in picked]
    strips = []
    for shown, trials in read:
        same = [each for other, its in read if other.target == shown.target for each in its]
        camera, aspect = camera_of(trials[0].target).framing(trials[0].target, *(each.result for each in same))
        sources = tuple(_sources(shown.picks, trials))
        hidden = len(sources) > _MOST_SOURCES
        strips.append(Strip(shown, trials, sources[:1] if hidden else sources, hidden, camera, aspect))
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
    dpi = DPI[path.suffix.lower()]
    rows = [row for strip in strips for row in _rows(strip, metric, round(across * dpi), columns)]
    write_plate(rows, path, width=WIDTH, font=_FONT, dpi=dpi)


def _sources(picks: Sequence[Pick], trials: Sequence[TrialMeshes]) -> Iterator[tuple[str, Mesh]]:
    """The sources that look unlike, each with its title."""
    found: list[tuple[list[str], Mesh]] = []
    for pick, trial in zip(picks, trials, strict=True):
        same = next((schemes for schemes, mesh in found if _look_alike(mesh, trial.source)), None)
        if same is None:
            found.append(([pick.scheme], trial.source))
        else:
            same.append(pick.scheme)
    for schemes, mesh in found:
        yield "source" if len(found) == 1 else f"source, {', '.join(schemes)}", mesh


def _look_alike(first: Mesh, second: Mesh) -> bool:
    """Whether two sources are one shape to the eye, as spheres are whose verts lie elsewhere on them."""
    size = bounding_box_diagonal(first.verts)
    apart = max(float(distances_to(first, second).max()), float(distances_to(second, first).max()))
    return apart <= _ALIKE * size


def _rows(strip: Strip, metric: str, pixels: int, columns: int) -> Iterator[Row]:
    view = View(strip.camera, (pixels, max(1, round(pixels / strip.aspect))))
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
    value = format_number(pick.value, whole=METRICS[metric].format == "d")
    return f"{title} {value}"


def _filled(panels: Sequence[Panel | None], columns: int) -> tuple[Panel | None, ...]:
    return (*panels, *[None] * (columns - len(panels)))


def plain_caption(strips: Sequence[Strip], metric: str) -> str:
    """The caption as one paragraph.

    Args:
        strips: what the figure shows.
        metric: a name of `METRICS`, of which each result tells its value.
    """
    return " ".join(f"{sentence}." for sentence in _sentences(strips, metric)) + "\n"


def latex_figure(strips: Sequence[Strip], metric: str, file: str) -> str:
    r"""A figure over both columns, for a document with `\usepackage{graphicx}`.

    Args:
        strips: what the figure shows.
        metric: as for `plain_caption`.
        file: the name of the figure's file.
    """
    return "\n".join(
        [
            r"\begin{figure*}",
            r"  \centering",
            rf"  \includegraphics[width=\textwidth]{{{file}}}",
            rf"  \caption{{{escape(plain_caption(strips, metric).strip())}}}",
            rf"  \label{{fig:{''.join(letter if letter.isalnum() else '-' for letter in Path(file).stem)}}}",
            r"\end{figure*}",
            "",
        ]
    )


def _sentences(strips: Sequence[Strip], metric: str) -> Iterator[str]:
    title = METRICS[metric].title
    several = any(len(strip.sources) > 1 for strip in strips)
    source = "the source as each scheme refines it" if several else "the source"
    yield (
        f"{', '.join(_titles(strips))}: from left to right the target, {source}, and the result of each scheme with "
        f"its {title}"
    )
    yield from _seeds(strips, title)
    yield (
        "Below, the distance from each vert of a result to the target; the results of a row share one scale, which "
        "ends where 99 of 100 verts of each are nearer"
    )
    if metric.startswith("hausdorff."):
        yield "A Hausdorff distance can be larger, since it is looked for on all of the faces, and from the target too"
    yield "A ring marks the vert that is farthest off, a dashed one where it is out of sight"
    normalise = dict.fromkeys(str(strip.shown.settings.get("normalise")) for strip in strips)
    yield f"Lengths are in {'; '.join(FRAMES.get(name, name) for name in normalise)}"
    yield "All meshes of a target are seen from one side, and but for sources that would not fit, at one scale"
    if any(strip.hidden for strip in strips):
        yield "Only the first scheme's source is shown; those of the others differ"


def _seeds(strips: Sequence[Strip], title: str) -> Iterator[str]:
    counts = sorted({pick.seeds for strip in strips for pick in strip.shown.picks})
    if counts == [1]:
        yield f"One run each: {'; '.join(_listed(strips))}"
        return
    how_many = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    yield f"Of {how_many} seeds, the run with the median {title} is shown: {'; '.join(_listed(strips))}"


def _listed(strips: Sequence[Strip]) -> Iterator[str]:
    for strip in strips:
        yield f"{strip.shown.title}, {', '.join(map(_named, strip.shown.picks))}"


def _named(pick: Pick) -> str:
    return f"{pick.scheme} seed {pick.seed}"


def _titles(strips: Sequence[Strip]) -> list[str]:
    titles = [strip.shown.title for strip in strips]
    return [titles[0][:1].upper() + titles[0][1:], *titles[1:]]
