"""Charts of a target section: curves of every traced term, end points and histograms, as SVG for the page.

matplotlib draws them once. Colours and fonts are then replaced by the CSS variables of the page, so that one drawing
serves the light and the dark theme, and every series gets the class of its row, so that the page can hide it.
"""

import csv
import io
import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from meshfit.experiment.storage.run_directory import TIMES, TRACE, Result
from meshfit.experiment.tuning.search_file import Search
from meshfit.mesh.mesh import Mesh
from meshfit.optional import import_optional
from meshfit.printable import printable, printable_html
from meshfit.report.figures.layout import set_log_ticks
from meshfit.report.figures.search import SearchStyle, draw_search, search_height
from meshfit.report.html.target_section import TargetSection, TrialsByRow

MOST_POINTS = 100
MOST_CURVES = 40
"""On one target; if there are more, the first seeds of each row are drawn."""
BINS = 40

_STEP = "step"
_DIGITS = 4
# The columns that state how near a fit has come, in the traces of the two engines.
_NEARNESS = ("distance", "chamfer")

# Names of columns that are abbreviated in the traces.
_NAMES = {
    "distance": "distance to the target",
    "chamfer": "chamfer distance",
    "verts": "vertices",
    "matched": "share of matched points",
    "fairness": "weight of fairness",
    "point_weight": "weight of points, rather than planes",
    "held_back": "vertices held back",
}
# Steps from one row of a trace to the next, as a multiple of the usual ones, above which no line joins them.
_JUMP = 1.5

_WIDTH, _HEIGHT, _FONT = 380, 236, 12.0
_RIGHT, _TOP, _BOTTOM, _LETTER = 22, 10, 42, 7.0
_SEARCH_WIDTH = 860
_LOG_RATIO = 3.0  # of the largest to the smallest value, above which an axis is logarithmic
_DASHES = ("-", (0, (4, 2)), (0, (1.2, 1.6)), (0, (4, 1.6, 1.2, 1.6)))
_ROW_COLOURS = 10
# Placeholders that are replaced by CSS variables.
_SOFT, _RULE, _POINT = "#010101", "#010102", "#010103"
_VARIABLES = {_SOFT: "var(--soft)", _RULE: "var(--rule)", _POINT: "var(--point)"} | {
    f"#0102{row:02x}": f"var(--row-{row})" for row in range(_ROW_COLOURS)
}


@dataclass(frozen=True)
class Chart:
    """A chart: the title above it, and its SVG."""

    title: str
    svg: str


@dataclass(frozen=True)
class Curve:
    """The trace of a trial.

    Attributes:
        row: index of the table's row.
        seed: the seed.
        times: seconds of the fit until each step; None if they were not recorded, and the result does not state how
            long the fit took.
        recorded: whether the times were recorded, rather than spread evenly over the steps that were made.
        steps: the steps.
        values: by column of the trace, one per step; NaN where there is no finite number.
    """

    row: int
    seed: int
    times: tuple[float, ...] | None
    recorded: bool
    steps: tuple[float, ...]
    values: Mapping[str, tuple[float, ...]]


