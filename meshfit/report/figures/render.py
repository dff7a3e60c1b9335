"""Pictures of meshes side by side, each from its target's camera, in one colour or in the colours of its distances."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from meshfit.errors import ConfigError, StoreError
from meshfit.experiment.storage.plan_file import UpChoice, planned_up
from meshfit.experiment.storage.run_directory import RESULT
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import frame_of
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.targets import NAMED_TARGETS, load_target, target_title
from meshfit.paths import is_folder, is_regular_file, path_text
from meshfit.report.figures.camera import Camera, camera_of, is_turned
from meshfit.report.figures.cloud_surfels import drawn, measurable
from meshfit.report.figures.colours import shared_limit
from meshfit.report.figures.layout import DPI, ColourBar, PanelRow, distance_panel, mesh_panel, write_rows
from meshfit.report.figures.trial_meshes import distances_to, read_trial_meshes
from meshfit.report.tables.heads import FRAMES

_PANEL = 2.6
_MOST_COLUMNS = 4
_SMALLEST, _LARGEST = 16, 8192
_FONT = 9.0


@dataclass(frozen=True)
class RenderedMesh:
    """A mesh of the picture.

    Attributes:
        title: text below it.
        mesh: the mesh; of a cloud of points, their discs.
        viewed_like: the mesh whose camera it is seen from, its target; meshes with the same one share a camera.
        against: the mesh that its distances are measured to; None for a single colour.
        up: the axis that points up, of the experiment that it is from.
        cloud: the points that the discs of the mesh show; None for a mesh.
    """

    title: str
    mesh: Mesh
    viewed_like: Mesh
    against: Mesh | None = None
    up: UpChoice = "auto"
    cloud: PointCloud | None = None


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
    measured_to = None if target is None else measurable(target)
    first_file = None if target is None else drawn(target)
    meshes: list[RenderedMesh] = []
    frames: dict[str, None] = {}
    for text in names:
        title, _, name = text.rpartition("=")
        if is_folder(name):
            of_trial, frame = _trial(Path(name), title, against)
            meshes += of_trial
        else:
            loaded, frame = _load(name), _frame(against or name)
            mesh, cloud = drawn(loaded), loaded if isinstance(loaded, PointCloud) else None
            own_view = target is None and name in NAMED_TARGETS
            like = mesh if own_view or first_file is None else first_file
            # Points are not measured to others: their discs are wider than they are.
            goal = measured_to if cloud is None else None
            meshes.append(RenderedMesh(title or target_title(name), mesh, like, goal, cloud=cloud))
            if first_file is None and name not in NAMED_TARGETS:
                first_file = mesh
        frames[frame] = None
    if against is None:
        return meshes, ""
    if len(frames) > 1:
        units = ", others ".join(f"in {FRAMES[frame]}" for frame in frames)
        raise ConfigError(f"distances cannot share a scale: some are {units}")
    return meshes, f"distance to {target_title(against)}, in {FRAMES[next(iter(frames))]}"


@dataclass(frozen=True)
class RenderStyle:
    """Style of drawn meshes.

    Attributes:
        edges: draw the edges of faces too.
        size: width and height of each picture in pixels; None for a square of 2.6 inches.
        columns: pictures side by side; None for up to four.
        view: as for `camera_of`.
        up: the axis that points up; None for that of each experiment, or a guess.
        background: as `#rrggbb`; None for a transparent one.
    """

    edges: bool = False
    size: tuple[int, int] | None = None
    columns: int | None = None
    view: str = "best"
    up: UpChoice | None = None
    background: str | None = "#ffffff"


def write_render(
    meshes: Sequence[RenderedMesh], path: Path, *, style: RenderStyle | None = None, label: str = ""
) -> None:
    """Draw meshes side by side, upright, each with its title below; distances share one scale and one colour bar.

    Args:
        meshes: in reading order.
        path: .png, .pdf or .svg.
        style: how they are drawn.
        label: label of the colour bar, with the unit of distances.

    Raises:
        ConfigError: a library is not installed, the picture cannot be written, or there is no such view.
        MeshError: a mesh has no faces.
        MeasureError: distances are measured to a mesh without faces.
    """
    style = style or RenderStyle()
    dpi = DPI[path.suffix.lower()]
    size = style.size or (round(_PANEL * dpi), round(_PANEL * dpi))
    distances = [None if shown.against is None else distances_to(shown.mesh, shown.against) for shown in meshes]
    measured = [values for values in distances if values is not None]
    limit = shared_limit(measured)
    panels = [
        mesh_panel(shown.mesh, camera, size, shown.title, edges=style.edges, background=style.background)
        if values is None
        else distance_panel(
            shown.mesh, values, limit, camera, size, shown.title, edges=style.edges, background=style.background
        )
        for shown, camera, values in zip(meshes, cameras_of(meshes, style), distances, strict=True)
    ]
    bar = ColourBar(limit, label, more=any(values.max() > limit for values in measured)) if measured else None
    columns = columns_for(len(panels), style.columns)
    lines = [tuple(panels[begin : begin + columns]) for begin in range(0, len(panels), columns)]
    rows = [PanelRow((*line, *[None] * (columns - len(line)))) for line in lines]
    rows[-1] = replace(rows[-1], bar=bar)
    width = columns * size[0] / dpi
    write_rows(rows, path, width=width, font=_FONT, dpi=dpi, background=style.background)


def columns_for(count: int, wanted: int | None = None) -> int:
    """Return how many of `count` pictures are side by side: as wanted, or up to four, in lines of like length."""
    return min(count, wanted or math.ceil(count / math.ceil(count / _MOST_COLUMNS)))


def turned_meshes(meshes: Sequence[RenderedMesh], up: UpChoice | None = None) -> list[str]:
    """Return the titles of meshes that are taken to stand along z; `up` is that of their style."""
    return [shown.title for shown in meshes if is_turned(shown.viewed_like, up or shown.up)]


def parse_size(text: str) -> tuple[int, int]:
    """Return width and height in pixels from `800` or `800x600`.

    Raises:
        ConfigError: not a size, or one that no picture should have.
    """
    numbers = text.lower().split("x")
    if len(numbers) > 2 or not all(number.strip().isdecimal() for number in numbers):
        raise ConfigError(f"size '{text}': expected WIDTHxHEIGHT in pixels, such as 800x600, or one number for both")
    width, height = int(numbers[0]), int(numbers[-1])
    if not all(_SMALLEST <= number <= _LARGEST for number in (width, height)):
        raise ConfigError(f"size '{text}': expected {_SMALLEST} to {_LARGEST} pixels")
    return width, height


def cameras_of(meshes: Sequence[RenderedMesh], style: RenderStyle | None = None) -> list[Camera]:
    """Return the camera of each mesh; those that share one are zoomed out until all of them fit."""
    style = style or RenderStyle()
    groups: list[tuple[RenderedMesh, list[Mesh]]] = []
    places = []
    for shown in meshes:
        places_like = (i for i, (first, _) in enumerate(groups) if same_mesh(first.viewed_like, shown.viewed_like))
        place = next(places_like, len(groups))
        if place == len(groups):
            groups.append((shown, []))
        groups[place][1].append(shown.mesh)
        places.append(place)
    cameras = []
    for first, members in groups:
        target = first.viewed_like
        camera = camera_of(target, style.up or first.up, style.view).containing(*members)
        # Into a picture that is not square, the meshes are fitted by its aspect.
        if style.size is not None and style.size[0] != style.size[1]:
            camera, _ = camera.framing(target, *members, aspect=style.size[0] / style.size[1])
        cameras.append(camera)
    return [cameras[place] for place in places]


def same_mesh(first: Mesh, second: Mesh) -> bool:
    """Return whether two meshes have the same vertices and faces."""
    return first is second or (np.array_equal(first.verts, second.verts) and np.array_equal(first.faces, second.faces))


def _frame(name: str) -> str:
    return "tutorial" if name in NAMED_TARGETS else "none"


def _load(name: str) -> Mesh | PointCloud:
    """A named target in its tutorial frame, or a file of a mesh or points in its own coordinates."""
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
        measured_to = trial.measured_to if own else measurable(trial.frame.normalise(load_target(against)))
    up, like = planned_up(folder), trial.target
    meshes = [
        RenderedMesh(f"source, {name}", trial.source, like, None, up),
        RenderedMesh(f"result, {name}", trial.result, like, measured_to, up),
        RenderedMesh(trial.facts["target_title"], trial.target, like, None, up, trial.cloud),
    ]
    return meshes, settings.get("normalise", "tutorial")
