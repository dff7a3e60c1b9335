"""Figure layout: pictures of meshes in rows, with text below, rings on the worst vertex, and colour bars."""

import io
import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from meshfit.errors import ConfigError
from meshfit.mesh.mesh import Mesh
from meshfit.optional import import_optional
from meshfit.printable import printable
from meshfit.report.figures.camera import Camera, is_visible
from meshfit.report.figures.colours import DISTANCES, INK, rgb
from meshfit.report.figures.drawing import Image, draw
from meshfit.report.figures.trial_meshes import worst_vertex

SUFFIXES = (".png", ".pdf", ".svg")
DPI = {".png": 200, ".pdf": 300, ".svg": 300}
"""Pixels per inch of pictures, by file suffix: for a screen, and for print."""
STYLE = {
    "font.family": ["STIXGeneral", "DejaVu Sans"],
    "pdf.fonttype": 42,  # TrueType outlines, which every publisher accepts
    "svg.hashsalt": "meshfit",
    "text.hinting": "none",
    "text.parse_math": False,
    "axes.linewidth": 0.5,
}
"""The matplotlib settings of every figure."""

_UNDATED: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}
_GAP = 0.06
LINE = 1.22
"""Distance of two lines of text, as a multiple of the font size."""
_BAR = 3.4  # height of a colour bar with its numbers and its label, in lines
_SMALLEST_FONT = 7.0  # points; text that does not fit at this size is wrapped
_MOSTLINES = 3
LETTER = 0.47
"""Mean width of a letter, as a share of the font size."""


@dataclass(frozen=True)
class Ring:
    """A ring around a point, in pixels from the left and the top; dashed if the point is hidden."""

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
    """A colour scale from 0 to `limit`, with an arrow if there are larger values."""

    limit: float
    label: str
    more: bool


@dataclass(frozen=True)
class PanelRow:
    """Pictures of one size side by side; a colour bar takes the free columns before them, or a line of its own.

    Attributes:
        panels: from left to right; None leaves a column free.
        bar: colour bar of the row.
    """

    panels: tuple[Panel | None, ...]
    bar: ColourBar | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the pictures in pixels."""
        return next((panel.image.shape[0], panel.image.shape[1]) for panel in self.panels if panel is not None)

    @property
    def lines(self) -> int:
        """The largest number of text lines below a picture."""
        return max(len(panel.lines) for panel in self.panels if panel is not None)

    @property
    def free(self) -> int:
        """The number of free columns before the first picture."""
        return next(place for place, panel in enumerate(self.panels) if panel is not None)


def mesh_panel(
    mesh: Mesh,
    camera: Camera,
    size: tuple[int, int],
    *lines: str,
    edges: bool = False,
    background: str | None = "#ffffff",
) -> Panel:
    """Draw a mesh of one colour, with lines of text below; `size` is width and height in pixels."""
    return Panel(draw(mesh, camera, size=size, edges=edges, background=background), lines)


def distance_panel(
    mesh: Mesh,
    distances: Float64[np.ndarray, " V"],
    limit: float,
    camera: Camera,
    size: tuple[int, int],
    *lines: str,
    edges: bool = False,
    background: str | None = "#ffffff",
) -> Panel:
    """Draw a mesh in the colours of its distances (0 to `limit`), with a ring around the farthest vertex."""
    image = draw(mesh, camera, size=size, values=distances, limits=(0.0, limit), edges=edges, background=background)
    worst = worst_vertex(distances)
    return Panel(image, lines, Ring(*camera.pixel(mesh.verts[worst], size), dashed=not is_visible(mesh, worst, camera)))


def ink_on(background: str | None) -> str:
    """Return a colour of text that is legible on a background; one without colour is taken for white."""
    return "#ffffff" if background is not None and float(rgb(background) @ [0.3, 0.59, 0.11]) < 128 else INK


def parse_background(text: str) -> str | None:
    """Return a background as `#rrggbb`, or None if it is `transparent`.

    Raises:
        ConfigError: not a colour, or matplotlib is not installed.
    """
    if text == "transparent":
        return None
    try:
        return str(import_optional("matplotlib.colors").to_hex(text))
    except ValueError:
        raise ConfigError(
            f"background '{text}': expected transparent, the name of a colour such as black, or #rrggbb"
        ) from None


def require_suffix(path: Path) -> None:
    """Refuse an output path that cannot be written to, before anything is drawn.

    Raises:
        ConfigError: the suffix is unknown, the folder does not exist, the path is a folder, or matplotlib is missing.
    """
    if path.suffix.lower() not in SUFFIXES:
        found = f"'{path.suffix}'" if path.suffix else "no suffix"
        raise ConfigError(f"{path}: {found} is not a known picture format; allowed: {', '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: cannot be written: no folder {path.parent}")
    if path.is_dir():
        raise ConfigError(f"{path}: cannot be written: it is a folder")
    import_optional("matplotlib")


def column_width(width: float, columns: int) -> float:
    """The width in inches of each column of a figure `width` inches wide."""
    return (width - _GAP * (columns - 1)) / columns


def write_rows(
    rows: Sequence[PanelRow], path: Path, *, width: float, font: float, dpi: int, background: str | None = "#ffffff"
) -> None:
    """Write a figure of rows of pictures.

    Args:
        rows: from top to bottom, all with the same number of columns.
        path: output file; its suffix, one of `SUFFIXES`, is the format.
        width: width of the figure in inches.
        font: font size in points, reduced where a line of text would not fit.
        dpi: pixels per inch of the pictures.
        background: as for `draw`.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    matplotlib, figures = import_optional("matplotlib"), import_optional("matplotlib.figure")
    font = max(_SMALLEST_FONT, min([font, *(_fitting_font(font, row, width) for row in rows)]))
    rows = [_wrapped(row, width, font) for row in rows]
    line = font * LINE / 72
    heights = [round(_height(row, line, dpi) * dpi) / dpi for row in rows]
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter missing from every font is drawn as a box
        figure = figures.Figure(figsize=(width, sum(heights)), facecolor=background or "none")
        top = sum(heights)
        for row, height in zip(rows, heights, strict=True):
            Canvas(figure, width, sum(heights), font, dpi, ink_on(background)).add(row, top)
            top -= height
        write_drawing(figure, path, dpi)


