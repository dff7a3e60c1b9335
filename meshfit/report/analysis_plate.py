"""The figure of an analysis: the basis function, the eigenvalues at each valence, and a limit surface."""

import warnings
from pathlib import Path
from typing import Any

from meshfit.report.basis import basis_of
from meshfit.report.basis_panels import draw_contours, draw_surface, range_of
from meshfit.report.camera import looking_from
from meshfit.report.colours import INK
from meshfit.report.drawing import Image, draw
from meshfit.report.eigenvalue_panel import draw_eigenvalues
from meshfit.report.extra import needed
from meshfit.report.jack import jack_triangles
from meshfit.report.typeset import DPI, STYLE, write_drawing
from meshfit.subdivision.analysis.analyse import Analysis
from meshfit.subdivision.analysis.domains import domain_of
from meshfit.subdivision.analysis.verdict import verdict
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.scheme import Scheme

_WIDTH, _HEIGHT, _TOP = 7.0, 5.6, 0.42
_FONT = 8.0
_FROM = (0.75, 0.55, 1.0)
_FACES = 60_000
_SMALL = 0.3


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
    matplotlib, figures = needed("matplotlib"), needed("matplotlib.figure")
    dpi = DPI[path.suffix.lower()]
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter that no font has is drawn as a box
        figure = figures.Figure(figsize=(_WIDTH, _HEIGHT), facecolor="white")
        figure.text(0.5, 1 - 0.17 / _HEIGHT, title, ha="center", va="center", fontsize=_FONT + 3, color=INK)
        figure.text(0.5, 1 - 0.36 / _HEIGHT, verdict(analysis), ha="center", va="center", fontsize=_FONT, color=INK)
        _add_panels(figure, scheme, analysis, dpi)
        write_drawing(figure, path, dpi)


def _add_panels(figure: Any, scheme: Scheme, analysis: Analysis, dpi: int) -> None:  # noqa: ANN401
    basis = basis_of(domain_of(scheme), analysis.steps, analysis.dilation, analysis.support.radius)
    high, wide = (_HEIGHT - _TOP) / 2, _WIDTH / 2
    size = round(0.92 * wide * dpi), round((high - 0.4) * dpi)
    _add_image(figure, draw_surface(basis, size), 0.04 * wide, high + 0.3, dpi)
    draw_contours(_axes(figure, 1.08 * wide, high + 0.32, 0.84 * wide, high - 0.44), basis)
    draw_eigenvalues(_axes(figure, 0.42, 0.66, wide - 0.6, high - 0.84), analysis, _FONT)
    limit, control = _limit_surface(scheme, size)
    _add_image(figure, limit, 1.04 * wide, 0.3, dpi)
    _add_image(figure, control, 1.02 * wide, 0.3, dpi)
    captions = (
        "basis function",
        f"its contours, {range_of(basis)}",
        "eigenvalues",
        "limit surface, and its control mesh",
    )
    for place, caption in enumerate(captions):
        left, bottom = (place % 2 + 0.5) / 2, (0.14 + high * (place < 2)) / _HEIGHT
        letter = "abcd"[place]
        figure.text(left, bottom, f"({letter}) {caption}", ha="center", va="center", fontsize=_FONT, color=INK)


def _limit_surface(scheme: Scheme, size: tuple[int, int]) -> tuple[Image, Image]:
    """Of a jack, and the jack itself, smaller."""
    control = jack_triangles()
    mesh, levels = control, 0
    while mesh.num_faces * 2 < _FACES:
        levels += 1
        mesh = subdivide(control, scheme, levels)
    camera, _ = looking_from(control, _FROM).framing(control, mesh, aspect=size[0] / size[1])
    small = round(size[0] * _SMALL), round(size[1] * _SMALL)
    return draw(mesh, camera, size=size), draw(control, camera, size=small, edges=True, background=None)


def _add_image(figure: Any, image: Image, left: float, bottom: float, dpi: int) -> None:  # noqa: ANN401
    # On whole pixels, or each would be a mixture of two.
    left, bottom = round(left * dpi) / dpi, round(bottom * dpi) / dpi
    axes = _axes(figure, left, bottom, image.shape[1] / dpi, image.shape[0] / dpi)
    axes.imshow(image, interpolation="none", aspect="auto")
    axes.set_axis_off()


def _axes(figure: Any, left: float, bottom: float, across: float, high: float) -> Any:  # noqa: ANN401
    """Axes placed in inches."""
    return figure.add_axes((left / _WIDTH, bottom / _HEIGHT, across / _WIDTH, high / _HEIGHT))
