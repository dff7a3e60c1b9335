"""What a scheme makes of a control shape: of a jack or a frame, or on curves of a star."""

from typing import Any

import numpy as np

from meshfit.mesh.curves import Curves
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.report.camera import looking_from
from meshfit.report.colours import INK
from meshfit.report.drawing import Image, draw
from meshfit.report.jack import frame_quads, jack_quads, jack_triangles
from meshfit.subdivision.curve_scheme import CurveScheme
from meshfit.subdivision.polygon_scheme import PolygonScheme
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.scheme import Scheme

_FROM = (0.75, 0.55, 1.0)
_FACES, _SEGMENTS = 30_000, 1_000
_SMALL = 0.3
_POINTS, _NOTCH = 5, 0.45
_CURVE, _POLYGON = "#3d2a7d", "#8b97a3"


def draw_limit_surface(scheme: Scheme, size: tuple[int, int], *, regular: bool) -> tuple[Image, Image]:
    """Nearly the limit of a control mesh, and the control mesh itself, smaller, from the same side.

    Args:
        scheme: on triangles or polygons.
        size: width and height of the limit's picture in pixels.
        regular: whether the scheme refines regular meshes only.
    """
    control: Mesh | PolygonMesh = jack_triangles()
    if isinstance(scheme, PolygonScheme):
        control = frame_quads() if regular else jack_quads()
    fine, levels = control, 0
    while fine.num_faces < _FACES:
        levels += 1
        fine = subdivide(control, scheme, levels)
    cage, limit = _triangles(control), _triangles(fine)
    camera, _ = looking_from(cage, _FROM).framing(cage, limit, aspect=size[0] / size[1])
    small = round(size[0] * _SMALL), round(size[1] * _SMALL)
    edges = isinstance(control, Mesh)  # the diagonals of quads are no edges, and their sides are seen by their shade
    return draw(limit, camera, size=size), draw(cage, camera, size=small, edges=edges, background=None)


def _triangles(mesh: Mesh | PolygonMesh) -> Mesh:
    return mesh.with_short_diagonals().triangulated() if isinstance(mesh, PolygonMesh) else mesh


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