def add_legend_above(figure: Any, handles: Sequence[Any], font: float) -> None:  # noqa: ANN401  matplotlib is optional
    """Add a legend in one row above the panels of a matplotlib figure."""
    figure.legend(
        handles=handles,
        loc="upper center",
        borderaxespad=0.1,
        ncols=len(handles),
        fontsize=font,
        frameon=False,
        labelcolor=INK,
        handlelength=1.2,
        handletextpad=0.4,
        columnspacing=1.2,
    )


def write_drawing(figure: Any, path: Path, dpi: int) -> None:  # noqa: ANN401  matplotlib is optional
    """Write a matplotlib figure; the same figure gives the same bytes.

    Raises:
        ConfigError: the file cannot be written.
    """
    content, suffix = io.BytesIO(), path.suffix.lower()
    figure.savefig(content, format=suffix[1:], dpi=dpi, metadata=_UNDATED[suffix])
    data = content.getvalue()
    if suffix == ".svg":
        data = printable(data.decode(), keep="\n\t").encode()
    try:
        path.write_bytes(data)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def set_log_ticks(axis: Any) -> None:  # noqa: ANN401  matplotlib is optional
    """Set the ticks of a logarithmic axis: powers of ten, or 1, 2 and 5 times these, or all digits, by its range."""
    ticker = import_optional("matplotlib.ticker")
    low, high = sorted(axis.get_view_interval())
    steps = (1.0,) if high / low > 50 else (1.0, 2.0, 5.0) if high / low > 3 else tuple(map(float, range(1, 10)))
    axis.set_major_locator(ticker.LogLocator(subs=steps))
    axis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(ticker.NullFormatter())


def _fitting_font(font: float, row: PanelRow, width: float) -> float:
    """The font size at which each line of text of a row fits into its column."""
    longest = max((len(text) for panel in row.panels if panel is not None for text in panel.lines), default=0)
    return min(font, column_width(width, len(row.panels)) * 72 / (LETTER * max(1, longest)))


def _wrapped(row: PanelRow, width: float, font: float) -> PanelRow:
    """The same row with its text wrapped into at most three lines that fit."""
    letters = max(4, round(column_width(width, len(row.panels)) * 72 / (LETTER * font)))
    wrap = textwrap.TextWrapper(letters, max_lines=_MOSTLINES, placeholder="…", break_on_hyphens=False)
    panels = [
        None if panel is None else replace(panel, lines=tuple(part for text in panel.lines for part in wrap.wrap(text)))
        for panel in row.panels
    ]
    return replace(row, panels=tuple(panels))


def _height(row: PanelRow, line: float, dpi: int) -> float:
    pictures = row.shape[0] / dpi
    if row.bar is None:
        return pictures + (row.lines + 0.5) * line
    if row.free:
        return max(pictures, _BAR * line) + (row.lines + 1.0) * line
    return pictures + (row.lines + 0.4 + _BAR) * line


