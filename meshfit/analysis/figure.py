"""Figure of an analysis: the basis function, the eigenvalues over the valences, and a limit surface or curve."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from meshfit.analysis.analyse import Analysis, verdict
from meshfit.analysis.basis_function import Basis, basis_of, draw_contours, draw_graph, draw_surface, range_of
from meshfit.analysis.shapes import frame_quads, jack_quads, jack_triangles, star
from meshfit.analysis.stencil_meshes import stencil_meshes
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.optional import import_optional
from meshfit.report.figures.camera import camera_from
from meshfit.report.figures.colours import INK
from meshfit.report.figures.drawing import Image, draw
from meshfit.report.figures.layout import DPI, STYLE, write_drawing
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.registry import Scheme

Inset = UInt8[np.ndarray, "h w 4"]
"""A smaller image than another one."""

_WIDTH, _ROW, _TOP = 7.0, 2.6, 0.42  # inches
_FONT = 8.0
# Blue and vermilion of Okabe and Ito (2008), which colour-blind readers can tell apart; the markers differ too.
_LEADING, _REST, _SQUARE = "#0072b2", "#d55e00", "#7d8a96"
_FAILING = "#eceff2"
_CURVE, _POLYGON = "#3d2a7d", "#8b97a3"
_VIEW_DIRECTION = (0.75, 0.55, 1.0)
_FACES, _SEGMENTS = 30_000, 1_000  # from which a refined mesh or curve passes for its limit
_INSET = 0.3  # width of the control mesh, in proportion to that of the limit


def write_analysis(scheme: Scheme, analysis: Analysis, title: str, path: Path) -> None:
    """Draw the figure and write it.

    Args:
        scheme: the analysed scheme.
        analysis: its analysis.
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
        warnings.simplefilter("ignore")  # a letter missing from the font is drawn as a box
        figure = figures.Figure(figsize=(_WIDTH, rows * _ROW + _TOP), facecolor="white")
        layout = _FigureLayout(figure, rows, dpi)
        layout.write(_WIDTH / 2, layout.height - 0.17, title, _FONT + 3)
        layout.write(_WIDTH / 2, layout.height - 0.36, verdict(analysis), _FONT)
        if isinstance(scheme, CurveScheme):
            _add_curve(layout, scheme, basis)
        else:
            _add_surface(layout, scheme, analysis, basis)
        write_drawing(figure, path, dpi)


