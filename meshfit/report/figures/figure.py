"""The figure of an experiment: per target, a row of target, sources and results, and a row of their distances."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from meshfit.measuring.metrics import METRICS
from meshfit.mesh.mesh import Mesh
from meshfit.report.figures.camera import Camera, camera_of
from meshfit.report.figures.colours import shared_limit
from meshfit.report.figures.layout import (
    DPI,
    ColourBar,
    Panel,
    PanelRow,
    column_width,
    distance_panel,
    mesh_panel,
    write_rows,
)
from meshfit.report.figures.representative_trial import RepresentativeTrial, TargetTrials
from meshfit.report.figures.trial_meshes import TrialMeshes, distances_to, distinct_meshes, read_trial_meshes
from meshfit.report.tables.formats.latex import escape
from meshfit.report.tables.notes import FRAMES
from meshfit.report.tables.numbers import format_number

WIDTH = 7.0
"""Width in inches of a figure across both columns of a paper."""

_TALLEST = 9.0
_FONT = 8.0
_MOST_SOURCES = 2


@dataclass(frozen=True)
class FigureTarget:
    """One target of a figure.

    Attributes:
        selected: its representative trials.
        meshes: the meshes of each trial.
        sources: the distinct sources with their titles; only the first if there is no room for all.
        omits_sources: whether distinct sources are left out.
        camera: the view of all its meshes.
        aspect: width by height of a picture.
    """

    selected: TargetTrials
    meshes: tuple[TrialMeshes, ...]
    sources: tuple[tuple[str, Mesh], ...]
    omits_sources: bool
    camera: Camera
    aspect: float

    @property
    def title(self) -> str:
        """The title of the target."""
        return self.selected.title

    @property
    def columns(self) -> int:
        """The number of pictures side by side."""
        return 1 + len(self.sources) + len(self.meshes)


def read_figure_targets(selection: Iterable[TargetTrials]) -> tuple[FigureTarget, ...]:
    """Read the meshes of a figure, and frame the view of each target.

    Raises:
        StoreError, MeshError: a result or a mesh cannot be read.
    """
    read = [(group, tuple(read_trial_meshes(trial.folder) for trial in group.trials)) for group in selection]
    targets = []
    for group, meshes in read:
        same = [trial for other, trials in read if other.target == group.target for trial in trials]
        camera, aspect = camera_of(meshes[0].target).framing(meshes[0].target, *(trial.result for trial in same))
        groups = distinct_meshes([(each.scheme, its.source) for each, its in zip(group.trials, meshes, strict=True)])
        sources = [("source" if len(groups) == 1 else f"source, {', '.join(names)}", mesh) for names, mesh in groups]
        omits = len(sources) > _MOST_SOURCES
        targets.append(FigureTarget(group, meshes, tuple(sources[:1] if omits else sources), omits, camera, aspect))
    return tuple(targets)


def write_figure(targets: Sequence[FigureTarget], path: Path, metric: str) -> None:
    """Draw the figure and write it.

    Args:
        targets: from top to bottom.
        path: .pdf, .svg or .png.
        metric: a name of `METRICS`, whose value is printed below each result.

    Raises:
        ConfigError: a library is not installed, or the file cannot be written.
    """
    columns = max(target.columns for target in targets)
    widest = column_width(WIDTH, columns)
    # Pictures shrink if all of them would be taller than a page.
    tall = 2 * sum(widest / target.aspect for target in targets)
    across = widest * min(1.0, (_TALLEST - 0.5 * len(targets)) / tall)
    dpi = DPI[path.suffix.lower()]
    rows = [row for target in targets for row in _rows(target, metric, round(across * dpi), columns)]
    write_rows(rows, path, width=WIDTH, font=_FONT, dpi=dpi)


def _rows(target: FigureTarget, metric: str, width: int, columns: int) -> Iterator[PanelRow]:
    camera, aspect, size = target.camera, target.aspect, (width, max(1, round(width / target.aspect)))
    first = mesh_panel(target.meshes[0].target, camera, size, target.title)
    sources = [mesh_panel(mesh, camera.centred_on(mesh, aspect), size, title) for title, mesh in target.sources]
    results = [
        mesh_panel(meshes.result, camera, size, trial.scheme, _value_text(trial, metric))
        for trial, meshes in zip(target.selected.trials, target.meshes, strict=True)
    ]
    yield PanelRow(_padded([first, *sources, *results], columns))
    distances = [distances_to(meshes.result, meshes.target) for meshes in target.meshes]
    limit = shared_limit(distances)
    coloured = [
        distance_panel(meshes.result, values, limit, camera, size)
        for meshes, values in zip(target.meshes, distances, strict=True)
    ]
    bar = ColourBar(limit, "distance to the target", more=any(values.max() > limit for values in distances))
    yield PanelRow(_padded([*[None] * (1 + len(sources)), *coloured], columns), bar)


def _value_text(trial: RepresentativeTrial, metric: str) -> str:
    value = "" if trial.value is None else format_number(trial.value, whole=METRICS[metric].format == "d")
    return f"{METRICS[metric].title} {value}"


def _padded(panels: Sequence[Panel | None], columns: int) -> tuple[Panel | None, ...]:
    return (*panels, *[None] * (columns - len(panels)))


def plain_caption(targets: Sequence[FigureTarget], metric: str) -> str:
    """Return the caption as one paragraph.

    Args:
        targets: the targets of the figure.
        metric: a name of `METRICS`, whose value is printed below each result.
    """
    return " ".join(f"{sentence}." for sentence in _sentences(targets, metric)) + "\n"


def latex_figure(targets: Sequence[FigureTarget], metric: str, file: str) -> str:
    r"""Return a `figure*` environment, for a document with `\usepackage{graphicx}`.

    Args:
        targets: the targets of the figure.
        metric: as for `plain_caption`.
        file: name of the figure's file.
    """
    return "\n".join(
        [
            r"\begin{figure*}",
            r"  \centering",
            rf"  \includegraphics[width=\textwidth]{{{file}}}",
            rf"  \caption{{{escape(plain_caption(targets, metric).strip())}}}",
            rf"  \label{{fig:{''.join(letter if letter.isalnum() else '-' for letter in Path(file).stem)}}}",
            r"\end{figure*}",
            "",
        ]
    )


def _sentences(targets: Sequence[FigureTarget], metric: str) -> Iterator[str]:
    title = METRICS[metric].title
    several = any(len(target.sources) > 1 for target in targets)
    source = "the source as each scheme refines it" if several else "the source"
    yield (
        f"{', '.join(_titles(targets))}: from left to right the target, {source}, and the result of each scheme with "
        f"its {title}"
    )
    yield from _seeds(targets, title)
    yield (
        "Below, the distance from each vertex of a result to the target; the results of a row share one scale, which "
        "ends where 99 % of the vertices of each are nearer"
    )
    if metric.startswith("hausdorff."):
        yield "A Hausdorff distance can be larger, since it covers all points of the faces, and both directions"
    yield "A ring marks the farthest vertex; a dashed ring, one that is hidden"
    normalise = dict.fromkeys(str(target.selected.settings.get("normalise")) for target in targets)
    yield f"Lengths are in {'; '.join(FRAMES.get(name, name) for name in normalise)}"
    yield "All meshes of a target are shown from one side and at one scale, except for sources too large for it"
    if any(target.omits_sources for target in targets):
        yield "Only the first scheme's source is shown; those of the others differ"


def _seeds(targets: Sequence[FigureTarget], title: str) -> Iterator[str]:
    counts = sorted({trial.seeds for target in targets for trial in target.selected.trials})
    if counts == [1]:
        yield f"One run each: {'; '.join(_listed(targets))}"
        return
    how_many = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    yield f"Of {how_many} seeds, the run with the median {title} is shown: {'; '.join(_listed(targets))}"


def _listed(targets: Sequence[FigureTarget]) -> Iterator[str]:
    for target in targets:
        yield f"{target.title}, {', '.join(f'{trial.scheme} seed {trial.seed}' for trial in target.selected.trials)}"


def _titles(targets: Sequence[FigureTarget]) -> list[str]:
    titles = [target.title for target in targets]
    return [titles[0][:1].upper() + titles[0][1:], *titles[1:]]
