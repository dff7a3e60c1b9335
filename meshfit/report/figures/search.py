"""The chart of a search: the best value so far or the Pareto front, then the values by each setting."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from meshfit.config.sweep_samples import limits
from meshfit.config.sweeps import short_names, value_text
from meshfit.errors import ConfigError
from meshfit.experiment.tuning.objectives import Objective
from meshfit.experiment.tuning.search_file import OWN, Point, Search
from meshfit.measuring.metrics import METRICS
from meshfit.optional import import_optional
from meshfit.report.figures.colours import INK
from meshfit.report.figures.layout import DPI, LETTER, STYLE, set_log_ticks, write_drawing
from meshfit.report.tables.search import value_texts

_LOG_RATIO = 3.0  # of the largest to the smallest value, above which an axis is logarithmic
_USUAL, _FAR = 0.9, 10.0  # a quantile, and how many times larger a value is that is drawn at the edge
_ACROSS = 4  # panels of settings side by side
_MOST_NUMBERED = 12  # points of a front


@dataclass(frozen=True)
class SearchStyle:
    """Sizes and colours of the chart; lengths are in inches, or multiples of the font size where so called.

    Attributes:
        width: width of the chart.
        font: font size in points.
        ink: colour of text.
        rule: colour of lines behind the points.
        point: colour of points.
        best: colour of the best ones.
        own: colour of the config's own settings.
        failed: colour of failed points.
        labels: names to print for metrics and settings.
    """

    width: float = 7.0
    font: float = 8.0
    ink: str = INK
    rule: str = "#e4e8ec"
    point: str = "#8fb4d3"
    best: str = "#0072b2"
    own: str = "#d55e00"
    failed: str = "#b3261e"
    labels: Mapping[str, str] = field(default_factory=dict)

    @property
    def line(self) -> float:
        """Height of a line of text."""
        return 1.3 * self.font / 72


def write_search_chart(searches: Mapping[str, Search], path: Path, labels: Mapping[str, str] | None = None) -> None:
    """Draw searches below each other and write them.

    Args:
        searches: the searches, each with a complete point, by title.
        path: .png, .pdf or .svg.
        labels: names to print for metrics and settings.

    Raises:
        ConfigError: a search has no complete point, matplotlib is not installed, or the file cannot be written.
    """
    matplotlib, figures = import_optional("matplotlib"), import_optional("matplotlib.figure")
    for title, search in searches.items():
        if not search.complete:
            raise ConfigError(f"{title}: none of its points is complete, so there is nothing to draw")
    style = SearchStyle(labels=labels or {})
    heights = [search_height(search, style) for search in searches.values()]
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter missing from every font is drawn as a box
        figure = figures.Figure(figsize=(style.width, sum(heights)), facecolor="white")
        top = sum(heights)
        for (title, search), height in zip(searches.items(), heights, strict=True):
            draw_search(figure, search, style, top, title if len(searches) > 1 else "")
            top -= height
        write_drawing(figure, path, DPI[path.suffix.lower()])


def search_height(search: Search, style: SearchStyle) -> float:
    """Return the height of a chart in inches."""
    rows = math.ceil(len(search.ranges) / _ACROSS)
    return _history_height(style) + rows * _setting_height(style)


def draw_search(figure: Any, search: Search, style: SearchStyle, top: float, title: str = "") -> None:  # noqa: ANN401
    """Draw a search on a matplotlib figure, below a height in inches."""
    _Drawing(figure, search, style).draw(top, title)


def _history_height(style: SearchStyle) -> float:
    return 0.3 * style.width + 6.0 * style.line


def _setting_height(style: SearchStyle) -> float:
    return 0.12 * style.width + 3.6 * style.line


@dataclass(frozen=True)
class _Drawing:
    """A search, and the figure and style that it is drawn with."""

    figure: Any
    search: Search
    style: SearchStyle

    def draw(self, top: float, title: str) -> None:
        style, several = self.style, len(self.search.objectives) > 1
        left, right, line = 4.6 * style.font * 0.6 / 72 + 2.2 * style.line, 1.2 * style.line, style.line
        if title:
            self._text(style.width / 2, top - 0.9 * line, title, size=style.font + 1)
        self._add_legend(top - 1.3 * line)
        high = _history_height(style) - 6.0 * line
        bottom = top - 3.4 * line - high
        pairs = list(enumerate(self.search.objectives))[1:] if several else [(0, self.search.objectives[0])]
        across = (style.width - left - right) / len(pairs)
        for place, (number, _) in enumerate(pairs):
            gap = left if place < len(pairs) - 1 else 0.0
            axes = self._axes(left + place * across, bottom, across - gap, high)
            self._draw_front(axes, number) if several else self._draw_history(axes)
        columns = min(_ACROSS, len(self.search.ranges))
        gap = 1.2 * line
        across = (style.width - left - right + gap) / columns
        top -= _history_height(style)
        names = short_names(list(self.search.ranges))
        for place, (key, values) in enumerate(self.search.ranges.items()):
            row, column = divmod(place, columns)
            high = _setting_height(style) - 3.6 * line
            below = top - row * _setting_height(style) - 1.4 * line - high
            axes = self._axes(left + column * across, below, across - gap, high)
            self._draw_setting(axes, key, values, style.labels.get(key, names[key]), is_first=column == 0)

    # The history of one metric.

    def _draw_history(self, axes: Any) -> None:  # noqa: ANN401  matplotlib is optional
        search, style, objective = self.search, self.style, self.search.objectives[0]
        values = {i + 1: search.points[i].values[0] for i in search.complete}
        self._plot(axes, list(values), list(values.values()), (None, self._bound(0)))
        bound = self._bound(0) or math.inf
        numbers, best = best_so_far(search)
        best = [min(value, bound) for value in best]
        axes.plot([*numbers, self._last], [*best, best[-1]], color=style.best, linewidth=1.1, drawstyle="steps-post")
        number = search.best[0] + 1
        axes.plot([number], [best[-1]], **self._mark(style.best, larger=True), zorder=4)
        self._draw_own_line(axes)
        if (design := sum(point.batch == 0 for point in search.points)) < self._last:
            axes.axvline(design + 0.5, color=style.rule, linewidth=1.0, zorder=0)
            for text, side, away in (("spread evenly", "right", -1), ("searched", "left", 1)):
                axes.annotate(
                    text,
                    (design + 0.5, 1.0),
                    (away * 0.5 * style.font, 0.1 * style.font),
                    xycoords=axes.get_xaxis_transform(),
                    textcoords="offset points",
                    ha=side,
                    va="bottom",
                    fontsize=style.font - 1,
                    color=style.ink,
                )
        axes.set_xlim(0.5 - 0.01 * self._last, self._last + 0.5 + 0.01 * self._last)
        own = search.own.values[:1]
        self._set_value_axis(axes, "y", 0, [*values.values(), *own])
        self._draw_failed(axes, objective)
        axes.xaxis.set_major_locator(import_optional("matplotlib.ticker").MaxNLocator(8, integer=True, min_n_ticks=1))
        self._set_frame(axes)
        axes.set_xlabel("point", **self._label)
        axes.set_ylabel(self._title(objective), **self._label)

    @property
    def _last(self) -> int:
        """The number of the last point that was tried."""
        return max([*self.search.complete, *self.search.failed]) + 1

    def _draw_own_line(self, axes: Any) -> None:  # noqa: ANN401  matplotlib is optional
        if self.search.own.values:
            axes.axhline(
                self.search.own.values[0], color=self.style.own, linewidth=0.9, linestyle=(0, (4, 2)), zorder=1
            )

    def _draw_failed(self, axes: Any, objective: Objective) -> None:  # noqa: ANN401  matplotlib is optional
        """Draw failed points beyond the worst value."""
        if not self.search.failed:
            return
        low, high = axes.get_ylim()
        share = 0.09
        room = (high / low) ** share if axes.get_yscale() == "log" else share * (high - low)
        if axes.get_yscale() == "log":
            low, high = (low / room, high) if objective.maximise else (low, high * room)
        else:
            low, high = (low - room, high) if objective.maximise else (low, high + room)
        axes.set_ylim(low, high)
        place = 0.04 if objective.maximise else 0.96
        numbers = [i + 1 for i in self.search.failed]
        mark = self._mark(self.style.failed) | {"marker": "x", "markeredgewidth": 0.9}
        axes.plot(numbers, [place] * len(numbers), transform=axes.get_xaxis_transform(), **mark, zorder=3)

    # The front of several metrics.

    def _draw_front(self, axes: Any, second: int) -> None:  # noqa: ANN401  matplotlib is optional
        search, style, pair = self.search, self.style, (self.search.objectives[0], self.search.objectives[second])
        front = set(search.best)
        others = [search.points[i] for i in search.complete if i not in front]
        ordered = sorted(front, key=lambda i: search.points[i].values[0])
        self._plot(axes, *_columns(others, second), (self._bound(0), self._bound(second)))
        best = _columns([search.points[i] for i in ordered], second)
        if len(search.objectives) == 2:
            # The steps bound what the front dominates.
            steps = "steps-pre" if pair[0].maximise else "steps-post"
            axes.plot(*best, color=style.best, linewidth=0.9, drawstyle=steps, zorder=3)
        axes.plot(*best, **self._mark(style.best, larger=True), zorder=4)
        if search.own.values:
            bounds = self._bound(0) or math.inf, self._bound(second) or math.inf
            place = min(search.own.values[0], bounds[0]), min(search.own.values[second], bounds[1])
            axes.plot(*place, **self._mark(style.own, larger=True) | {"marker": "D"}, zorder=5)
        points = [*others, *(search.points[i] for i in ordered), *([search.own] if search.own.values else [])]
        self._set_value_axis(axes, "x", 0, [point.values[0] for point in points])
        self._set_value_axis(axes, "y", second, [point.values[second] for point in points])
        if len(ordered) <= _MOST_NUMBERED:
            for i in ordered:
                place = search.points[i].values[0], search.points[i].values[second]
                axes.annotate(
                    str(i + 1),
                    place,
                    (0.45 * style.font, 0.4 * style.font),
                    textcoords="offset points",
                    fontsize=style.font - 1,
                    color=style.ink,
                )
        self._set_frame(axes)
        axes.set_xlabel(self._title(pair[0]), **self._label)
        axes.set_ylabel(self._title(pair[1]), **self._label)

    # The settings.

    def _draw_setting(self, axes: Any, key: str, values: Any, name: str, *, is_first: bool) -> None:  # noqa: ANN401
        """Draw the first metric by the values of a setting, with that of the best point in the title."""
        search, style, objective = self.search, self.style, self.search.objectives[0]
        best = search.best
        others = [i for i in search.complete if i not in set(best)]
        places = self._places(axes, key, values)
        values_of = {i: search.points[i].values[0] for i in search.complete}
        self._plot(axes, [places[i] for i in others], [values_of[i] for i in others], (None, self._bound(0)))
        mark = self._mark(style.best, larger=True)
        axes.plot([places[i] for i in best], [values_of[i] for i in best], **mark, zorder=3)
        self._set_value_axis(axes, "y", 0, list(values_of.values()), small=True)
        self._set_frame(axes)
        if not is_first:
            axes.set_yticklabels([])
        elif len(search.objectives) > 1:
            axes.set_ylabel(self._name(objective), **self._label)
        title = name
        if len(search.objectives) == 1:
            title = f"{name} = {_short(value_text(search.points[best[0]].changes[key], _listed(values)), 20)}"
        axes.set_title(title, fontsize=style.font, color=style.ink, pad=0.35 * style.font)

    def _places(self, axes: Any, key: str, values: Any) -> dict[int, float]:  # noqa: ANN401  matplotlib is optional
        """Prepare the axis of a setting, and return the place of each complete point on it."""
        points = {i: self.search.points[i].changes[key] for i in self.search.complete}
        if isinstance(values, list):
            texts = [value_text(value, values) for value in values]
            width = axes.get_position().width * self.style.width / len(values)
            texts = _choices(texts, int(width / (LETTER * self.style.font / 72)) - 1)
            axes.set_xticks(range(len(texts)), texts)
            axes.set_xlim(-0.5, len(values) - 0.5)
            return {i: values.index(value) for i, value in points.items()}
        low, high, is_log, _ = limits(values)
        if is_log:
            axes.set_xscale("log")
            axes.set_xlim(low / (high / low) ** 0.04, high * (high / low) ** 0.04)
        else:
            axes.set_xlim(low - 0.04 * (high - low), high + 0.04 * (high - low))
        ticks = [low, high]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        for label, side in zip(axes.get_xticklabels(), ("left", "right"), strict=True):
            label.set_horizontalalignment(side)
        axes.set_xticks([], minor=True)
        return {i: float(value) for i, value in points.items()}

    # Parts of every panel.

    def _bound(self, number: int) -> float | None:
        """Return the largest value of an objective that is drawn at its place; None if all are.

        Fits that nearly diverged would leave no room for the others.
        """
        objective = self.search.objectives[number]
        values = [point.values[number] for point in (*self.search.points, self.search.own) if point.values]
        usual = float(np.quantile(values, _USUAL))
        is_far = max(values) > _FAR * usual > 0 and objective.is_geometric and not objective.maximise
        return _LOG_RATIO * usual if is_far else None

    def _plot(
        self,
        axes: Any,  # noqa: ANN401  matplotlib is optional
        x: Sequence[float],
        y: Sequence[float],
        bounds: tuple[float | None, float | None],
    ) -> None:
        """Draw points that are not the best; an arrow at the edge stands for one that lies beyond it."""
        limits_of = [math.inf if bound is None else bound for bound in bounds]
        places = [
            (a, b, ">" if a > limits_of[0] else "^" if b > limits_of[1] else "o") for a, b in zip(x, y, strict=True)
        ]
        for marker in ("o", "^", ">"):
            of_kind = [(min(a, limits_of[0]), min(b, limits_of[1])) for a, b, kind in places if kind == marker]
            mark = self._mark(self.style.point) | {"marker": marker}
            axes.plot([a for a, _ in of_kind], [b for _, b in of_kind], **mark, zorder=2)

    def _set_value_axis(
        self,
        axes: Any,  # noqa: ANN401  matplotlib is optional
        name: str,
        number: int,
        values: Sequence[float],
        *,
        small: bool = False,
    ) -> None:
        """Set the limits, scale and ticks of an axis with values of an objective."""
        objective, bound = self.search.objectives[number], self._bound(number)
        low, high, share = min(values), max(values), 0.12 if small else 0.06
        high = high if bound is None else min(high, bound)
        axis = axes.xaxis if name == "x" else axes.yaxis
        set_limits = axes.set_xlim if name == "x" else axes.set_ylim
        if low > 0 and high > _LOG_RATIO * low and (objective.is_geometric or METRICS[objective.metric].whole):
            (axes.set_xscale if name == "x" else axes.set_yscale)("log")
            room = (high / low) ** share
            set_limits(low / room, high * room)
            set_log_ticks(axis)
        else:
            room = share * (high - low) or 0.1 * abs(high) or 1.0
            set_limits(low - room, high + room)
            axis.set_major_locator(import_optional("matplotlib.ticker").MaxNLocator(3 if small else 5))

    def _set_frame(self, axes: Any) -> None:  # noqa: ANN401  matplotlib is optional
        axes.grid(color=self.style.rule, linewidth=0.5, axis="y", zorder=0)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=self.style.font, length=2, width=0.5, colors=self.style.ink, pad=2)
        axes.tick_params(which="minor", length=0)
        axes.patch.set_visible(False)
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
        axes.spines["bottom"].set_color(self.style.ink)

    def _add_legend(self, top: float) -> None:
        search, style = self.search, self.style
        line = import_optional("matplotlib.lines").Line2D
        several = len(search.objectives) > 1
        handles = [line([], [], label="point", **self._mark(style.point))]
        if several:
            handles.append(line([], [], label="Pareto front", **self._mark(style.best, larger=True)))
        else:
            best = search.points[search.best[0]]
            label = f"best so far: {value_texts(search, best)[0]} at point {search.best[0] + 1}"
            mark = self._mark(style.best, larger=True) | {"linestyle": "-", "linewidth": 1.1}
            handles.append(line([], [], label=label, **mark))
        if search.own.values:
            label = f"{OWN}: {', '.join(value_texts(search, search.own))}"
            mark = self._mark(style.own, larger=True) | {"marker": "D"}
            dashes = {"color": style.own, "linewidth": 0.9, "linestyle": (0, (4, 2))}
            handles.append(line([], [], label=label, **(mark if several else dashes)))
        if search.failed:
            mark = self._mark(style.failed) | {"marker": "x", "markeredgewidth": 0.9}
            label = f"{len(search.failed)} failed{' (not drawn)' if several else ''}"
            handles.append(line([], [], label=label, **mark))
        self.figure.legend(
            handles=handles,
            loc="upper center",
            bbox_to_anchor=(0.5, top / self.figure.get_figheight()),
            borderaxespad=0.0,
            ncols=len(handles),
            fontsize=style.font,
            frameon=False,
            labelcolor=style.ink,
            handlelength=1.4,
            handletextpad=0.4,
            columnspacing=1.2,
        )

    def _mark(self, colour: str, *, larger: bool = False) -> dict[str, Any]:
        size = 0.42 if len(self.search.points) <= 150 else 0.3
        size = self.style.font * (0.62 if larger else size)
        return {"color": colour, "marker": "o", "markersize": size, "linestyle": "none", "markeredgewidth": 0}

    @property
    def _label(self) -> dict[str, Any]:
        return {"fontsize": self.style.font, "color": self.style.ink, "labelpad": 0.3 * self.style.font}

    def _title(self, objective: Objective) -> str:
        return f"{self._name(objective)} ({'larger' if objective.maximise else 'smaller'} is better)"

    def _name(self, objective: Objective) -> str:
        return self.style.labels.get(objective.metric, METRICS[objective.metric].title)

    def _axes(self, left: float, bottom: float, across: float, high: float) -> Any:  # noqa: ANN401
        width, height = self.figure.get_figwidth(), self.figure.get_figheight()
        return self.figure.add_axes((left / width, bottom / height, across / width, high / height))

    def _text(self, left: float, bottom: float, text: str, size: float) -> None:
        width, height = self.figure.get_figwidth(), self.figure.get_figheight()
        self.figure.text(left / width, bottom / height, text, fontsize=size, color=self.style.ink, ha="center")


def best_so_far(search: Search) -> tuple[list[int], list[float]]:
    """Return the numbers of the points at which a search for one metric found a better value, and these values."""
    numbers: list[int] = []
    values: list[float] = []
    for i in search.complete:
        value = search.points[i].values[0]
        if not values or search.objectives[0].gain(value, values[-1]) > 0:
            numbers.append(i + 1)
            values.append(value)
    return numbers, values


def _columns(points: Sequence[Point], second: int) -> tuple[list[float], list[float]]:
    return [point.values[0] for point in points], [point.values[second] for point in points]


def _listed(values: object) -> Sequence[Any]:
    return values if isinstance(values, list) else ()


def _choices(texts: Sequence[str], most: int) -> list[str]:
    """Shorten the names of choices to what fits below an axis; number them if they would look alike."""
    if max(map(len, texts)) > most:
        same = next((i for i, letters in enumerate(zip(*texts, strict=False)) if len(set(letters)) > 1), 0)
        start = max(texts[0].rfind(letter, 0, same) for letter in "=( ") + 1
        texts = [text[start:].rstrip(")") for text in texts]
    shown = [_short(text, most) for text in texts]
    return shown if most > 2 and len(set(shown)) == len(shown) else [str(i + 1) for i in range(len(texts))]


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"
