"""The chart of sensitivity: settings down, one panel per target, Sobol' indices or rank correlations across."""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from meshfit.optional import import_optional
from meshfit.report.figures.colours import INK
from meshfit.report.figures.layout import DPI, STYLE, add_legend_above, write_drawing
from meshfit.report.tables.sensitivity import Sensitivity
from meshfit.sensitivity import Analysis, Effect, Estimate

MOST_PANELS = 5
_TOTAL, _FIRST, _LINE = "#a9cbe4", "#0072b2", "#e4e8ec"
_MOVES, _STILL = "#0072b2", "#9aa5af"
_WIDTH, _ROW, _HEAD, _FOOT, _FONT = 7.0, 0.27, 0.5, 0.5, 8.0
_BETWEEN = 0.3  # panels
_REACHES = (0.2, 0.4, 0.6, 0.8)
_LETTER = 0.062  # inches of a letter of a name


def write_sensitivity_chart(sensitivity: Sensitivity, path: Path) -> None:
    """Draw the chart and write it.

    Bars are total indices, with the first-order ones inside them. If some target has none, marks are rank correlations,
    or shares of the variance of ranks for categories. Lines are 95 % intervals. The first targets are drawn.

    Args:
        sensitivity: the sensitivity.
        path: .png, .pdf or .svg.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    matplotlib, figures = import_optional("matplotlib"), import_optional("matplotlib.figure")
    groups = dict(list(sensitivity.groups.items())[:MOST_PANELS])
    names = list(dict.fromkeys(effect.factor.name for each in groups.values() for effect in each.effects))
    shares = all(not analysis.why_not for analysis in groups.values())
    high = _HEAD + _FOOT + _ROW * len(names)
    margin = min(2.6, 0.25 + _LETTER * max(map(len, names)))
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter missing from every font is drawn as a box
        figure = figures.Figure(figsize=(_WIDTH, high), facecolor="white")
        reach = _reach(groups.values(), shares=shares)
        across = (_WIDTH - margin + _BETWEEN - 0.12) / len(groups)
        for place, (title, analysis) in enumerate(groups.items()):
            box = (
                (margin + place * across) / _WIDTH,
                _FOOT / high,
                (across - _BETWEEN) / _WIDTH,
                1 - (_HEAD + _FOOT) / high,
            )
            axes = figure.add_axes(box)
            _draw_panel(axes, analysis, names, reach, shares=shares)
            axes.set_title(title, fontsize=_FONT + 1, color=INK, pad=4)
            axes.set_yticks(range(len(names)), names if place == 0 else [""] * len(names), fontsize=_FONT, color=INK)
        _add_legend(figure, sensitivity, shares=shares)
        write_drawing(figure, path, DPI[path.suffix.lower()])


def _draw_panel(axes: Any, analysis: Analysis, names: list[str], reach: float, *, shares: bool) -> None:  # noqa: ANN401
    effects = {effect.factor.name: effect for effect in analysis.effects}
    for row, name in enumerate(names):
        axes.axhline(row, color=_LINE, linewidth=0.5, zorder=0)
        if name in effects:
            (_draw_shares if shares else _draw_rank)(axes, row, effects[name])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(0 if shares else -reach, reach)
    ticks = [0, reach / 2, reach] if shares else [-reach, 0, reach]
    axes.set_xticks(ticks, [f"{tick:g}".replace("-", "−") for tick in ticks])
    if not shares:
        axes.axvline(0, color=INK, linewidth=0.5, zorder=1)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=_FONT, length=2, width=0.5, colors=INK)
    label = "share of the variance" if shares else "rank correlation"
    axes.set_xlabel(label, fontsize=_FONT, color=INK, labelpad=2)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)


def _reach(groups: Iterable[Analysis], *, shares: bool) -> float:
    """Return the end of the axes, at which all intervals end."""
    effects = [effect for analysis in groups for effect in analysis.effects]
    totals = [effect.total.high for effect in effects if effect.total is not None]
    ranks = [abs(end) for effect in effects for end in (effect.rank.low, effect.rank.high)]
    largest = max(totals if shares else ranks, default=1.0)
    return next((end for end in _REACHES if end >= largest), 1.0)


def _draw_shares(axes: Any, row: int, effect: Effect) -> None:  # noqa: ANN401
    if effect.first is None or effect.total is None:
        return
    axes.barh(row, effect.total.value, height=0.62, color=_TOTAL, zorder=1)
    axes.barh(row, min(effect.first.value, effect.total.value), height=0.62, color=_FIRST, zorder=2)
    _draw_interval(axes, row, effect.total, INK)


def _draw_rank(axes: Any, row: int, effect: Effect) -> None:  # noqa: ANN401
    colour = _MOVES if effect.moves else _STILL
    _draw_interval(axes, row, effect.rank, colour)
    shape = "s" if effect.factor.categories else "o"
    axes.plot(effect.rank.value, row, marker=shape, markersize=4, color=colour, markeredgewidth=0, zorder=4)


def _draw_interval(axes: Any, row: int, estimate: Estimate, colour: str) -> None:  # noqa: ANN401
    axes.plot([estimate.low, estimate.high], [row, row], color=colour, linewidth=0.9, solid_capstyle="butt", zorder=3)


def _add_legend(figure: Any, sensitivity: Sensitivity, *, shares: bool) -> None:  # noqa: ANN401
    line, patch = import_optional("matplotlib.lines").Line2D, import_optional("matplotlib.patches").Patch
    of = f"{sensitivity.metric} against {sensitivity.compared}" if sensitivity.compared else sensitivity.metric
    if shares:
        handles = [
            patch(color=_FIRST, label=f"{of}, alone (first-order)"),
            patch(color=_TOTAL, label="with interactions (total)"),
            line([], [], color=INK, linewidth=0.9, label="95 % interval of the total"),
        ]
    else:
        mark = {"linestyle": "none", "markeredgewidth": 0, "markersize": 4}
        handles = [
            line([], [], marker="o", color=_MOVES, label=f"{of}, Spearman's ρ", **mark),
            line([], [], marker="s", color=_MOVES, label="η² of categories", **mark),
            line([], [], marker="o", color=_STILL, label="not significant", **mark),
        ]
    add_legend_above(figure, handles, _FONT)
