"""The basis function of a scheme: the limit of data that are 1 at one vertex of the regular lattice."""

from dataclasses import dataclass
from math import ceil, log
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.analysis.stencil_meshes import Patch, StencilMeshes
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.triangulation import triangulate
from meshfit.optional import import_optional
from meshfit.report.figures.camera import camera_from
from meshfit.report.figures.colours import INK
from meshfit.report.figures.drawing import Image, draw

_FINENESS = 24  # samples along an edge, at least
_MARGIN = 0.35  # rings shown around the support
_VIEW_DIRECTION = (-0.55, 0.75, 1.0)
_HEIGHT = 0.42  # of the graph, in proportion to its width
_NEGATIVE, _NEUTRAL, _POSITIVE = "#b35806", "#ffffff", "#3d2a7d"
_LINES = "#b9c2ca"
_LEVELS = 9
_SMALL = 1e-3


@dataclass(frozen=True, eq=False)
class Basis:
    """The function, sampled on a part of the lattice.

    Attributes:
        places: (V, D) positions; edges of the lattice have length 1.
        values: (V,) its values there.
        triangles: (T, 3) between these places; none on a line, where places are in order.
        lattice: (L, 2, D) the ends of the control edges within its support.
    """

    places: Float64[np.ndarray, "V D"]
    values: Float64[np.ndarray, " V"]
    triangles: Int64[np.ndarray, "T 3"]
    lattice: Float64[np.ndarray, "L 2 D"]


def basis_of(meshes: StencilMeshes, steps: int, dilation: int, radius: float) -> Basis:
    """Sample the function by refining, until about 24 samples lie along an edge.

    Args:
        meshes: of the scheme.
        steps: levels of the scheme that make one scalar dilation.
        dilation: fine edges along a coarse one after these steps.
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
        flat = np.pad(places @ np.array(meshes.axes), ((0, 0), (0, 1)))
        every = triangulate(flat, finer.topology.corners, finer.topology.sizes)
        place = np.full(len(places), -1)
        place[chosen] = np.arange(len(chosen))
        triangles = place[every]
        triangles = triangles[(triangles >= 0).all(axis=1)]
    axes = np.array(meshes.axes)
    return Basis(places[chosen] @ axes, values[chosen], triangles, _edges_within(meshes, patch, radius) @ axes)


def _edges_within(meshes: StencilMeshes, patch: Patch, radius: float) -> Float64[np.ndarray, "L 2 D"]:
    """Return the control edges whose ends are within the support."""
    ends = patch.topology.edges
    inside = meshes.distance(patch.places) <= max(1.0, radius) + _MARGIN
    return np.asarray(patch.places[ends[inside[ends].all(axis=1)]])


def draw_surface(basis: Basis, size: tuple[int, int]) -> Image:
    """Draw its graph, seen obliquely from above; the height is in proportion to the width of the support."""
    x, y = basis.places.T
    height = _HEIGHT * float(np.ptp(x)) / float(basis.values.max())
    mesh = Mesh(np.stack([x, height * basis.values, -y], axis=1), basis.triangles)
    camera, _ = camera_from(mesh, _VIEW_DIRECTION).framing(mesh, aspect=size[0] / size[1])
    return draw(mesh, camera, size=size)


def range_of(basis: Basis) -> str:
    """Return the range of its values as text."""
    low, top = float(basis.values.min()), float(basis.values.max())
    return f"from {low:.3f} to {top:.3f}".replace("-", "−") if low < -_SMALL * top else f"from 0 to {top:.3f}"


def draw_contours(axes: Any, basis: Basis) -> None:  # noqa: ANN401  matplotlib is optional
    """Draw contours on the lattice: solid where the function is positive, dashed where it is negative."""
    colours = import_optional("matplotlib.colors")
    ramp = colours.LinearSegmentedColormap.from_list("signed", [_NEGATIVE, _NEUTRAL, _POSITIVE])
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
    """Draw its graph over a line, with marks at the control vertices."""
    axes.axhline(0.0, color=_LINES, linewidth=0.4)
    axes.plot(basis.places[:, 0], basis.values, color=_POSITIVE, linewidth=1.2)
    verts = np.unique(basis.lattice)
    axes.plot(verts, 0 * verts, linestyle="none", marker="o", markersize=3, color=INK)
    axes.tick_params(labelsize=font, length=2, width=0.5, colors=INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
