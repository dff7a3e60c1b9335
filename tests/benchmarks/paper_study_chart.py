"""The chart of the study of Table 1: the order of the schemes at every point, and what it depends on."""

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from meshfit.report.figures.colours import INK
from meshfit.report.figures.layout import DPI, STYLE, add_legend_above, write_drawing
from tests.benchmarks.paper_study_data import EXACT, FRAME, Point, paper

SAME_SOURCES = ("icosphere", "ellipsoid")
"""Kinds of initial mesh of which both schemes make the same source, but for the places of vertices in it."""
_OWN, _SAME, _PAPER = "#0072b2", "#b4bec7", "#d55e00"
_TARGETS = {"bunny": (0, 1), "mousehead": (2, 3)}
_SIZE, _FONT, _MOST = (7.4, 3.5), 8.0, 8.0
_TICKS = (1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8)
_LABELS = {1 / 8: "⅛", 1 / 4: "¼", 1 / 2: "½"}


def ratios(point: Point, target: str, measure: str = EXACT) -> float:
    """Return the distance of interpolatory Loop over that of Loop."""
    loop, interpolatory = _TARGETS[target]
    distances = point.distances[measure, FRAME]
    return distances[interpolatory] / distances[loop]


def size_advantage(point: Point, target: str) -> float:
    """Return how much nearer Loop's source is to the target in size: above 1 if it is the nearer.

    It is the factor by which the size of interpolatory Loop's source differs from the target's, over that of Loop's.
    """
    loop, interpolatory = _TARGETS[target]
    return math.exp(abs(math.log(point.sizes[interpolatory])) - abs(math.log(point.sizes[loop])))


def write_chart(points: Sequence[Point], path: Path) -> None:
    """Draw both panels, and write them."""
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter missing from every font is drawn as a box
        figure = Figure(figsize=_SIZE, facecolor="white")
        left, right = figure.add_axes((0.085, 0.135, 0.4, 0.76)), figure.add_axes((0.575, 0.135, 0.4, 0.76))
        _draw_orders(left, points)
        _draw_sizes(right, points)
        handles = [
            Line2D([], [], label="settings, each scheme with a source of its own", **_mark(_OWN)),
            Line2D([], [], label="with the same source", **_mark(_SAME)),
            Line2D([], [], label="the paper, by column and by row", **_mark(_PAPER, "*", 9)),
        ]
        add_legend_above(figure, handles, _FONT)
        write_drawing(figure, path, DPI[path.suffix])


def _draw_orders(axes: Any, points: Sequence[Point]) -> None:
    axes.axvspan(1, _MOST * 2, 0, 0.5, color="#fbe7da", linewidth=0, zorder=0)
    for same in (True, False):
        chosen = [point for point in points if (point.source in SAME_SOURCES) is same]
        at = [[_clipped(ratios(point, target)) for point in chosen] for target in _TARGETS]
        axes.plot(*at, **_mark(_SAME if same else _OWN), zorder=2)
    for reading in ("by column", "by row"):
        values = paper(reading)
        axes.plot(values[1] / values[0], values[3] / values[2], **_mark(_PAPER, "*", 10), zorder=3)
        axes.annotate(
            reading,
            (values[1] / values[0], values[3] / values[2]),
            (5, -8),
            textcoords="offset points",
            fontsize=_FONT - 1,
            color=_PAPER,
        )
    _set_axis(axes, "x", "bunny: distance with interpolatory Loop / with Loop")
    _set_axis(axes, "y", "mousehead: the same ratio")
    corners = {
        (0.02, 0.97): "interp. ahead on the bunny,\nLoop on the mousehead",
        (0.98, 0.97): "Loop ahead on both",
        (0.02, 0.03): "interp. ahead on both",
        (0.98, 0.03): "the paper's order",
    }
    for (x, y), text in corners.items():
        axes.text(
            x,
            y,
            text,
            transform=axes.transAxes,
            fontsize=_FONT - 1,
            color=INK,
            ha="left" if x < 0.5 else "right",
            va="bottom" if y < 0.5 else "top",
        )


def _draw_sizes(axes: Any, points: Sequence[Point]) -> None:
    for same in (True, False):
        chosen = [point for point in points if (point.source in SAME_SOURCES) is same]
        for target in _TARGETS:
            at = (
                [_clipped(size_advantage(point, target)) for point in chosen],
                [_clipped(ratios(point, target)) for point in chosen],
            )
            axes.plot(*at, **_mark(_SAME if same else _OWN), zorder=2)
    _set_axis(axes, "x", "how much nearer Loop's source is in size")
    _set_axis(axes, "y", "distance with interpolatory Loop / with Loop")
    axes.text(
        0.98, 0.97, "Loop nearer in size,\nand ahead", transform=axes.transAxes, fontsize=_FONT - 1, color=INK,
        ha="right", va="top",
    )  # fmt: skip
    axes.text(
        0.02, 0.03, "interp. nearer in size,\nand ahead", transform=axes.transAxes, fontsize=_FONT - 1, color=INK,
        ha="left", va="bottom",
    )  # fmt: skip


def _set_axis(axes: Any, which: str, label: str) -> None:
    getattr(axes, f"set_{which}scale")("log")
    getattr(axes, f"set_{which}lim")(1 / _MOST / 1.12, _MOST * 1.12)
    getattr(axes, f"set_{which}label")(label, fontsize=_FONT, color=INK, labelpad=2)
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(FixedLocator(_TICKS))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _LABELS.get(value, f"{value:g}")))
    axis.set_minor_formatter(NullFormatter())
    axis.set_minor_locator(FixedLocator([]))
    axes.tick_params(axis=which, labelsize=_FONT, length=2, width=0.5, colors=INK)
    (axes.axvline if which == "x" else axes.axhline)(1, color=INK, linewidth=0.5, zorder=1)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _clipped(ratio: float) -> float:
    """Return a ratio, or the end of the axis if it is beyond."""
    return min(max(ratio, 1 / _MOST), _MOST)


def _mark(colour: str, shape: str = "o", size: float = 3.2) -> dict[str, Any]:
    return {"color": colour, "marker": shape, "markersize": size, "linestyle": "none", "markeredgewidth": 0}
