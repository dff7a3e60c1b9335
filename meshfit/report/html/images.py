"""Pictures as a page carries them: in its own text, as WebP, which is a tenth of the size of PNG."""

import base64
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.report.extra import needed
from meshfit.report.figures.camera import Camera, camera_of
from meshfit.report.figures.drawing import Image, draw
from meshfit.report.figures.surface_errors import shared_limit, worst_vert
from meshfit.report.figures.visibility import close_up
from meshfit.report.html.target_section import Subject, Subjects
from meshfit.report.tables.numbers import format_number

_QUALITY = 86


def data_uri(image: Image) -> str:
    """A picture as the source of an `<img>`."""
    content = io.BytesIO()
    needed("PIL.Image").fromarray(image).save(content, "WEBP", quality=_QUALITY, method=4)
    return f"data:image/webp;base64,{base64.b64encode(content.getvalue()).decode()}"


_Drawn = TypeVar("_Drawn")

_WIDTH = 480
_LARGE = 640
_INSET = (300, 300)
_NARROWEST = 0.8


@dataclass(frozen=True)
class Picture:
    """A picture and what is said of it.

    Attributes:
        source: of the `<img>`.
        size: width and height in pixels.
        title: in a few words.
        detail: what else there is to say; may be empty.
        alt: for those who do not see it.
    """

    source: str
    size: tuple[int, int]
    title: str
    detail: str
    alt: str


@dataclass(frozen=True)
class DistancePicture:
    """A result in the colours of its distances, and its worst place seen near by.

    Attributes:
        picture: the whole.
        inset: the worst place, with its edges.
        left: of the worst place in the whole, in percent from the left.
        top: likewise, from the top.
        hidden: whether the worst place is behind something there.
    """

    picture: Picture
    inset: Picture
    left: float
    top: float
    hidden: bool


@dataclass(frozen=True)
class _Frame:
    """What the pictures of a row have in common: a camera, and width by height."""

    camera: Camera
    aspect: float

    def size(self, width: int) -> tuple[int, int]:
        """Width and height in pixels."""
        return width, round(width / self.aspect)

    def fitting(self, mesh: Mesh) -> "_Frame":
        """The frame of a source, in its middle: at the scale of the others, unless it is too large for that."""
        camera, _ = self.camera.framing(mesh, aspect=self.aspect)
        return replace(self, camera=replace(camera, scale=max(camera.scale, self.camera.scale)))


@dataclass(frozen=True)
class Gallery:
    """All pictures of a wall.

    Attributes:
        plain: target, sources, results.
        distances: one for each result; none where there is no target.
        limit: where the scale of colours ends, which all of them share; as text.
        half: half of that.
        beyond: whether some distance is larger.
    """

    plain: tuple[Picture, ...]
    distances: tuple[DistancePicture, ...]
    limit: str
    half: str
    beyond: bool


def gallery_of(subjects: Subjects, tick: Callable[[], None]) -> Gallery:
    """Draw a wall; there is at least one subject to draw.

    Args:
        subjects: of the wall.
        tick: called after each picture.
    """
    limit, frame = limit_of(subjects), _frame_of(subjects)
    found = [subject.distances for subject in subjects.shown if subject.distances is not None]
    return Gallery(
        plain=tuple(_ticked(_plain(subjects, frame), tick)),
        distances=tuple(_ticked(_distances(subjects, frame, limit), tick)),
        limit=f"{limit:g}",
        half=f"{limit / 2:g}",
        beyond=any(float(each.max(initial=0.0)) > limit for each in found),
    )


def limit_of(subjects: Subjects) -> float:
    """Where the scale of distances ends, for all that shows them."""
    return shared_limit([subject.distances for subject in subjects.shown if subject.distances is not None])


def pictures_in(subjects: Subjects) -> int:
    """How many pictures `gallery_of` draws."""
    if not subjects.shown:
        return 0
    return (
        (subjects.target is not None)
        + len(sources_in(subjects.shown))
        + len(subjects.shown) * (2 if subjects.target is not None else 1)
    )


