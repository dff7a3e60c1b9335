"""The chart of the leading eigenvalues over the valences."""

import warnings
from pathlib import Path
from typing import Any

from meshfit.analysis.analyse import Analysis, verdict
from meshfit.analysis.panels import (
    Basis,
    basis_of,
    draw_contours,
    draw_graph,
    draw_limit_curve,
    draw_limit_surface,
    draw_surface,
    range_of,
)
from meshfit.analysis.stencil_meshes import stencil_meshes
from meshfit.report.extra import import_optional
from meshfit.report.figures.colours import INK
from meshfit.report.figures.drawing import Image
from meshfit.report.figures.layout import DPI, STYLE, write_drawing
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.registry import Scheme

# Blue and vermilion of Okabe and Ito (2008), which the colour-blind can tell apart; shapes differ too.
_LEADING, _REST, _SQUARE = "#0072b2", "#d55e00", "#7d8a96"
_FAILING = "#eceff2"


def draw_eigenvalues(axes: Any, analysis: Analysis, font: float) -> None:  # noqa: ANN401  matplotlib is optional
    """λ1, the largest other eigenvalue and λ1² at each valence; where C1 fails the ground is grey."""
    valences = [place.valence for place in analysis.places]
    leading = [place.spectrum.leading.modulus for place in analysis.places]
    rest = [place.spectrum.rest.modulus for place in analysis.places]
    for valence in analysis.failing:
        axes.axvspan(valence - 0.5, valence + 0.5, color=_FAILING, linewidth=0, zorder=0)
    square = [value**2 for value in leading]
    style = {"linewidth": 0.9, "markersize": 4, "markeredgewidth": 0.8}
    axes.plot(valences, leading, color=_LEADING, marker="o", label="λ1, of mode 1", zorder=4, **style)
    axes.plot(
        valences, rest, color=_REST, marker="s", markerfacecolor="white", label="largest other", zorder=3, **style
    )
    axes.plot(valences, square, color=_SQUARE, linewidth=0.8, linestyle=(0, (4, 2)), label="λ1²", zorder=2)
    axes.set_xlim(valences[0] - 0.6, valences[-1] + 0.6)
    axes.set_ylim(0, 1.28 * max(*leading, *rest))
    axes.set_xticks(valences)
    axes.tick_params(labelsize=font, length=2, width=0.5, colors=INK)
    axes.set_xlabel("corners of the face" if analysis.odd == "face" else "valence", fontsize=font, color=INK)
    axes.set_ylabel("modulus of eigenvalues", fontsize=font, color=INK)
    if analysis.failing:
        axes.fill_between([], [], facecolor=_FAILING, edgecolor=_SQUARE, linewidth=0.4, label="not C1")
    axes.legend(
        loc="upper left",
        ncols=2,
        fontsize=font,
        frameon=False,
        labelcolor=INK,
        handlelength=1.8,
        columnspacing=1.2,
        borderaxespad=0.1,
    )
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


_WIDTH, _ROW, _TOP = 7.0, 2.6, 0.42
_FONT = 8.0


def write_analysis(scheme: Scheme, analysis: Analysis, title: str, path: Path) -> None:
    """Draw the figure and write it.

    Args:
        scheme: what was analysed.
        analysis: of it.
        title: its canonical spec.
        path: .png, .pdf or .svg.

    Raises:
        ConfigError: a library of the extra is not installed, or the file cannot be written.
    """
    matplotlib, figures = import_optional("matplotlib"), import_optional("matplotlib.figure")
    dpi = DPI[path.suffix.lower()]
    basis = basis_of(stencil_meshes(scheme), analysis.steps, analysis.dilation, analysis.support.radius)
    rows = 1 if isinstance(scheme, CurveScheme) else 2
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter that no font has is drawn as a box
        figure = figures.Figure(figsize=(_WIDTH, rows * _ROW + _TOP), facecolor="white")
        plate = _Plate(figure, rows, dpi)
        plate.write(_WIDTH / 2, plate.height - 0.17, title, _FONT + 3)
        plate.write(_WIDTH / 2, plate.height - 0.36, verdict(analysis), _FONT)
        if isinstance(scheme, CurveScheme):
            _add_curve(plate, scheme, basis)
        else:
            _add_surface(plate, scheme, analysis, basis)
        write_drawing(figure, path, dpi)


