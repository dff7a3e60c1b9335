"""Plates: pictures in rows, with text below them, rings on them, and colour bars beside them."""

import io
import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from meshfit.errors import ConfigError
from meshfit.report.extra import needed
from meshfit.report.figures.colours import DISTANCES, INK
from meshfit.report.figures.drawing import Image


@dataclass(frozen=True)
class Ring:
    """A mark around a place: from the left and from the top, in pixels; dashed where the place is out of sight."""

    left: float
    top: float
    dashed: bool


@dataclass(frozen=True)
class Panel:
    """A picture, the lines of text below it, and a ring on it."""

    image: Image
    lines: tuple[str, ...] = ()
    ring: Ring | None = None


@dataclass(frozen=True)
class ColourBar:
    """What colours stand for: from 0 to a limit, with an arrow where there is more, and what it is called."""

    limit: float
    label: str
    more: bool


@dataclass(frozen=True)
class Row:
    """Pictures of one size, side by side; a colour bar takes the columns before the first one, or a line of its own.

    Attributes:
        panels: from left to right; None leaves a column free.
        bar: the colour bar of the row.
    """

    panels: tuple[Panel | None, ...]
    bar: ColourBar | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of its pictures in pixels."""
        return next((panel.image.shape[0], panel.image.shape[1]) for panel in self.panels if panel is not None)

    @property
    def lines(self) -> int:
        """The most lines of text below a picture."""
        return max(len(panel.lines) for panel in self.panels if panel is not None)

    @property
    def free(self) -> int:
        """How many columns are free before the first picture."""
        return next(place for place, panel in enumerate(self.panels) if panel is not None)


SUFFIXES = (".png", ".pdf", ".svg")
DPI = {".png": 200, ".pdf": 300, ".svg": 300}
"""Pixels of pictures an inch, by the suffix of the file: for a screen, and for print."""

_GAP = 0.06
_LINE = 1.22
_BAR = 3.4  # lines that a colour bar takes, with its numbers and its label
_SMALLEST = 7.0  # points; what is too long for it is broken into lines
_MOST_LINES = 3
_LETTER = 0.47  # mean width of a letter, as a share of the size of the font
STYLE = {
    "font.family": ["STIXGeneral", "DejaVu Sans"],
    "pdf.fonttype": 42,  # outlines of TrueType, which every publisher takes
    "svg.hashsalt": "meshfit",
    "text.hinting": "none",
    "text.parse_math": False,
    "axes.linewidth": 0.5,
}
"""What matplotlib is told for every figure."""

_UNDATED: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}


def require_suffix(path: Path) -> None:
    """Refuse a file that no plate can be written to, before anything is drawn.

    Raises:
        ConfigError: another suffix than those of `SUFFIXES`, or a folder that is not there.
    """
    if path.suffix.lower() not in SUFFIXES:
        found = f"'{path.suffix}'" if path.suffix else "no suffix"
        raise ConfigError(f"{path}: {found} is not a picture format that is known; allowed: {', '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: cannot be written: no folder {path.parent}")
    needed("matplotlib")


def column_width(width: float, columns: int) -> float:
    """The width of a column, in inches, of a plate so many inches wide."""
    return (width - _GAP * (columns - 1)) / columns


def write_plate(rows: Sequence[Row], path: Path, *, width: float, font: float, dpi: int) -> None:
    """Write rows of pictures, one below the other.

    Args:
        rows: from top to bottom, all with as many columns.
        path: its suffix, one of `SUFFIXES`, says in which format.
        width: in inches.
        font: size of the text in points.
        dpi: pixels of the pictures an inch.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    matplotlib, figures = needed("matplotlib"), needed("matplotlib.figure")
    font = max(_SMALLEST, min([font, *(_fitted(font, row, width) for row in rows)]))
    rows = [_broken(row, width, font) for row in rows]
    line = font * _LINE / 72
    heights = [round(_height(row, line, dpi) * dpi) / dpi for row in rows]
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter that no font has is drawn as a box
        figure = figures.Figure(figsize=(width, sum(heights)), facecolor="white")
        top = sum(heights)
        for row, height in zip(rows, heights, strict=True):
            _Sheet(figure, width, sum(heights), font, dpi).add(row, top)
            top -= height
        write_drawing(figure, path, dpi)


def write_drawing(figure: Any, path: Path, dpi: int) -> None:  # noqa: ANN401  matplotlib is optional
    """Write a figure of matplotlib; the same figure gives the same bytes.

    Raises:
        ConfigError: the file cannot be written.
    """
    content, suffix = io.BytesIO(), path.suffix.lower()
    figure.savefig(content, format=suffix[1:], dpi=dpi, metadata=_UNDATED[suffix])
    try:
        path.write_bytes(content.getvalue())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def _fitted(font: float, row: Row, width: float) -> float:
    """The size at which each line of text of a row fits into its column."""
    longest = max((len(text) for panel in row.panels if panel is not None for text in panel.lines), default=0)
    return min(font, column_width(width, len(row.panels)) * 72 / (_LETTER * max(1, longest)))


