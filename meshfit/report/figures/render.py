"""Pictures of meshes side by side, each from its target's camera, in one colour or in the colours of its distances."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshfit.errors import ConfigError, StoreError
from meshfit.experiment.storage.run_directory import RESULT
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import frame_of
from meshfit.mesh.targets import NAMED_TARGETS, load_target, target_title
from meshfit.paths import is_folder, is_regular_file, path_text
from meshfit.report.figures.camera import Camera, camera_of
from meshfit.report.figures.colours import shared_limit
from meshfit.report.figures.layout import DPI, ColourBar, PanelRow, distance_panel, mesh_panel, write_rows
from meshfit.report.figures.trial_meshes import distances_to, read_trial_meshes
from meshfit.report.tables.notes import FRAMES

_PANEL = 2.6
_FONT = 9.0


@dataclass(frozen=True)
class RenderedMesh:
    """A mesh of the picture.

    Attributes:
        title: text below it.
        mesh: the mesh.
        viewed_like: the mesh whose camera it is seen from, its target; meshes with the same one share a camera.
        against: the mesh that its distances are measured to; None for a single colour.
    """

    title: str
    mesh: Mesh
    viewed_like: Mesh
    against: Mesh | None = None


def collect_meshes(names: Sequence[str], against: str | None = None) -> tuple[list[RenderedMesh], str]:
    """Read the meshes of a picture, and return them with the label of their colour bar.

    Args:
        names: mesh files, named targets, or folders of trials, each as itself or as `TITLE=…`.
        against: the target that distances are measured to: a named target or a mesh file.

    Raises:
        ConfigError: the distances would be in different units.
        MeshError, StoreError: a file cannot be read.
    """
    # Trials know their own target, whose file may be gone.
    only_trials = all(is_folder(text.rpartition("=")[2]) for text in names)
    target = None if against is None or only_trials else _load(against)
    first_file = target
    meshes: list[RenderedMesh] = []
    frames: dict[str, None] = {}
    for text in names:
        title, _, name = text.rpartition("=")
        if is_folder(name):
            of_trial, frame = _trial(Path(name), title, against)
            meshes += of_trial
        else:
            mesh, frame = _load(name), _frame(against or name)
            own_view = target is None and name in NAMED_TARGETS
            like = mesh if own_view or first_file is None else first_file
            meshes.append(RenderedMesh(title or target_title(name), mesh, like, target))
            if first_file is None and name not in NAMED_TARGETS:
                first_file = mesh
        frames[frame] = None
    if against is None:
        return meshes, ""
    if len(frames) > 1:
        units = ", others ".join(f"in {FRAMES[frame]}" for frame in frames)
        raise ConfigError(f"distances cannot share a scale: some are {units}")
    return meshes, f"distance to {target_title(against)}, in {FRAMES[next(iter(frames))]}"


def write_render(meshes: Sequence[RenderedMesh], path: Path, *, edges: bool = False, label: str = "") -> None:
    """Draw meshes side by side, y up, each with its title below; distances share one scale and one colour bar.

    Args:
        meshes: from left to right.
        path: .png, .pdf or .svg.
        edges: draw the edges of faces too.
        label: label of the colour bar, with the unit of distances.

    Raises:
        ConfigError: a library is not installed, or the picture cannot be written.
        MeshError: a mesh has no faces.
        MeasureError: distances are measured to a mesh without faces.
    """
    dpi = DPI[path.suffix.lower()]
    size = round(_PANEL * dpi), round(_PANEL * dpi)
    distances = [None if shown.against is None else distances_to(shown.mesh, shown.against) for shown in meshes]
    measured = [values for values in distances if values is not None]
    limit = shared_limit(measured)
    panels = [
        mesh_panel(shown.mesh, camera, size, shown.title, edges=edges)
        if values is None
        else distance_panel(shown.mesh, values, limit, camera, size, shown.title, edges=edges)
        for shown, camera, values in zip(meshes, cameras_of(meshes), distances, strict=True)
    ]
    bar = ColourBar(limit, label, more=any(values.max() > limit for values in measured)) if measured else None
    write_rows([PanelRow(tuple(panels), bar)], path, width=_PANEL * len(meshes), font=_FONT, dpi=dpi)


def cameras_of(meshes: Sequence[RenderedMesh]) -> list[Camera]:
    """Return the camera of each mesh; those that share one are zoomed out until all of them fit."""
    groups: list[tuple[Mesh, list[Mesh]]] = []
    places = []
    for shown in meshes:
        place = next((i for i, (target, _) in enumerate(groups) if _equal(target, shown.viewed_like)), len(groups))
        if place == len(groups):
            groups.append((shown.viewed_like, []))
        groups[place][1].append(shown.mesh)
        places.append(place)
    cameras = [camera_of(target).containing(*members) for target, members in groups]
    return [cameras[place] for place in places]


def _equal(first: Mesh, second: Mesh) -> bool:
    return first is second or (np.array_equal(first.verts, second.verts) and np.array_equal(first.faces, second.faces))


def _frame(name: str) -> str:
    return "tutorial" if name in NAMED_TARGETS else "none"


def _load(name: str) -> Mesh:
    """A named target in its tutorial frame, or a mesh file in its own coordinates."""
    mesh = load_target(name)
    return frame_of(mesh.verts, "tutorial").normalise(mesh) if name in NAMED_TARGETS else mesh


def _is_target(name: str, target: str) -> bool:
    """Whether a name is that of a trial's target; a file that no longer exists is known by its name alone."""
    if name == target or name in NAMED_TARGETS or target in NAMED_TARGETS:
        return name == target
    if is_regular_file(name):
        return Path(name).absolute() == Path(target)
    return Path(name).name in (Path(target).name, target_title(target))


def _trial(folder: Path, title: str, against: str | None) -> tuple[list[RenderedMesh], str]:
    """Source, result and target of a trial, and the frame they are in; only the result is coloured by distances."""
    if not is_regular_file(folder / RESULT):
        raise StoreError(f"{path_text(folder)}: expected a mesh file or the folder of a complete trial, got another")
    trial = read_trial_meshes(folder)
    name, settings = title or trial.facts["scheme"], trial.facts["settings"]
    measured_to = None
    if against is not None:
        own = _is_target(against, settings["targets"][0])
        measured_to = trial.target if own else trial.frame.normalise(load_target(against))
    meshes = [
        RenderedMesh(f"source, {name}", trial.source, trial.target),
        RenderedMesh(f"result, {name}", trial.result, trial.target, measured_to),
        RenderedMesh(trial.facts["target_title"], trial.target, trial.target),
    ]
    return meshes, settings.get("normalise", "tutorial")