def read_curves(trials: TrialsByRow) -> tuple[list[Curve], list[str]]:
    """Read the traces of some trials, and return messages about those that cannot be read."""
    per_row = max(1, MOST_CURVES // max(1, len(trials)))
    curves, problems = [], []
    for row, by_seed in trials.items():
        for result in list(by_seed.values())[:per_row]:
            if "tool" in result:  # which leaves no trace
                continue
            try:
                curves.append(_read_trace(row, result))
            except (OSError, ValueError, csv.Error) as error:
                problems.append(f"{result['folder']}/{TRACE}: {error}")
    return curves, problems


def changing_terms(curves: Sequence[Curve]) -> list[str]:
    """Return the columns that change in some curve, in the order of the traces, the nearness first."""
    terms = dict.fromkeys(
        name
        for curve in curves
        for name, values in curve.values.items()
        if len({value for value in values if not math.isnan(value)}) > 1
    )
    return sorted(terms, key=lambda name: _NEARNESS.index(name) if name in _NEARNESS else len(_NEARNESS))


def draw_curves(section: TargetSection, curves: Sequence[Curve]) -> list[Chart]:
    """Draw the nearness by time, the end of each trial, and every changing term by step."""
    terms = changing_terms(curves)
    nearness = next((term for term in _NEARNESS if term in terms), None)
    timed = [curve for curve in curves if curve.times is not None]
    charts = []
    if nearness and timed:
        label = "seconds of the fit"
        if not all(curve.recorded for curve in timed):  # trials of older versions
            label = "seconds, where not recorded spread evenly"
        charts.append(
            Chart(f"{term_title(nearness)} by time", _term_chart(section, timed, nearness, label, by_time=True))
        )
    if ends := list(_ends(section)):
        charts.append(Chart(f"{section.metric} at the end", _end_chart(section, ends)))
    charts += [Chart(term_title(term), _term_chart(section, curves, term, "step")) for term in terms]
    return charts


def term_title(term: str) -> str:
    """Return the name of a column of a trace that a reader knows."""
    return _NAMES.get(term, term.replace("_", " "))


def draw_histogram(section: TargetSection) -> Chart | None:
    """Draw the share of each result's area by distance, up to the end of the colour scale."""
    if not section.distances:
        return None
    edges = np.linspace(0.0, section.limit, BINS + 1)

    def draw(axes: Any) -> None:  # noqa: ANN401  matplotlib is optional
        for trial in section.trials:
            if trial.distances is None:
                continue
            shares, _ = area_shares(trial.mesh, trial.distances, section.limit)
            style = {"gid": f"row-{trial.row}|{trial.label}", "color": _colour(trial.row)}
            axes.stairs(shares, edges, fill=True, alpha=0.12, **style)
            axes.stairs(shares, edges, baseline=None, linewidth=1.6, linestyle=_dash(trial.row), **style)
        axes.set_xlim(0.0, section.limit)
        axes.set_ylim(bottom=0.0)

    name = f"Histogram of distances, {section.title}"
    return Chart("% of the area", _svg(draw, name, "distance to the target", section.key))


def shares_beyond(section: TargetSection) -> dict[int, float]:
    """Return, by row, the percentage of the area that is beyond the last bin, where it is visible."""
    beyond = {
        trial.row: area_shares(trial.mesh, trial.distances, section.limit)[1]
        for trial in section.trials
        if trial.distances is not None
    }
    return {row: share for row, share in beyond.items() if share >= 0.05}


def area_shares(
    mesh: Mesh, distances: Float64[np.ndarray, " V"], limit: float
) -> tuple[Float64[np.ndarray, " bins"], float]:
    """Return the percentages of a mesh's area by distance, in even bins from 0 to `limit`, and that beyond them."""
    weights = vertex_areas(mesh)
    weights = weights / (weights.sum() or 1.0) * 100
    shares, _ = np.histogram(distances, bins=BINS, range=(0.0, limit), weights=weights)
    return shares, float(weights[distances > limit].sum())


def vertex_areas(mesh: Mesh) -> Float64[np.ndarray, " V"]:
    """(V,) a third of the area of the faces at each vertex."""
    corners = mesh.verts[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 6
    return np.bincount(mesh.faces.reshape(-1), weights=np.repeat(areas, 3), minlength=mesh.num_verts)


def thinned(count: int, most: int) -> list[int]:
    """Return at most `most` of `count` indices, evenly spaced, including the first and the last."""
    if count <= most:
        return list(range(count))
    return sorted({round(place * (count - 1) / (most - 1)) for place in range(most)})


def _read_trace(row: int, result: Result) -> Curve:
    with (Path(result["folder"]) / TRACE).open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    if not lines or _STEP not in lines[0]:
        raise ValueError("it has no steps")
    steps = [float(line[_STEP]) for line in lines]
    recorded = _recorded_times(Path(result["folder"]) / TIMES, steps)
    times = recorded if recorded is not None else _spread_times(steps, result.get("seconds", {}).get("fit"))
    kept = list(_with_breaks(steps))
    return Curve(
        row=row,
        seed=result["seed"],
        times=None if times is None else tuple(times[place] for place, _ in kept),
        recorded=recorded is not None,
        steps=tuple(steps[place] for place, _ in kept),
        values={
            name: tuple(math.nan if is_break else _finite(lines[place][name]) for place, is_break in kept)
            for name in lines[0]
            if name != _STEP
        },
    )


def _recorded_times(path: Path, steps: Sequence[float]) -> list[float] | None:
    """Read the times of a trace; None where there are none, as in trials of older versions, or not for these steps."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [(float(line[_STEP]), float(line["seconds"])) for line in csv.DictReader(file)]
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        return None
    of_steps = [step for step, _ in rows] == list(steps)
    return [seconds for _, seconds in rows] if of_steps and all(math.isfinite(seconds) for _, seconds in rows) else None


def _spread_times(steps: Sequence[float], seconds: object) -> list[float] | None:
    """Spread the seconds of a fit evenly over the steps that were made; None where they are not known."""
    if not isinstance(seconds, int | float):
        return None
    apart = np.diff(steps)
    usual = float(np.median(apart)) if len(apart) else 0.0
    made = np.concatenate([[0.0], np.cumsum(np.minimum(apart, usual))])  # without those that the trace skips
    return [float(time) for time in made / (made[-1] or 1.0) * seconds]


def _with_breaks(steps: Sequence[float]) -> Iterator[tuple[int, bool]]:
    """Thin the rows of a trace: yield their places, each with whether there is a break in place of values.

    A break comes before a row if steps were left out there, and no line is drawn across it.
    """
    apart = np.diff(steps)
    usual = float(np.median(apart)) if len(apart) else 0.0
    jumps = set((np.flatnonzero(apart > _JUMP * usual) + 1).tolist())
    for place in sorted({*thinned(len(steps), MOST_POINTS), *jumps, *(jump - 1 for jump in jumps)}):
        if place in jumps:
            yield place, True
        yield place, False


def _finite(text: str | None) -> float:
    value = float(text or "nan")
    return value if math.isfinite(value) else math.nan


def _term_chart(
    section: TargetSection, curves: Sequence[Curve], term: str, label: str, *, by_time: bool = False
) -> str:
    curves = [curve for curve in curves if term in curve.values]

    def draw(axes: Any) -> None:  # noqa: ANN401  matplotlib is optional
        for curve in curves:
            x = curve.times if by_time else curve.steps
            name = f"row-{curve.row}|{section.rows[curve.row]}, seed {curve.seed}"
            style = {"color": _colour(curve.row), "linestyle": _dash(curve.row), "gid": name}
            axes.plot(x, curve.values[term], linewidth=1.3, alpha=0.75, **style)
        finite = [value for curve in curves for value in curve.values[term] if not math.isnan(value)]
        axes.set_xlim(left=0.0)
        if finite and min(finite) > 0 and max(finite) > _LOG_RATIO * min(finite):
            axes.set_yscale("log")
            set_log_ticks(axes.yaxis)

    return _svg(draw, f"{term}, {section.title}", label, f"{section.key}-{term}-{label}")


def _end_chart(section: TargetSection, ends: Sequence[tuple[int, int, float, float]]) -> str:
    def draw(axes: Any) -> None:  # noqa: ANN401  matplotlib is optional
        for row, seed, seconds, value in ends:
            style = {"color": _colour(row), "gid": f"row-{row}|{section.rows[row]}, seed {seed}: {value:.4g}"}
            axes.plot([seconds], [value], marker="o", markersize=7, markeredgewidth=0, **style)
        values = [value for *_, value in ends]
        axes.set_xlim(0.0, 1.05 * max(seconds for _, _, seconds, _ in ends))
        axes.set_ylim(1.05 * min(0.0, *values), 1.05 * max(0.0, *values))

    name = f"{section.metric} at the end, {section.title}"
    return _svg(draw, name, "seconds of the fit", f"{section.key}-ends")


def _ends(section: TargetSection) -> Iterator[tuple[int, int, float, float]]:
    """Row, seed, seconds of the fit, and value of the first metric of every trial that has them."""
    for row, by_seed in section.trials_by_row.items():
        for seed, result in by_seed.items():
            seconds = result.get("seconds", {}).get("fit")
            if seed in section.values_by_row[row] and isinstance(seconds, int | float):
                yield row, seed, float(seconds), section.values_by_row[row][seed]


def _colour(row: int) -> str:
    return f"#0102{row % _ROW_COLOURS:02x}"


def _dash(row: int) -> Any:  # noqa: ANN401  a line style of matplotlib
    return _DASHES[row // _ROW_COLOURS % len(_DASHES)]


def draw_search_chart(title: str, search: Search) -> dict[str, Chart | None]:
    """Draw a search for the template; None if none of its points is complete."""
    if not search.complete:
        return {"chart": None}
    style = SearchStyle(
        width=_SEARCH_WIDTH / 72,
        font=_FONT,
        ink=_SOFT,
        rule=_RULE,
        point=_POINT,
        best=_colour(0),
        own=_colour(1),
        failed=_colour(6),
    )
    size = (_SEARCH_WIDTH, round(72 * search_height(search, style)))
    svg = _svg_of(
        lambda figure: draw_search(figure, search, style, size[1] / 72), f"Search, {title}", f"search-{title}", size
    )
    return {"chart": Chart("", svg.replace('class="chart"', 'class="chart search"', 1))}


def _svg(draw: Callable[[Any], None], name: str, label: str, key: str) -> str:
    """Draw axes with matplotlib, and return them as SVG for the page; `key` keeps ids unique on the page."""

    def draw_figure(figure: Any) -> None:  # noqa: ANN401  matplotlib is optional
        axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
        draw(axes)
        _set_style(axes, label)

    return _svg_of(draw_figure, name, key, (_WIDTH, _HEIGHT))


def _svg_of(draw: Callable[[Any], None], name: str, key: str, size: tuple[int, int]) -> str:
    """Draw a figure with matplotlib, and return it as SVG for the page."""
    matplotlib, figures = import_optional("matplotlib"), import_optional("matplotlib.figure")
    style = {"svg.fonttype": "none", "svg.hashsalt": key, "font.size": _FONT, "text.parse_math": False}
    with matplotlib.rc_context(style), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter missing from matplotlib's fonts is drawn by the browser's
        figure = figures.Figure(figsize=(size[0] / 72, size[1] / 72))
        figure.patch.set_visible(False)
        draw(figure)
        content = io.StringIO()
        figure.savefig(content, format="svg", metadata={"Date": None})
    return _for_page(printable(content.getvalue(), keep="\n\t"), name, re.sub(r"\W+", "-", key), size)


def _set_style(axes: Any, label: str) -> None:  # noqa: ANN401  matplotlib is optional
    axes.patch.set_visible(False)
    if axes.get_yscale() == "linear":
        axes.locator_params(axis="y", nbins=6)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:.3g}")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:.4g}")
    axes.locator_params(axis="x", nbins=6)
    axes.grid(color=_RULE, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(which="both", length=0, labelcolor=_SOFT, pad=5)
    axes.set_xlabel(label, color=_SOFT, labelpad=5)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(_SOFT)
    low, high = sorted(axes.get_ylim())
    ticks = [axes.yaxis.get_major_formatter()(tick) for tick in axes.get_yticks() if low <= tick <= high]
    left = 10 + _LETTER * max(map(len, ticks), default=0)
    box = left / _WIDTH, _BOTTOM / _HEIGHT, 1 - (left + _RIGHT) / _WIDTH, 1 - (_BOTTOM + _TOP) / _HEIGHT
    axes.set_position(box)


def _for_page(svg: str, name: str, key: str, size: tuple[int, int]) -> str:
    """Prepare an SVG of matplotlib for the page: CSS variables, a class for each row, short paths, unique ids."""
    text = svg[svg.index("<g ") : svg.rindex("</g>") + len("</g>")]
    text = re.sub(r'<g id="row-(\d+)\|([^"]*)">', r'<g class="row-\1"><title>\2</title>', text)
    text = re.sub(r"<[^>]*>", lambda tag: _short_tag(tag[0], key), text)  # tags only: text may hold any name
    text = re.sub(r">\s+<", "><", text)
    while "<g></g>" in text:
        text = text.replace("<g></g>", "")
    box = f"0 0 {size[0]} {size[1]}"
    return f'<svg class="chart" viewBox="{box}" role="img" aria-label="{printable_html(name)}">{text}</svg>'


def _short_tag(tag: str, key: str) -> str:
    if re.fullmatch(r'<g id="[^"]*"\s*/?>', tag):
        return "" if tag.endswith("/>") else "<g>"
    tag = re.sub(r'\s+(clip-path|transform)="(url|rotate\(-0 )[^"]*"', "", tag)
    tag = re.sub(r'(\bid="|href="#)', rf"\g<1>{key}-", tag)
    tag = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font: \1 var(--font)", tag)
    tag = re.sub(r"font-family: [^;\"]*", "font-family: var(--font)", tag)
    tag = re.sub(r"#010[12]0\d", lambda colour: _VARIABLES.get(colour[0], colour[0]), tag)
    tag = re.sub(r'\bd="([^"]*)"', lambda path: f'd="{_short_path(path[1])}"', tag)
    return re.sub(r"\d+\.\d{3,}", lambda number: f"{float(number[0]):.1f}", tag)


def _short_path(path: str) -> str:
    """Write the lines of a path as differences of coordinates in tenths of a pixel; other paths stay."""
    parts = re.findall(r"([A-Za-z])([^A-Za-z]*)", path)
    if not {command for command, _ in parts} <= {"M", "L", "z"}:
        return " ".join(path.split())
    written, last = [], (0, 0)
    for command, numbers in parts:
        if command == "z":
            written.append("z")
            continue
        x, y = (round(10 * float(number)) for number in numbers.split())
        across, down = (x, y) if command == "M" else (x - last[0], y - last[1])
        written.append(f"{command if command == 'M' else 'l'}{across / 10:g} {down / 10:g}")
        last = x, y
    return "".join(written)
