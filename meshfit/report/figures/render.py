"""Pictures of meshes side by side, each from its target's camera, plain or in the colours of their distances."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshfit.errors import ConfigError
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import frame_of
from meshfit.mesh.targets import NAMED_TARGETS, load_target, target_title
from meshfit.report.figures.camera import Camera, camera_of
from meshfit.report.figures.layout import DPI, ColourBar, Row, write_plate
from meshfit.report.figures.surface_errors import distances_to, shared_limit
from meshfit.report.figures.trial_meshes import trial_meshes
from meshfit.report.figures.view import View

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


_UNITS = {
    "tutorial": "in the tutorial frame, where the target's largest |coordinate| is 1",
    "box": "in the box frame, where the diagonal of the target's box is 1",
    "none": "in the unit of the target's file",
}


@dataclass(frozen=True)
class _Found:
    """What is drawn of one thing that was named, and the frame that it is in."""

    shown: tuple[Shown, ...]
    frame: str


def scene_of(what: Sequence[str], against: str | None = None) -> tuple[list[Shown], str]:
    """What is drawn, from left to right, and the label of its colour bar.

    Args:
        what: mesh files, names of targets, or folders of trials, each as itself or as `TITLE=…`.
        against: the target that distances are taken to: a name, or a mesh file.

    Raises:
        ConfigError: distances that would be in different units.
        MeshError, StoreError: what cannot be read.
    """
    target = None if against is None else _named(against)
    files = target
    found = []
    for text in what:
        title, _, name = text.rpartition("=")
        if Path(name).is_dir():
            found.append(_trial(Path(name), title, against))
        else:
            one = _mesh(name, title, files, target)
            files = files if files is not None or name in NAMED_TARGETS else one.mesh
            found.append(_Found((one,), _frame(against or name)))
    frames = dict.fromkeys(each.frame for each in found) if against is not None else {}
    if len(frames) > 1:
        raise ConfigError(f"distances cannot share a scale: some are {', others '.join(_UNITS[one] for one in frames)}")
    label = f"distance to {target_title(against)}, {_UNITS[next(iter(frames))]}" if against is not None else ""
    return [shown for each in found for shown in each.shown], label


def _frame(name: str) -> str:
    return "tutorial" if name in NAMED_TARGETS else "none"


def _named(name: str) -> Mesh:
    """A mesh by its name or file; a named target in its tutorial frame, a file as it is."""
    mesh = load_target(name)
    return frame_of(mesh.verts, "tutorial").normalise(mesh) if name in NAMED_TARGETS else mesh


def _mesh(name: str, title: str, files: Mesh | None, target: Mesh | None) -> Shown:
    mesh = _named(name)
    own = target is None and name in NAMED_TARGETS
    return Shown(title or target_title(name), mesh, mesh if own or files is None else files, target)


def _trial(folder: Path, title: str, against: str | None) -> _Found:
    """A trial's source and target are plain, whatever its result is compared with: neither is a result."""
    meshes = trial_meshes(folder)
    name = title or meshes.facts["scheme"]
    wanted = None
    if against is not None:
        same = against == meshes.facts["settings"]["targets"][0]
        wanted = meshes.target if same else meshes.frame.normalise(load_target(against))
    return _Found(
        (
            Shown(f"source, {name}", meshes.source, meshes.target),
            Shown(f"result, {name}", meshes.result, meshes.target, wanted),
            Shown(meshes.facts["target_title"], meshes.target, meshes.target),
        ),
        meshes.facts["settings"].get("normalise", "tutorial"),
    )
