"""The basis function as a lit surface, as a map of its contours, or on a line as a curve."""

from typing import Any

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.report.basis import Basis
from meshfit.report.camera import looking_from
from meshfit.report.colours import INK
from meshfit.report.drawing import Image, draw
from meshfit.report.extra import needed

_FROM = (-0.55, 0.75, 1.0)
_HEIGHT = 0.42
_NEGATIVE, _ZERO, _POSITIVE = "#b35806", "#ffffff", "#3d2a7d"
_LINES = "#b9c2ca"
_LEVELS = 9
_SMALL = 1e-3


def draw_surface(basis: Basis, size: tuple[int, int]) -> Image:
    """Its graph, seen from above at a slant; its height is in proportion to how wide its support is."""
    x, y = basis.places.T
    height = _HEIGHT * float(np.ptp(x)) / float(basis.values.max())
    mesh = Mesh(np.stack([x, height * basis.values, -y], axis=1), basis.triangles)
    camera, _ = looking_from(mesh, _FROM).framing(mesh, aspect=size[0] / size[1])
    return draw(mesh, camera, size=size)


def range_of(basis: Basis) -> str:
    """Its least and its largest value, in words."""
    low, top = float(basis.values.min()), float(basis.values.max())
    return f"from {low:.3f} to {top:.3f}".replace("-", "−") if low < -_SMALL * top else f"from 0 to {top:.3f}"


def draw_contours(axes: Any, basis: Basis) -> None:  # noqa: ANN401  matplotlib is optional
    """Contours on the lattice: solid where the function is positive, broken where it is negative."""
    colours = needed("matplotlib.colors")
    ramp = colours.LinearSegmentedColormap.from_list("signed", [_NEGATIVE, _ZERO, _POSITIVE])
    top = float(basis.values.max())
    low = float(basis.values.min())
    x, y = basis.places.T
    shown = (x, y, basis.triangles, basis.values)
    step = top / _LEVELS
    axes.tripcolor(*shown[:3], basis.values, cmap=ramp, vmin=-top, vmax=top, shading="gouraud", rasterized=True)
    axes.tricontour(*shown, levels=step * np.arange(0.5, _LEVELS), colors=INK, linewidths=0.4)
    if low < -_SMALL * top:
        inner = -np.geomspace(-low * 0.9, -low * 0.1, 4)
        axes.tricontour(*shown, levels=inner, colors=_NEGATIVE, linewidths=0.5, linestyles=[(0, (2.0, 1.2))])
    lines = needed("matplotlib.collections").LineCollection(basis.lattice, colors=_LINES, linewidths=0.35)
    axes.add_collection(lines)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_axis_off()


def draw_graph(axes: Any, basis: Basis, font: float) -> None:  # noqa: ANN401  matplotlib is optional
    """Its graph over a line, with marks at the control verts."""
    axes.axhline(0.0, color=_LINES, linewidth=0.4)
    axes.plot(basis.places[:, 0], basis.values, color=_POSITIVE, linewidth=1.2)
    verts = np.unique(basis.lattice)
    axes.plot(verts, 0 * verts, linestyle="none", marker="o", markersize=3, color=INK)
    axes.tick_params(labelsize=font, length=2, width=0.5, colors=INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
