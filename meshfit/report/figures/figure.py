"""The figure of an experiment: per target, its picture, the sources, the results, and below these their distances."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from meshfit.config.source_settings import MADE_FROM_TARGET
from meshfit.errors import ConfigError
from meshfit.experiment.storage.plan_file import UpChoice, planned_up
from meshfit.fitting.external.tools import works_from_target
from meshfit.images.folders import IMAGE_REFERENCES
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.mesh import Mesh
from meshfit.printable import printable
from meshfit.report.figures.camera import Camera, camera_of, is_turned
from meshfit.report.figures.colours import shared_limit
from meshfit.report.figures.figure_layout import Block, BlockShape, arrange, write_blocks
from meshfit.report.figures.layout import DPI, ColourBar, Panel, distance_panel, mesh_panel
from meshfit.report.figures.representative_trial import RepresentativeTrial, TargetTrials
from meshfit.report.figures.trial_meshes import TrialMeshes, distances_to, distinct_meshes, read_trial_meshes
from meshfit.report.tables.formats.latex import escape
from meshfit.report.tables.heads import FRAMES
from meshfit.report.tables.layout import SHORTFALL
from meshfit.report.tables.numbers import format_number
from meshfit.units import count_text

WIDTHS = {"single": 3.33, "double": 7.0}
"""Width in inches of a figure in one column of a paper, or across both."""
SMALLEST_PICTURE = 0.25
"""Width in inches of the smallest picture in which a shape can be seen."""
FONTS = {"single": 7.0, "double": 8.0}
"""Font sizes in points."""

_SOURCE = "source"

Width = Literal["single", "double"]
Sources = Literal["none", "once", "all"]


@dataclass(frozen=True)
class FigureStyle:
    """Layout and wording of a figure.

    Attributes:
        width: of the figure.
        columns: targets side by side; None for as many as make pictures largest.
        sources: whether the sources are shown, with the first target that has them or with each.
        labels: names to print in place of those of schemes, targets and metrics.
    """

    width: Width = "double"
    columns: int | None = None
    sources: Sources = "once"
    labels: Mapping[str, str] = field(default_factory=dict)

    def label(self, name: str) -> str:
        """Return the name to print for a scheme."""
        return self.labels.get(name, name)

    def metric_title(self, metric: str) -> str:
        """Return the name to print for a metric."""
        return self.labels.get(metric, METRICS[metric].title)


@dataclass(frozen=True)
class FigureTarget:
    """One target of a figure.

    Attributes:
        selected: its representative trials.
        meshes: the meshes of each trial.
        sources: the distinct sources, each with the indices of the trials that start from it.
        camera: the view of all its meshes.
        aspect: width by height of a picture.
        turned: whether z is up because the target seems to stand that way.
    """

    selected: TargetTrials
    meshes: tuple[TrialMeshes, ...]
    sources: tuple[tuple[tuple[int, ...], Mesh], ...]
    camera: Camera
    aspect: float
    turned: bool


def read_figure_targets(selection: Iterable[TargetTrials], up: UpChoice | None = None) -> tuple[FigureTarget, ...]:
    """Read the meshes of a figure, and frame the view of each target.

    Args:
        selection: the trials of each target.
        up: the axis that points up; by default that of each experiment.

    Raises:
        StoreError, MeshError: a result or a mesh cannot be read.
    """
    read = [(group, tuple(read_trial_meshes(trial.folder) for trial in group.trials)) for group in selection]
    targets = []
    for group, meshes in read:
        same = [trial for other, trials in read if other.target == group.target for trial in trials]
        target, axis = meshes[0].target, up or planned_up(group.trials[0].folder)
        camera, aspect = camera_of(target, axis).framing(target, *(trial.result for trial in same))
        groups = distinct_meshes([(place, trial.source) for place, trial in enumerate(meshes)])
        sources = tuple((tuple(places), mesh) for places, mesh in groups)
        targets.append(FigureTarget(group, meshes, sources, camera, aspect, is_turned(target, axis)))
    return tuple(targets)


def turned_targets(targets: Sequence[FigureTarget]) -> list[str]:
    """Return the titles of targets that are taken to stand along z."""
    return [target.selected.title for target in targets if target.turned]


def write_figure(targets: Sequence[FigureTarget], path: Path, metric: str, style: FigureStyle) -> None:
    """Draw the figure and write it.

    Args:
        targets: in reading order.
        path: .pdf, .svg or .png.
        metric: a name of `METRICS`, whose value is printed below each result.
        style: the layout and the names.

    Raises:
        ConfigError: a library is not installed, the targets do not fit on a page, or the file cannot be written.
    """
    width, font, dpi = WIDTHS[style.width], FONTS[style.width], DPI[path.suffix.lower()]
    shown = shows_sources(targets, style.sources)
    parts = list(zip(targets, shown, strict=True))
    # With a single scheme, all pictures of a target may be side by side.
    alternatives = (False, True) if all(len(target.meshes) == 1 for target in targets) else (False,)
    candidates = [
        [_shape(target, metric, style, sources=sources, in_line=in_line) for target, sources in parts]
        for in_line in alternatives
    ]
    arrangement = arrange(candidates, width, font, style.columns)
    if arrangement.cell < SMALLEST_PICTURE:
        raise ConfigError(_does_not_fit(targets, arrangement.cell, style))
    in_line = alternatives[arrangement.candidate]
    blocks = []
    for (target, sources), shape in zip(parts, candidates[arrangement.candidate], strict=True):
        size = max(1, round(arrangement.cell * dpi)), max(1, round(arrangement.cell / target.aspect * dpi))
        rows, bar = _rows(target, metric, style, size, sources=sources)
        blocks.append(Block((_in_line(rows, sources=any(shown)),) if in_line else rows, bar, shape))
    write_blocks(blocks, arrangement, path, width=width, font=font, dpi=dpi)


def _does_not_fit(targets: Sequence[FigureTarget], cell: float, style: FigureStyle) -> str:
    """Return why targets do not fit on one page, and what to do."""
    most = count_text(max(len(target.meshes) for target in targets), "result")
    counts = f"{count_text(len(targets), 'target')} with {most} each"
    remedies = ["show some with --targets and --schemes"]
    if style.columns is not None:
        remedies.append("leave out --columns")
    elif style.width != "double":
        remedies.append("give --width double")
    return (
        f"{counts} do not fit on one page: pictures would be {cell:.2f} inches wide, less than {SMALLEST_PICTURE:g}; "
        f"{', or '.join(remedies)}"
    )


def shows_sources(targets: Sequence[FigureTarget], sources: Sources) -> list[bool]:
    """Return for each target whether its sources are shown; `once` is once for each setting of the source.

    Tools that work from the target alone have none.
    """
    fitted = [not works_from_target(target.selected.settings.get("fit.tool")) for target in targets]
    if sources != "once":
        return [sources == "all" and has_source for has_source in fitted]
    of_source = [_source_settings(target) for target in targets]
    return [
        has_source and not any(fitted[i] and of_source[i] == settings for i in range(place))
        for place, (settings, has_source) in enumerate(zip(of_source, fitted, strict=True))
    ]


def _source_settings(target: FigureTarget) -> dict[str, object]:
    """Return what a source depends on: its settings, and the target where it is made from it."""
    settings = {key: value for key, value in target.selected.settings.items() if key.startswith("source.")}
    return settings | ({"target": target.selected.target} if settings.get("source.mesh") in MADE_FROM_TARGET else {})


def _shape(target: FigureTarget, metric: str, style: FigureStyle, *, sources: bool, in_line: bool) -> BlockShape:
    """The shape of a block, whose text is that of the pictures that will be drawn."""
    longest = max((result_lines(trial, metric, style) for trial in target.selected.trials), key=lambda x: len(x[0]))
    columns = 1 + len(target.meshes)
    if in_line:
        return BlockShape(1, 3 + (style.sources != "none"), target.aspect, 3 + sources, (longest,))
    separate = sources and len(target.sources) > 1
    texts: list[tuple[str, ...]] = [(_SOURCE,)] if separate else []
    texts.append(longest)
    texts += [(_SOURCE,)] if sources and not separate else []
    pictures = 1 + len(target.meshes) * (2 + separate) + (sources and not separate)
    return BlockShape(2 + separate, columns, target.aspect, pictures, tuple(texts))


def _rows(
    target: FigureTarget, metric: str, style: FigureStyle, size: tuple[int, int], *, sources: bool
) -> tuple[tuple[tuple[Panel | None, ...], ...], ColourBar]:
    """The pictures of a target: sources, if there are several, then results, then distances; and their colour bar."""
    camera, aspect = target.camera, target.aspect
    distances = [distances_to(meshes.result, meshes.measured_to) for meshes in target.meshes]
    limit = shared_limit(distances)
    results = [
        mesh_panel(meshes.result, camera, size, *result_lines(trial, metric, style))
        for trial, meshes in zip(target.selected.trials, target.meshes, strict=True)
    ]
    coloured = [
        distance_panel(meshes.result, values, limit, camera, size)
        for meshes, values in zip(target.meshes, distances, strict=True)
    ]
    bar = ColourBar(limit, "", more=any(values.max(initial=0.0) > limit for values in distances))
    shape = _shape_of_images(target)
    first = mesh_panel(target.meshes[0].target, camera, size, _title(target, style), *([shape] if shape else []))
    drawn = [
        (places, mesh_panel(mesh, camera.centred_on(mesh, aspect), size, _SOURCE)) for places, mesh in target.sources
    ]
    if not sources:
        return ((first, *results), (None, *coloured)), bar
    if len(drawn) == 1:
        return ((first, *results), (drawn[0][1], *coloured)), bar
    above = [next(panel for places, panel in drawn if place in places) for place in range(len(results))]
    return ((None, *above), (first, *results), (None, *coloured)), bar


def _in_line(rows: Sequence[Sequence[Panel | None]], *, sources: bool) -> tuple[Panel | None, ...]:
    """A target with a single scheme in one line: source, target, result and distances."""
    (target, result), (source, distances) = rows
    return (source, target, result, distances) if sources else (target, result, distances)


def result_lines(trial: RepresentativeTrial, metric: str, style: FigureStyle) -> tuple[str, ...]:
    """Return the lines below the picture of a result: its scheme, and its value with the mark of a shortfall."""
    mark = SHORTFALL if trial.shortfalls else ""
    value = () if trial.value is None else (format_number(trial.value, whole=METRICS[metric].whole) + mark,)
    return (style.label(trial.scheme), *value)


def _title(target: FigureTarget, style: FigureStyle) -> str:
    return style.labels.get(target.selected.target, target.selected.title)


def _shape_of_images(target: FigureTarget) -> str:
    """Name what is drawn and measured in place of images; empty for other targets."""
    images = target.selected.trials[0].result.get("images")
    return IMAGE_REFERENCES[images["compared_with"]] if images else ""


def plain_caption(targets: Sequence[FigureTarget], metric: str, style: FigureStyle) -> str:
    """Return the caption, of about 40 words, as one paragraph.

    Args:
        targets: the targets of the figure.
        metric: a name of `METRICS`, whose value is printed below each result.
        style: the layout and the names.
    """
    return " ".join(f"{sentence}." for sentence in _sentences(targets, metric, style)) + "\n"


def details(targets: Sequence[FigureTarget], metric: str, style: FigureStyle) -> list[str]:
    """Return what a careful reader may ask about the figure, one sentence each: which runs, and how to read it."""
    each = [
        f"{_title(target, style)}: "
        + ", ".join(f"{style.label(trial.scheme)} seed {trial.seed}" for trial in target.selected.trials)
        for target in targets
    ]
    sentences = [
        f"Runs shown: {'; '.join(each)}",
        *(
            f"{SHORTFALL} {_title(target, style)}, {style.label(trial.scheme)}: {'; '.join(trial.shortfalls)}"
            for target in targets
            for trial in target.selected.trials
            if trial.shortfalls
        ),
        "A colour scale ends where 99 % of the vertices of each result are nearer",
    ]
    sentences += [
        f"{_title(target, style)}: images; what is drawn, and what distances are to, is the {shape}"
        for target in targets
        if (shape := _shape_of_images(target))
    ]
    if any(meshes.cloud is not None for target in targets for meshes in target.meshes):
        sentences.append("Points are drawn as discs; distances to them are to discs as wide as points are apart")
    if metric.startswith("hausdorff."):
        sentences.append(
            "A Hausdorff distance can exceed the colours: it covers all points of the faces, and both directions"
        )
    sentences.append("The pictures of a target share one view and scale, except for sources too large for it")
    return [f"{sentence}." for sentence in sentences]


def latex_figure(targets: Sequence[FigureTarget], metric: str, file: str, style: FigureStyle) -> str:
    r"""Return a `figure` or `figure*` environment, for a document with `\usepackage{graphicx}`.

    Args:
        targets: the targets of the figure.
        metric: as for `plain_caption`.
        file: name of the figure's file.
        style: the layout and the names.
    """
    name, width = ("figure*", r"\textwidth") if style.width == "double" else ("figure", r"\columnwidth")
    return "\n".join(
        [
            "% needs graphicx: \\usepackage{graphicx}",
            rf"\begin{{{name}}}",
            r"  \centering",
            rf"  \includegraphics[width={width}]{{{file}}}",
            rf"  \caption{{{escape(plain_caption(targets, metric, style).strip())}}}",
            rf"  \label{{fig:{''.join(letter if letter.isalnum() else '-' for letter in Path(file).stem)}}}",
            rf"\end{{{name}}}",
            *(f"% {printable(line)}" for line in details(targets, metric, style)),
            "",
        ]
    )


def _sentences(targets: Sequence[FigureTarget], metric: str, style: FigureStyle) -> Iterator[str]:
    title = style.metric_title(metric)
    counts = sorted({trial.seeds for target in targets for trial in target.selected.trials})
    seeds = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]}–{counts[-1]}"
    run = "one run each" if counts == [1] else f"median of {seeds} seeds"
    source = "" if style.sources == "none" else ", source"
    yield f"Target{source} and the result of each scheme with its {title} ({run})"
    yield "Colours: distance of each vertex to the target; ring: the farthest vertex (dashed: hidden)"
    if any(trial.shortfalls for target in targets for trial in target.selected.trials):
        yield f"{SHORTFALL} falls short of its target"
    normalise = dict.fromkeys(str(target.selected.settings.get("normalise")) for target in targets)
    yield f"Lengths in {'; '.join(FRAMES.get(name, name) for name in normalise)}"