class _Plate:
    """A matplotlib figure of panels in two columns, each with a caption below it; all places are in inches."""

    def __init__(self, figure: Any, rows: int, dpi: int) -> None:  # noqa: ANN401  matplotlib is optional
        self.figure, self.rows, self.dpi = figure, rows, dpi
        self.height = rows * _ROW + _TOP
        self.size = round(0.46 * _WIDTH * dpi), round((_ROW - 0.4) * dpi)

    def corner(self, place: int) -> tuple[float, float]:
        """The lower left corner of a panel; they are counted along the rows from the top."""
        return place % 2 * _WIDTH / 2, (self.rows - 1 - place // 2) * _ROW

    def caption(self, place: int, text: str) -> None:
        left, bottom = self.corner(place)
        self.write(left + _WIDTH / 4, bottom + 0.14, f"({'abcd'[place]}) {text}", _FONT)

    def write(self, middle: float, level: float, text: str, font: float) -> None:
        where = middle / _WIDTH, level / self.height
        self.figure.text(*where, text, ha="center", va="center", fontsize=font, color=INK)

    def axes(self, place: int, margins: tuple[float, float, float, float]) -> Any:  # noqa: ANN401
        """Axes in a panel, with so much room to its left, below, to its right and above."""
        left, bottom = self.corner(place)
        across, high = _WIDTH / 2 - margins[0] - margins[2], _ROW - margins[1] - margins[3]
        return self._axes(left + margins[0], bottom + margins[1], across, high)

    def image(self, place: int, image: Image, indent: float = 0.14) -> None:
        """A picture in a panel, on whole pixels, or each would be a mixture of two."""
        left, bottom = self.corner(place)
        left, bottom = round((left + indent) * self.dpi) / self.dpi, round((bottom + 0.3) * self.dpi) / self.dpi
        axes = self._axes(left, bottom, image.shape[1] / self.dpi, image.shape[0] / self.dpi)
        axes.imshow(image, interpolation="none", aspect="auto")
        axes.set_axis_off()

    def _axes(self, left: float, bottom: float, across: float, high: float) -> Any:  # noqa: ANN401
        places = left / _WIDTH, bottom / self.height, across / _WIDTH, high / self.height
        return self.figure.add_axes(places)


def _add_surface(plate: _Plate, scheme: Scheme, analysis: Analysis, basis: Basis) -> None:
    plate.image(0, draw_surface(basis, plate.size))
    plate.caption(0, "basis function")
    draw_contours(plate.axes(1, (0.3, 0.32, 0.3, 0.12)), basis)
    plate.caption(1, f"its contours, {range_of(basis)}")
    draw_eigenvalues(plate.axes(2, (0.42, 0.66, 0.18, 0.18)), analysis, _FONT)
    plate.caption(2, "eigenvalues")
    limit, control = draw_limit_surface(scheme, plate.size, regular=bool(analysis.unruled))
    plate.image(3, limit)
    plate.image(3, control, 0.05)
    plate.caption(3, "limit surface, and its control mesh")


def _add_curve(plate: _Plate, scheme: CurveScheme, basis: Basis) -> None:
    draw_graph(plate.axes(0, (0.35, 0.5, 0.25, 0.1)), basis, _FONT)
    plate.caption(0, f"basis function, {range_of(basis)}")
    draw_limit_curve(plate.axes(1, (0.3, 0.32, 0.3, 0.1)), scheme)
    plate.caption(1, "limit curve, and its control polygon")