class _FigureLayout:
    """A matplotlib figure of panels in two columns, each with a caption below; all lengths are in inches."""

    def __init__(self, figure: Any, rows: int, dpi: int) -> None:  # noqa: ANN401  matplotlib is optional
        self.figure, self.rows, self.dpi = figure, rows, dpi
        self.height = rows * _ROW + _TOP
        self.size = round(0.46 * _WIDTH * dpi), round((_ROW - 0.4) * dpi)

    def corner(self, place: int) -> tuple[float, float]:
        """Return the lower left corner of a panel, counted row by row from the top."""
        return place % 2 * _WIDTH / 2, (self.rows - 1 - place // 2) * _ROW

    def caption(self, place: int, text: str) -> None:
        left, bottom = self.corner(place)
        self.write(left + _WIDTH / 4, bottom + 0.14, f"({'abcd'[place]}) {text}", _FONT)

    def write(self, middle: float, level: float, text: str, font: float) -> None:
        where = middle / _WIDTH, level / self.height
        self.figure.text(*where, text, ha="center", va="center", fontsize=font, color=INK)

    def axes(self, place: int, margins: tuple[float, float, float, float]) -> Any:  # noqa: ANN401  matplotlib is optional
        """Add axes to a panel, with margins on its left, bottom, right and top."""
        left, bottom = self.corner(place)
        across, high = _WIDTH / 2 - margins[0] - margins[2], _ROW - margins[1] - margins[3]
        return self._axes(left + margins[0], bottom + margins[1], across, high)

    def image(self, place: int, image: Image, indent: float = 0.14) -> None:
        """Put a picture into a panel, aligned to whole pixels to keep it sharp."""
        left, bottom = self.corner(place)
        left, bottom = round((left + indent) * self.dpi) / self.dpi, round((bottom + 0.3) * self.dpi) / self.dpi
        axes = self._axes(left, bottom, image.shape[1] / self.dpi, image.shape[0] / self.dpi)
        axes.imshow(image, interpolation="none", aspect="auto")
        axes.set_axis_off()

    def _axes(self, left: float, bottom: float, across: float, high: float) -> Any:  # noqa: ANN401  matplotlib is optional
        places = left / _WIDTH, bottom / self.height, across / _WIDTH, high / self.height
        return self.figure.add_axes(places)


def _add_surface(layout: _FigureLayout, scheme: Scheme, analysis: Analysis, basis: Basis) -> None:
    layout.image(0, draw_surface(basis, layout.size))
    layout.caption(0, "basis function")
    draw_contours(layout.axes(1, (0.3, 0.32, 0.3, 0.12)), basis)
    layout.caption(1, f"its contours, {range_of(basis)}")
    _draw_eigenvalues(layout.axes(2, (0.42, 0.66, 0.18, 0.18)), analysis, _FONT)
    layout.caption(2, "eigenvalues")
    limit, control = _draw_limit_surface(scheme, layout.size, regular=bool(analysis.unsupported))
    layout.image(3, limit)
    layout.image(3, control, 0.05)
    layout.caption(3, "limit surface, and its control mesh")


def _add_curve(layout: _FigureLayout, scheme: CurveScheme, basis: Basis) -> None:
    draw_graph(layout.axes(0, (0.35, 0.5, 0.25, 0.1)), basis, _FONT)
    layout.caption(0, f"basis function, {range_of(basis)}")
    _draw_limit_curve(layout.axes(1, (0.3, 0.32, 0.3, 0.1)), scheme)
    layout.caption(1, "limit curve, and its control polygon")


def _draw_eigenvalues(axes: Any, analysis: Analysis, font: float) -> None:  # noqa: ANN401  matplotlib is optional
    """Draw λ1, the largest other eigenvalue and λ1² at each valence, on grey where C1 fails."""
    valences = [vertex.valence for vertex in analysis.extraordinary]
    leading = [vertex.spectrum.leading.modulus for vertex in analysis.extraordinary]
    rest = [vertex.spectrum.rest.modulus for vertex in analysis.extraordinary]
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
    axes.set_xlabel("corners of the face" if analysis.irregular == "face" else "valence", fontsize=font, color=INK)
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


def _draw_limit_surface(scheme: Scheme, size: tuple[int, int], *, regular: bool) -> tuple[Image, Inset]:
    """Draw the limit of a control mesh, nearly, and the control mesh itself, smaller, from the same side.

    Args:
        scheme: on triangles or polygons.
        size: width and height of the picture of the limit, in pixels.
        regular: whether the scheme refines regular meshes only, so that a regular control mesh is drawn.
    """
    control: Mesh | PolygonMesh = jack_triangles()
    if isinstance(scheme, PolygonScheme):
        control = frame_quads() if regular else jack_quads()
    fine, levels = control, 0
    while fine.num_faces < _FACES:
        levels += 1
        fine = subdivide(control, scheme, levels)
    cage, limit = _triangles(control), _triangles(fine)
    camera, _ = camera_from(cage, _VIEW_DIRECTION).framing(cage, limit, aspect=size[0] / size[1])
    small = round(size[0] * _INSET), round(size[1] * _INSET)
    edges = isinstance(control, Mesh)  # not of quads, whose diagonals are not edges
    return draw(limit, camera, size=size), draw(cage, camera, size=small, edges=edges, background=None)


def _triangles(mesh: Mesh | PolygonMesh) -> Mesh:
    return mesh.triangulated() if isinstance(mesh, PolygonMesh) else mesh


def _draw_limit_curve(axes: Any, scheme: CurveScheme) -> None:  # noqa: ANN401  matplotlib is optional
    """Draw the limit of a star, nearly, over the star."""
    control = star()
    curve, levels = control, 0
    while curve.num_segments < _SEGMENTS:
        levels += 1
        curve = subdivide(control, scheme, levels)
    for drawn, style in (
        (control, {"color": _POLYGON, "linewidth": 0.6, "marker": "o", "markersize": 2.5, "markerfacecolor": INK}),
        (curve, {"color": _CURVE, "linewidth": 1.3}),
    ):
        x, y, _ = drawn.verts[np.append(drawn.corners, drawn.corners[0])].T
        axes.plot(x, y, **style)
    axes.set_aspect("equal")
    axes.set_axis_off()
