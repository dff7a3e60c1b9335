"""The chart of result tables: schemes down, values across, one mark per target, one panel per table."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, isfinite, log
from pathlib import Path
from statistics import fmean
from typing import Any

from meshfit.errors import ConfigError
from meshfit.optional import import_optional
from meshfit.report.figures.colours import INK
from meshfit.report.figures.layout import DPI, STYLE, add_legend_above, set_log_ticks, write_drawing
from meshfit.report.tables.table import Table
from meshfit.specs import parse_spec
from meshfit.subdivision.registry import SCHEMES

# Okabe and Ito (2008): distinguishable by the colour-blind; shapes differ too.
_ROOM = 1.04  # between the end of an interval and that of the axis
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
_SHAPES = ("o", "s", "^", "D", "v", "P")
_WIDTH, _ROW, _MARGIN, _HEAD, _FONT = 7.0, 0.19, 1.55, 0.55, 8.0
_FOOT = 0.45
_MEAN = "#7d8a96"


@dataclass(frozen=True)
class _Line:
    """A line of every panel: a scheme, or the heading of a kind of schemes."""

    text: str
    scheme: str | None


def write_chart(tables: Sequence[Table], path: Path) -> None:
    """Draw the chart and write it.

    Marks are means over the seeds. Bars are geometric means over the targets, so that a factor counts the same on an
    easy target as on a hard one.

    Args:
        tables: tables of one metric, drawn as panels side by side.
        path: .png, .pdf or .svg.

    Raises:
        ConfigError: a value is not above 0, a library is not installed, or the file cannot be written.
    """
    matplotlib, figures = import_optional("matplotlib"), import_optional("matplotlib.figure")
    metric = tables[0].metrics[0]
    if not all(value > 0 and isfinite(value) for table in tables for value in _means(table).values()):
        raise ConfigError(f"{metric}: a chart has a logarithmic scale, and some of the values are not above 0")
    lines = _lines(tables)
    high = _HEAD + _FOOT + _ROW * len(lines)
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter missing from every font is drawn as a box
        figure = figures.Figure(figsize=(_WIDTH, high), facecolor="white")
        across = (_WIDTH - _MARGIN) / len(tables)
        for place, table in enumerate(tables):
            box = (
                (_MARGIN + place * across) / _WIDTH,
                _FOOT / high,
                (across - 0.12) / _WIDTH,
                1 - (_HEAD + _FOOT) / high,
            )
            _draw_panel(figure.add_axes(box), table, lines, names=place == 0)
        _add_legend(figure, tables)
        write_drawing(figure, path, DPI[path.suffix.lower()])


def geometric_means(table: Table) -> dict[str, float]:
    """Return the geometric mean over several targets of each scheme that has results on all of them."""
    means = _means(table)
    values_of = {scheme: [means.get((target, scheme)) for target in table.targets] for scheme in table.schemes}
    whole = {scheme: [value for value in values if value is not None] for scheme, values in values_of.items()}
    return {
        scheme: exp(fmean(log(value) for value in values))
        for scheme, values in whole.items()
        if len(values) == len(table.targets) > 1
    }


def _lines(tables: Sequence[Table]) -> list[_Line]:
    """The schemes of all tables, each under the heading of its kind."""
    schemes = list(dict.fromkeys(scheme for table in tables for scheme in table.schemes))
    lines = []
    for kind in ("approximating", "interpolatory", "custom"):
        members = [scheme for scheme in schemes if _kind(scheme) == kind]
        if members:
            lines += [_Line(kind, None), *(_Line(tables[0].scheme_title(scheme), scheme) for scheme in members)]
    return lines


def _kind(scheme: str) -> str:
    # A blank separates a spec from the note that distinguishes several definitions of one name.
    if scheme.partition(" ")[0].partition(":")[0] not in SCHEMES:
        return "custom"
    spec = parse_spec(scheme)
    alpha = dict(spec.parameters).get("alpha", 1.0)
    return SCHEMES[spec.name].kind if alpha == 1 else "approximating"


def _means(table: Table) -> Mapping[tuple[str, str], float]:
    return {(target, row.scheme): summary.mean for (_, target, row), summary in table.cells.items()}


def _draw_panel(axes: Any, table: Table, lines: Sequence[_Line], *, names: bool) -> None:  # noqa: ANN401
    means, middles = _means(table), geometric_means(table)
    for row, line in enumerate(lines):
        values = {
            target: means[target, line.scheme or ""] for target in table.targets if (target, line.scheme) in means
        }
        if not values:
            continue
        axes.axhline(row, color="#e4e8ec", linewidth=0.5, zorder=0)
        middle = middles.get(line.scheme or "")
        if middle is not None:
            axes.plot([middle, middle], [row - 0.4, row + 0.4], color=_MEAN, linewidth=2.2, zorder=1)
        for place, target in enumerate(table.targets):
            if target in values:
                axes.plot(values[target], row, **_mark(place), zorder=3)
    axes.set_xscale("log")
    _draw_intervals(axes, table, lines)
    set_log_ticks(axes.xaxis)
    axes.set_ylim(len(lines) - 0.4, -0.6)
    axes.set_yticks(range(len(lines)), [line.text if names else "" for line in lines], fontsize=_FONT, color=INK)
    for label, line in zip(axes.get_yticklabels(), lines, strict=True):
        label.set_fontstyle("normal" if line.scheme else "italic")
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", which="both", labelsize=_FONT, length=2, width=0.5, colors=INK)
    axes.set_xlabel(table.metric_title(table.metrics[0]), fontsize=_FONT, color=INK, labelpad=2)
    axes.set_title(table.style.label(table.variations[0].variant) or table.title, fontsize=_FONT + 1, color=INK, pad=4)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)


def _draw_intervals(axes: Any, table: Table, lines: Sequence[_Line]) -> None:  # noqa: ANN401
    """Draw the 95 % interval of each mean; one that includes 0 runs off the logarithmic axis."""
    rows = {line.scheme: row for row, line in enumerate(lines) if line.scheme}
    intervals = [
        (rows[row.scheme], list(table.targets).index(target), *summary.interval)
        for (_, target, row), summary in table.cells.items()
        if summary.interval is not None
    ]
    ends = [end for *_, low, high in intervals for end in (low, high) if end > 0]
    left, right = axes.get_xlim()
    left, right = min([left, *(end / _ROOM for end in ends)]), max([right, *(end * _ROOM for end in ends)])
    for row, place, low, high in intervals:
        colour = _COLOURS[place % len(_COLOURS)]
        axes.plot([max(low, left), high], [row, row], color=colour, linewidth=1.0, solid_capstyle="butt", zorder=2)
        for end in (low, high):
            if end > 0:
                axes.plot([end, end], [row - 0.14, row + 0.14], color=colour, linewidth=0.8, zorder=2)
    axes.set_xlim(left, right)


def _mark(place: int) -> dict[str, object]:
    colour, shape = _COLOURS[place % len(_COLOURS)], _SHAPES[place % len(_SHAPES)]
    return {"color": colour, "marker": shape, "markersize": 4, "linestyle": "none", "markeredgewidth": 0}


def _add_legend(figure: Any, tables: Sequence[Table]) -> None:  # noqa: ANN401  matplotlib is optional
    line = import_optional("matplotlib.lines").Line2D
    titles = tables[0].targets
    handles = [line([], [], label=title, **_mark(place)) for place, title in enumerate(titles.values())]
    if len(titles) > 1:
        handles.append(line([], [], color=_MEAN, linewidth=2.2, label="geometric mean"))
    add_legend_above(figure, handles, _FONT)