@dataclass(frozen=True)
class Canvas:
    """A matplotlib figure with positions in inches from the left and the bottom."""

    figure: Any
    width: float
    height: float
    font: float
    dpi: int
    ink: str = INK

    def add(self, row: PanelRow, top: float) -> None:
        """Add a row of pictures below a height."""
        column = column_width(self.width, len(row.panels))
        for place, panel in enumerate(row.panels):
            if panel is not None:
                self.add_panel(panel, place * (column + _GAP), column, top)
        if row.bar is None:
            return
        line, height = self.font * LINE / 72, row.shape[0] / self.dpi
        if row.free:
            across = row.free * (column + _GAP) - _GAP
            below = top - max(height, _BAR * line) / 2
            self._add_bar(row.bar, (0.12 * across, below), 0.76 * across, across)
        else:
            below = top - height - (row.lines + 1.4) * line
            self._add_bar(row.bar, (0.3 * self.width, below), 0.4 * self.width, self.width)

    def add_panel(self, panel: Panel, left: float, across: float, top: float) -> None:
        """Add a picture in the middle of a column `across` inches wide, with its text below."""
        high, wide = panel.image.shape[0] / self.dpi, panel.image.shape[1] / self.dpi
        # Aligned to whole pixels, so that none is resampled.
        corner = round((left + (across - wide) / 2) * self.dpi) / self.dpi, round((top - high) * self.dpi) / self.dpi
        axes = self._axes(*corner, wide, high)
        axes.imshow(panel.image, interpolation="none", aspect="auto")
        axes.set_axis_off()
        if panel.ring is not None:
            self._add_ring(axes, panel.ring)
        for number, text in enumerate(panel.lines):
            self.figure.text(
                (left + across / 2) / self.width,
                (top - high - (number + 0.95) * self.font * LINE / 72) / self.height,
                text,
                ha="center",
                va="baseline",
                fontsize=self.font,
                color=self.ink,
            )

    def _add_ring(self, axes: Any, ring: Ring) -> None:  # noqa: ANN401  matplotlib is optional
        circle = import_optional("matplotlib.patches").Circle
        for colour, weight in (("white", 1.4), (INK, 0.7)):
            style = {"linewidth": weight, "linestyle": (0, (2.0, 1.4)) if ring.dashed else "-"}
            radius = 0.5 * self.font * self.dpi / 72
            axes.add_patch(circle((ring.left, ring.top), radius, fill=False, clip_on=False, edgecolor=colour, **style))

    def add_upright_bar(self, bar: ColourBar, corner: tuple[float, float], high: float) -> None:
        """Add a narrow vertical colour bar without a label, its numbers at its right."""
        axes = self._axes(*corner, 0.07, high)
        self._draw_bar(bar, axes, "vertical")
        axes.set_yticklabels(["0", "", f"{bar.limit:.4g}"])
        axes.tick_params(labelsize=max(6.0, self.font - 1), length=1.5, width=0.4, pad=1.5, colors=self.ink)

    def _draw_bar(self, bar: ColourBar, axes: Any, orientation: str) -> Any:  # noqa: ANN401  matplotlib is optional
        colours, cm = import_optional("matplotlib.colors"), import_optional("matplotlib.cm")
        shades = colours.LinearSegmentedColormap.from_list("distances", DISTANCES)
        scale = cm.ScalarMappable(colours.Normalize(0.0, bar.limit), shades)
        drawn = self.figure.colorbar(
            scale, cax=axes, orientation=orientation, extend="max" if bar.more else "neither", extendfrac=0.04
        )
        drawn.outline.set_linewidth(0.4)
        drawn.outline.set_edgecolor(self.ink)
        drawn.set_ticks([0.0, bar.limit / 2, bar.limit])
        return drawn

    def _add_bar(self, bar: ColourBar, corner: tuple[float, float], across: float, room: float) -> None:
        axes = self._axes(*corner, across, 0.8 * self.font / 72)
        drawn = self._draw_bar(bar, axes, "horizontal")
        drawn.set_ticklabels(["0", f"{bar.limit / 2:.4g}", f"{bar.limit:.4g}"])
        axes.tick_params(labelsize=self.font, length=2, width=0.5, pad=1.5, colors=self.ink)
        size = min(self.font, room * 72 / (LETTER * len(bar.label)))
        axes.set_xlabel(bar.label, fontsize=size, labelpad=1.5, color=self.ink)

    def _axes(self, left: float, bottom: float, across: float, high: float) -> Any:  # noqa: ANN401  matplotlib is optional
        return self.figure.add_axes((left / self.width, bottom / self.height, across / self.width, high / self.height))
