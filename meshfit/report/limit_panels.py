"""What a scheme makes of a control shape: of a jack, or on curves of a star."""

from typing import Any

import numpy as np

from meshfit.mesh.curves import Curves
from meshfit.report.camera import looking_from
from meshfit.report.colours import INK
from meshfit.report.drawing import Image, draw
from meshfit.report.jack import jack_triangles
from meshfit.subdivision.curve_scheme import CurveScheme
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.scheme import Scheme

_FROM = (0.75, 0.55, 1.0)
_FACES, _SEGMENTS = 30_000, 1_000
_SMALL = 0.3
_POINTS, _NOTCH = 5, 0.45
_CURVE, _POLYGON = "#3d2a7d", "#8b97a3"


def draw_limit_surface(scheme: Scheme, size: tuple[int, int]) -> tuple[Image, Image]:
    """Nearly the limit of a jack, and the jack itself, smaller, from the same side."""
    control = jack_triangles()
    mesh, levels = control, 0
    while mesh.num_faces < _FACES:
        levels += 1
        mesh = subdivide(control, scheme, levels)
    camera, _ = looking_from(control, _FROM).framing(control, mesh, aspect=size[0] / size[1])
    small = round(size[0] * _SMALL), round(size[1] * _SMALL)
    return draw(mesh, camera, size=size), draw(control, camera, size=small, edges=True, background=None)


def draw_limit_curve(axes: Any, scheme: CurveScheme) -> None:  # noqa: ANN401  matplotlib is optional
    """Nearly the limit of a star, over the star."""
    angle = np.pi / 2 + np.arange(2 * _POINTS) * np.pi / _POINTS
    radius = np.where(np.arange(2 * _POINTS) % 2, _NOTCH, 1.0)
    control = Curves.through(np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1), closed=True)
    curve, levels = control, 0
    while curve.num_segments < _SEGMENTS:
        levels += 1
        curve = subdivide(control, scheme, levels)
    for each, style in (
        (control, {"color": _POLYGON, "linewidth": 0.6, "marker": "o", "markersize": 2.5, "markerfacecolor": INK}),
        (curve, {"color": _CURVE, "linewidth": 1.3}),
    ):
        x, y, _ = each.verts[np.append(each.corners, each.corners[0])].T
        axes.plot(x, y, **style)
    axes.set_aspect("equal")
    axes.set_axis_off()