def sources_in(shown: Sequence[Subject]) -> list[tuple[str, Mesh]]:
    """The sources that differ, each with what tells those that began with it: their schemes, or else their labels."""
    found: list[tuple[list[Subject], Mesh]] = []
    for subject in shown:
        same = next((those for those, mesh in found if np.array_equal(mesh.verts, subject.source.verts)), None)
        if same is None:
            found.append(([subject], subject.source))
        else:
            same.append(subject)
    schemes = [", ".join(dict.fromkeys(str(each.exhibit.result["scheme"]) for each in those)) for those, _ in found]
    labels = ["; ".join(each.exhibit.label for each in those) for those, _ in found]
    names = schemes if len(set(schemes)) == len(schemes) else labels
    return [(name, mesh) for name, (_, mesh) in zip(names, found, strict=True)]


def _frame_of(subjects: Subjects) -> _Frame:
    """The target, if there is one, and all results within one frame, which is at most a little higher than wide."""
    meshes = [subject.result for subject in subjects.shown]
    meshes = meshes if subjects.target is None else [subjects.target, *meshes]
    camera, aspect = camera_of(meshes[0]).framing(*meshes)
    if aspect < _NARROWEST:
        camera, aspect = camera.framing(*meshes, aspect=_NARROWEST)
    return _Frame(camera, aspect)


def _ticked(pictures: Iterator[_Drawn], tick: Callable[[], None]) -> Iterator[_Drawn]:
    for picture in pictures:
        tick()
        yield picture


def _plain(subjects: Subjects, frame: _Frame) -> Iterator[Picture]:
    title = subjects.wall.title
    if subjects.target is not None:
        yield _drawn(subjects.target, frame, "target", title, f"The target, {title}")
    sources = sources_in(subjects.shown)
    for labels, mesh in sources:
        detail = labels if len(sources) > 1 else ""
        yield _drawn(mesh, frame.fitting(mesh), "source", detail, f"The source of {labels} for {title}")
    for subject in subjects.shown:
        exhibit = subject.exhibit
        detail = f"{subjects.wall.metric} {exhibit.figure}, seed {exhibit.seed}" if exhibit.figure else ""
        yield _drawn(subject.result, frame, exhibit.label, detail, f"The result of {exhibit.label} on {title}")


def _drawn(mesh: Mesh, frame: _Frame, title: str, detail: str, alt: str) -> Picture:
    size = frame.size(_WIDTH)
    image = draw(mesh, frame.camera, size=size, background=None)
    return Picture(data_uri(image), size, title, detail, f"{alt}: {mesh.num_faces:,} faces")


def _distances(subjects: Subjects, frame: _Frame, limit: float) -> Iterator[DistancePicture]:
    for subject in subjects.shown:
        if subject.distances is not None:
            yield _distance(subject, subject.distances, subjects.wall.title, frame, limit)


def _distance(subject: Subject, values: np.ndarray, title: str, frame: _Frame, limit: float) -> DistancePicture:
    mesh, limits, label, worst = subject.result, (0.0, limit), subject.exhibit.label, worst_vert(values)
    size = frame.size(_LARGE)
    whole = draw(mesh, frame.camera, size=size, values=values, limits=limits, background=None)
    near = close_up(mesh, worst, frame.camera)
    inset = draw(mesh, near.camera, size=_INSET, values=values, limits=limits, edges=True, background=None)
    right, up, _ = frame.camera.project(mesh.verts[[worst]])[0] * min(size) / 2
    farthest = format_number(float(values[worst]))
    return DistancePicture(
        Picture(data_uri(whole), size, label, f"farthest vert {farthest} off", f"Distances from {label} to {title}"),
        Picture(
            data_uri(inset),
            _INSET,
            "worst place",
            near.view,
            f"Edges around the worst place of {label}, {farthest} off",
        ),
        left=round(50 + 100 * float(right) / size[0], 2),
        top=round(50 - 100 * float(up) / size[1], 2),
        hidden=near.hidden,
    )
