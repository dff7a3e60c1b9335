"""Pictures of a target section, embedded in the page as WebP, a tenth of the size of PNG."""

import base64
import io
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.mesh.mesh import Mesh
from meshfit.optional import import_optional
from meshfit.report.figures.camera import Camera, camera_of, close_up
from meshfit.report.figures.drawing import Image, draw
from meshfit.report.figures.trial_meshes import worst_vertex
from meshfit.report.figures.view_overlay import ShownView, draw_overlay
from meshfit.report.html.target_section import LoadedTrial, TargetSection
from meshfit.report.tables.numbers import format_number

_QUALITY = 86
_WIDTH, _LARGE_WIDTH, _VIEW_WIDTH = 480, 640, 360
_INSET = (300, 300)
_SMALLEST_ASPECT = 0.8


@dataclass(frozen=True)
class Picture:
    """A picture with its texts.

    Attributes:
        source: the `src` of the `<img>`.
        size: width and height in pixels.
        title: its title.
        detail: further text; may be empty.
        alt: the alternative text.
        inset: a close-up of the worst vertex, if it shows distances.
        ring: position of the worst vertex in percent from the left and the top.
        hidden: whether the worst vertex is hidden.
    """

    source: str
    size: tuple[int, int]
    title: str
    detail: str
    alt: str
    inset: "Picture | None" = None
    ring: tuple[float, float] = (0.0, 0.0)
    hidden: bool = False


def num_pictures(section: TargetSection) -> int:
    """Return the number of pictures that `draw_pictures`, `draw_distances` and `draw_views` draw."""
    with_target = section.target is not None
    per_trial = 1 + with_target + len(section.views)
    return (with_target + len(section.sources) + len(section.trials) * per_trial) if section.trials else 0


def draw_pictures(section: TargetSection) -> Iterator[Picture]:
    """Draw the target, the distinct sources and the results of a section."""
    if not section.trials:
        return
    camera, aspect = _framed(section)
    size = _WIDTH, round(_WIDTH / aspect)
    if section.drawn_target is not None:
        alt = f"The target, {section.title}: {section.target_size}"
        yield _picture(section.drawn_target, camera, size, section.target_name, section.title, alt)
    for name, mesh in section.sources:
        detail = name if len(section.sources) > 1 else ""
        alt = f"The source of {name} for {section.title}: {mesh.num_faces:,} faces"
        yield _picture(mesh, camera.centred_on(mesh, aspect), size, "source", detail, alt)
    for trial in section.trials:
        detail = f"{section.metric} {trial.value}, seed {trial.seed}" if trial.value else ""
        alt = f"The result of {trial.label} on {section.title}: {trial.mesh.num_faces:,} faces"
        yield _picture(trial.mesh, camera, size, trial.label, detail, alt)


def draw_distances(section: TargetSection) -> Iterator[Picture]:
    """Draw the results of a section in the colours of their distances, each with its worst vertex close up."""
    if not section.distances:
        return
    camera, aspect = _framed(section)
    size = _LARGE_WIDTH, round(_LARGE_WIDTH / aspect)
    for trial in section.trials:
        if trial.distances is not None:
            yield _distance_picture(trial, trial.distances, section, camera, size)


def draw_views(section: TargetSection) -> Iterator[tuple[str, Iterator[Picture]]]:
    """Draw the results of a section on views of a target of images; by the name of the row."""
    if section.views:
        for trial in section.trials:
            yield trial.label, (_view_picture(trial, shown) for shown in section.views)


def _view_picture(trial: LoadedTrial, shown: ShownView) -> Picture:
    image, iou = draw_overlay(trial.mesh, shown.view, _VIEW_WIDTH)
    alt = f"Outline of the result of {trial.label} on the mask of {shown.title}"
    return Picture(_data_uri(image), (image.shape[1], image.shape[0]), shown.title, f"IoU {iou:.3f}", alt)


def _framed(section: TargetSection) -> tuple[Camera, float]:
    """The camera that frames target and results, and width by height of its pictures, which are not too tall."""
    meshes = [trial.mesh for trial in section.trials]
    meshes = meshes if section.drawn_target is None else [section.drawn_target, *meshes]
    camera, aspect = camera_of(meshes[0], section.up).framing(*meshes)
    return camera.framing(*meshes, aspect=_SMALLEST_ASPECT) if aspect < _SMALLEST_ASPECT else (camera, aspect)


def _picture(mesh: Mesh, camera: Camera, size: tuple[int, int], title: str, detail: str, alt: str) -> Picture:
    image = draw(mesh, camera, size=size, background=None)
    return Picture(_data_uri(image), size, title, detail, alt)


def _distance_picture(
    trial: LoadedTrial,
    values: Float64[np.ndarray, " V"],
    section: TargetSection,
    camera: Camera,
    size: tuple[int, int],
) -> Picture:
    mesh, limits, worst = trial.mesh, (0.0, section.limit), worst_vertex(values)
    near, farthest = close_up(mesh, worst, camera), format_number(float(values[worst]))
    whole = draw(mesh, camera, size=size, values=values, limits=limits, background=None)
    inset = draw(mesh, near.camera, size=_INSET, values=values, limits=limits, edges=True, background=None)
    left, top = camera.pixel(mesh.verts[worst], size)
    alt = f"Edges around the farthest vertex of {trial.label}, at distance {farthest}"
    return Picture(
        source=_data_uri(whole),
        size=size,
        title=trial.label,
        detail=f"farthest vertex at distance {farthest}",
        alt=f"Distances from {trial.label} to {section.title}",
        inset=Picture(_data_uri(inset), _INSET, "close-up", near.view, alt),
        ring=(round(100 * left / size[0], 2), round(100 * top / size[1], 2)),
        hidden=near.hidden,
    )


def _data_uri(image: Image) -> str:
    content = io.BytesIO()
    import_optional("PIL.Image").fromarray(image).save(content, "WEBP", quality=_QUALITY, method=4)
    return f"data:image/webp;base64,{base64.b64encode(content.getvalue()).decode()}"
