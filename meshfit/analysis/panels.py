"""The basis function of a scheme: the limit of the data that are 1 at one vertex of the regular lattice."""

import itertools
from dataclasses import dataclass
from math import ceil, log
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from meshfit.analysis.stencil_meshes import Patch, StencilMeshes
from meshfit.mesh.curves import Curves
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, fan_triangles
from meshfit.report.extra import import_optional
from meshfit.report.figures.camera import camera_from
from meshfit.report.figures.colours import INK
from meshfit.report.figures.drawing import Image, draw
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.registry import Scheme

_Inset = UInt8[np.ndarray, "h w 4"]  # of another size than the image beside it
_FINENESS = 24
_MARGIN = 0.35


@dataclass(frozen=True, eq=False)
class Basis:
    """The function, sampled.

    Attributes:
        places: (V, D) where, edges of the lattice having length 1.
        values: (V,) what it is there.
        triangles: (T, 3) between these places; none on a line, where places are in order.
        lattice: (L, 2, D) the ends of the control edges within its support.
    """

    places: Float64[np.ndarray, "V D"]
    values: Float64[np.ndarray, " V"]
    triangles: Int64[np.ndarray, "T 3"]
    lattice: Float64[np.ndarray, "L 2 D"]


def basis_of(meshes: StencilMeshes, steps: int, dilation: int, radius: float) -> Basis:
    """Sample it by refining, until about 24 samples lie along an edge.

    Args:
        meshes: laid down by the scheme.
        steps: of the scheme, that make one scalar dilation.
        dilation: fine edges along a coarse one after so many steps.
        radius: of the support, in rings.
    """
    reach = ceil(radius) + 4
    patch = meshes.patch(reach)
    origin = (patch.places == 0).all(axis=1) * 1.0
    finer = patch.refine(steps * ceil(log(_FINENESS) / log(dilation)))
    places, values = finer.carry(patch.places), finer.carry(origin)
    near = meshes.distance(places) <= radius + _MARGIN
    if meshes.dimension == 1:
        order = np.argsort(places[:, 0])
        chosen, triangles = order[near[order]], np.empty((0, 3), dtype=np.int64)
    else:
        chosen = np.flatnonzero(near)
        every = fan_triangles(finer.topology.corners, finer.topology.sizes)
        place = np.full(len(places), -1)
        place[chosen] = np.arange(len(chosen))
        triangles = place[every]
        triangles = triangles[(triangles >= 0).all(axis=1)]
    axes = np.array(meshes.axes)
    return Basis(places[chosen] @ axes, values[chosen], triangles, _edges_within(meshes, patch, radius) @ axes)


def _edges_within(meshes: StencilMeshes, patch: Patch, radius: float) -> Float64[np.ndarray, "L 2 D"]:
    """The control edges whose ends are no farther than the support."""
    ends = patch.topology.edges
    inside = meshes.distance(patch.places) <= max(1.0, radius) + _MARGIN
    return np.asarray(patch.places[ends[inside[ends].all(axis=1)]])


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
    camera, _ = camera_from(mesh, _FROM).framing(mesh, aspect=size[0] / size[1])
    return draw(mesh, camera, size=size)


def range_of(basis: Basis) -> str:
    """Its least and its largest value, in words."""
    low, top = float(basis.values.min()), float(basis.values.max())
    return f"from {low:.3f} to {top:.3f}".replace("-", "−") if low < -_SMALL * top else f"from 0 to {top:.3f}"


def draw_contours(axes: Any, basis: Basis) -> None:  # noqa: ANN401  matplotlib is optional
    """Contours on the lattice: solid where the function is positive, broken where it is negative."""
    colours = import_optional("matplotlib.colors")
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
    lines = import_optional("matplotlib.collections").LineCollection(basis.lattice, colors=_LINES, linewidths=0.35)
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


_CORE = 1.0
_REACH = 2.6
_WIDE, _NARROW = 2.4, 1.1


def jack_quads() -> PolygonMesh:
    """32 verts, of valence 6 where arms meet and 3 at their ends, and 30 quads, counter-clockwise from outside."""
    corners = list(itertools.product((-_CORE, _CORE), repeat=3))
    verts = [np.array(corner) for corner in corners]
    faces: list[tuple[int, ...]] = []
    for axis, side in itertools.product(range(3), (-1.0, 1.0)):
        base = [i for i, corner in enumerate(corners) if corner[axis] == side * _CORE]
        about = [(axis + 1) % 3, (axis + 2) % 3]
        base.sort(key=lambda i: float(np.arctan2(verts[i][about[1]], verts[i][about[0]])) * side)
        tips = range(len(verts), len(verts) + 4)
        verts += [np.where(np.arange(3) == axis, side * _REACH, verts[i]) for i in base]
        faces += [(base[k], base[(k + 1) % 4], tips[(k + 1) % 4], tips[k]) for k in range(4)]
        faces.append(tuple(tips))
    return _of_quads(np.array(verts), np.array(faces))


def jack_triangles() -> Mesh:
    """The same with every quad cut, so that verts have the valences 3, 6 and 12.

    Diagonals join corners of even sign, which leaves the symmetries of a tetrahedron.
    """
    jack = jack_quads()
    verts, quads = jack.verts, jack.corners.reshape(-1, 4)
    even = np.prod(verts[quads[:, 0]], axis=1) > 0
    turned = np.where(even[:, None], quads, np.roll(quads, -1, axis=1))
    return Mesh(verts, np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]]))


def frame_quads() -> PolygonMesh:
    """16 verts and 16 quads about a hole, every vertex of valence 4."""
    around, about = np.divmod(np.arange(16), 4)
    angle, radius = (around + 1 / 2) * np.pi / 2, np.where(about < 2, _WIDE, _NARROW)
    level = np.where((about == 1) | (about == 2), _CORE, -_CORE) / 2
    verts = np.stack([radius * np.cos(angle), level, -radius * np.sin(angle)], axis=1)
    here, onward = 4 * around + about, 4 * around + (about + 1) % 4
    quads = np.stack([here, (here + 4) % 16, (onward + 4) % 16, onward], axis=1)
    return _of_quads(verts, quads)


def _of_quads(verts: Float64[np.ndarray, "V 3"], quads: Int64[np.ndarray, "F 4"]) -> PolygonMesh:
    return PolygonMesh(verts, quads.reshape(-1), np.full(len(quads), 4))


_FROM_LIMIT_PANELS = (0.75, 0.55, 1.0)
_FACES, _SEGMENTS = 30_000, 1_000
_SMALL_LIMIT_PANELS = 0.3
_POINTS, _NOTCH = 5, 0.45
_CURVE, _POLYGON = "#3d2a7d", "#8b97a3"


def draw_limit_surface(scheme: Scheme, size: tuple[int, int], *, regular: bool) -> tuple[Image, _Inset]:
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
    camera, _ = camera_from(cage, _FROM_LIMIT_PANELS).framing(cage, limit, aspect=size[0] / size[1])
    small = round(size[0] * _SMALL_LIMIT_PANELS), round(size[1] * _SMALL_LIMIT_PANELS)
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
