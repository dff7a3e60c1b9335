"""Pictures of meshes side by side, each from its target's camera, plain or in the colours of their distances."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.report.camera import Camera, camera_of
from meshfit.report.plate import ColourBar, Row
from meshfit.report.surface_errors import distances_to, shared_limit
from meshfit.report.typeset import DPI, write_plate
from meshfit.report.view import View

_PANEL = 2.6
_FONT = 9.0


@dataclass(frozen=True)
class Shown:
    """A mesh of a row.

    Attributes:
        title: what is written below it.
        mesh: what is drawn.
        view: the mesh whose camera it is seen from, its target; meshes with the same one are drawn alike.
        against: the mesh that its distances are taken to; None where it is to be plain.
    """

    title: str
    mesh: Mesh
    view: Mesh
    against: Mesh | None = None


def draw_row(row: Sequence[Shown], path: Path, *, edges: bool = False, label: str = "") -> None:
    """Draw meshes side by side, y up, each with its title below; distances share one scale, and one colour bar.

    Args:
        row: from left to right.
        path: .png, .pdf or .svg.
        edges: draw the edges of faces too.
        label: of the colour bar, with the unit of distances.

    Raises:
        ConfigError: a library is missing, or the picture cannot be written.
        MeshError: a mesh without faces.
        MeasureError: distances to what has no surface.
    """
    dpi = DPI[path.suffix.lower()]
    size = round(_PANEL * dpi), round(_PANEL * dpi)
    cameras = cameras_of(row)
    distances = [None if one.against is None else distances_to(one.mesh, one.against) for one in row]
    measured = [values for values in distances if values is not None]
    limit = shared_limit(measured)
    panels = []
    for one, camera, values in zip(row, cameras, distances, strict=True):
        view = View(camera, size, edges)
        shown = view.plain(one.mesh, one.title) if values is None else view.coloured(one.mesh, values, limit, one.title)
        panels.append(shown)
    bar = ColourBar(limit, label, more=any(values.max() > limit for values in measured)) if measured else None
    write_plate([Row(tuple(panels), bar)], path, width=_PANEL * len(row), font=_FONT, dpi=dpi)


def cameras_of(row: Sequence[Shown]) -> list[Camera]:
    """The camera of each; those of one target are drawn back until all that it shows are in the picture."""
    views: list[tuple[Mesh, list[Mesh]]] = []
    places = []
    for one in row:
        place = next((place for place, (view, _) in enumerate(views) if _same(view, one.view)), len(views))
        if place == len(views):
            views.append((one.view, []))
        views[place][1].append(one.mesh)
        places.append(place)
    cameras = [camera_of(view).holding(*meshes) for view, meshes in views]
    return [cameras[place] for place in places]


def _same(first: Mesh, second: Mesh) -> bool:
    return first is second or (np.array_equal(first.verts, second.verts) and np.array_equal(first.faces, second.faces))