def _broken(row: Row, width: float, font: float) -> Row:
    """The same row with its text in lines that fit, what is longer than three of them cut."""
    letters = max(4, round(column_width(width, len(row.panels)) * 72 / (_LETTER * font)))
    wrap = textwrap.TextWrapper(letters, max_lines=_MOST_LINES, placeholder="…", break_on_hyphens=False)
    panels = [
        None if panel is None else replace(panel, lines=tuple(part for text in panel.lines for part in wrap.wrap(text)))
        for panel in row.panels
    ]
    return replace(row, panels=tuple(panels))


def _height(row: Row, line: float, dpi: int) -> float:
    pictures = row.shape[0] / dpi
    if row.bar is None:
        return pictures + (row.lines + 0.5) * line
    if row.free:
        return max(pictures, _BAR * line) + (row.lines + 1.0) * line
    return pictures + (row.lines + 0.4 + _BAR) * line


@dataclass(frozen=True)
class _Sheet:
    """A matplotlib figure on which things are placed in inches from the left and from the bottom."""

    figure: Any
    width: float
    height: float
    font: float
    dpi: int

    def add(self, row: Row, top: float) -> None:
        column = column_width(self.width, len(row.panels))
        for place, panel in enumerate(row.panels):
            if panel is not None:
                self._add_panel(panel, place * (column + _GAP), column, top)
        if row.bar is None:
            return
        line, height = self.font * _LINE / 72, row.shape[0] / self.dpi
        if row.free:
            across = row.free * (column + _GAP) - _GAP
            below = top - max(height, _BAR * line) / 2
            self._add_bar(row.bar, (0.12 * across, below), 0.76 * across, across)
        else:
            below = top - height - (row.lines + 1.4) * line
            self._add_bar(row.bar, (0.3 * self.width, below), 0.4 * self.width, self.width)

    def _add_panel(self, panel: Panel, left: float, across: float, top: float) -> None:
        high, wide = panel.image.shape[0] / self.dpi, panel.image.shape[1] / self.dpi
        # On whole pixels, or each would be a mixture of two.
        corner = round((left + (across - wide) / 2) * self.dpi) / self.dpi, round((top - high) * self.dpi) / self.dpi
        axes = self._axes(*corner, wide, high)
        axes.imshow(panel.image, interpolation="none", aspect="auto")
        axes.set_axis_off()
        if panel.ring is not None:
            self._add_ring(axes, panel.ring)
        for number, text in enumerate(panel.lines):
            self.figure.text(
                (left + across / 2) / self.width,
                (top - high - (number + 0.95) * self.font * _LINE / 72) / self.height,
                text,
                ha="center",
                va="baseline",
                fontsize=self.font,
                color=INK,
            )

    def _add_ring(self, axes: Any, ring: Ring) -> None:  # noqa: ANN401  matplotlib is optional
        circle = needed("matplotlib.patches").Circle
        for colour, weight in (("white", 1.4), (INK, 0.7)):
            style = {"linewidth": weight, "linestyle": (0, (2.0, 1.4)) if ring.dashed else "-"}
            radius = 0.5 * self.font * self.dpi / 72
            axes.add_patch(circle((ring.left, ring.top), radius, fill=False, clip_on=False, edgecolor=colour, **style))

    def _add_bar(self, bar: ColourBar, corner: tuple[float, float], across: float, room: float) -> None:
        colours, cm = needed("matplotlib.colors"), needed("matplotlib.cm")
        axes = self._axes(*corner, across, 0.8 * self.font / 72)
        shades = colours.LinearSegmentedColormap.from_list("distances", DISTANCES)
        scale = cm.ScalarMappable(colours.Normalize(0.0, bar.limit), shades)
        drawn = self.figure.colorbar(
            scale, cax=axes, orientation="horizontal", extend="max" if bar.more else "neither", extendfrac=0.04
        )
        drawn.outline.set_linewidth(0.4)
        drawn.set_ticks([0.0, bar.limit / 2, bar.limit])
        drawn.set_ticklabels(["0", f"{bar.limit / 2:.4g}", f"{bar.limit:.4g}"])
        axes.tick_params(labelsize=self.font, length=2, width=0.5, pad=1.5, colors=INK)
        size = min(self.font, room * 72 / (_LETTER * len(bar.label)))
        axes.set_xlabel(bar.label, fontsize=size, labelpad=1.5, color=INK)

    def _axes(self, left: float, bottom: float, across: float, high: float) -> Any:  # noqa: ANN401  matplotlib is optional
        return self.figure.add_axes((left / self.width, bottom / self.height, across / self.width, high / self.height))
