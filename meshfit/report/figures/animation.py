"""The moments of a fit that snapshots have kept: the source, the surface step by step, and the result."""

import csv
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from meshfit.errors import ConfigError, MeshfitWarning, StoreError
from meshfit.experiment.storage.checkpoint import snapshots_in
from meshfit.experiment.storage.run_directory import Result
from meshfit.fitting.gauss_newton.schedule import stage_at
from meshfit.fitting.settings import METHODS, GaussNewtonSettings
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.paths import write_error_message
from meshfit.report.extra import needed
from meshfit.report.figures.camera import camera_of
from meshfit.report.figures.drawing import Image, draw
from meshfit.report.figures.trial_meshes import TrialMeshes, trial_meshes
from meshfit.settings import build

_METRIC = "hausdorff.symmetric"


@dataclass(frozen=True)
class Moment:
    """The surface at one moment, and what is said of it."""

    mesh: Mesh
    said: str


@dataclass(frozen=True)
class Course:
    """A fit from its source to its result.

    Attributes:
        target: what it aimed at.
        moments: the source, the snapshots, and the result, in the target's normalised frame.
    """

    target: Mesh
    moments: tuple[Moment, ...]

    @property
    def changes_faces(self) -> bool:
        """Whether the connectivity changes on the way."""
        return len({moment.mesh.num_faces for moment in self.moments}) > 1


def course_of(folder: Path) -> Course:
    """Read the course of a complete trial; a surface that did not move is told of once.

    Raises:
        StoreError: a file cannot be read.
        MeshError: a mesh cannot be read, or the target is no longer there.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # of meshes that meshfit wrote itself
        meshes = trial_meshes(folder)
        said = _words(meshes.facts, folder)
        found = [Moment(mesh, said(step, mesh)) for step, mesh in _surfaces(meshes, folder)]
    moved = [found[0], *(now for before, now in pairwise(found) if not _same(before, now))]
    return Course(meshes.target, (*moved, Moment(meshes.result, _end(meshes.facts, meshes.result))))


def _surfaces(meshes: TrialMeshes, folder: Path) -> Iterator[tuple[int, Mesh]]:
    """The source, and each snapshot with the number of steps before it."""
    yield 0, meshes.source
    own = meshes.facts["settings"]["write_frame"] == "target"
    for step, path in snapshots_in(folder).items():
        mesh = load_mesh(path)
        yield step, meshes.frame.normalise(mesh) if own else mesh


def _same(before: Moment, now: Moment) -> bool:
    first, second = before.mesh, now.mesh
    return first.verts.tobytes() == second.verts.tobytes() and first.faces.tobytes() == second.faces.tobytes()


def _words(facts: Result, folder: Path) -> Callable[[int, Mesh], str]:
    """What is said of a surface: step, figure and verts; with several stages, the one that the step was a part of."""
    plain = facts["settings"]["fit"]
    settings = build(METHODS[plain.get("method", "first-order")], plain)
    name, values = _trace(folder)

    def said(step: int, mesh: Mesh) -> str:
        at = max((row for row in values if row <= step), default=None)
        stage = stage_at(settings, step - 1).name if isinstance(settings, GaussNewtonSettings) and step else ""
        where = f"step {step} of {settings.steps}" if step else "source"
        return _joined([stage, where, "" if at is None else f"{name} {values[at]:.2g}", f"{mesh.num_verts:,} verts"])

    return said


def _end(facts: Result, mesh: Mesh) -> str:
    group, _, key = _METRIC.partition(".")
    return _joined(["result", f"{METRICS[_METRIC].title} {facts[group][key]:.4g}", f"{mesh.num_verts:,} verts"])


def _joined(parts: Sequence[str]) -> str:
    return "  ·  ".join(filter(None, parts))


def _trace(folder: Path) -> tuple[str, Mapping[int, float]]:
    """What falls, by its name, and its value before each step that was traced."""
    path = folder / "trace.csv"
    try:
        head, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
        return head[1], {int(row[0]): float(row[1]) for row in rows}
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, IndexError) as error:
        raise StoreError(f"{path}: not a trace: {error}; run the trial again with --force") from None


SUFFIXES = (".mp4", ".gif")
_SECONDS_OF_FIRST, _SECONDS_OF_LAST = 0.5, 2.0
_TEXT = "#22303c"
_CAPTION = 0.075
"""Height of the caption, by that of the picture."""
_LEAST_TEXT = 9
_COLOURS = 128

Frame = tuple[Image, int]
"""A picture, and for how many frames it stays."""


def require_film(path: Path) -> None:
    """Refuse a file that is no film by its name.

    Raises:
        ConfigError: saying which are.
    """
    if path.suffix.lower() not in SUFFIXES:
        found = f"'{path.suffix}'" if path.suffix else "no suffix"
        raise ConfigError(f"{path}: {found} is not a film that can be written; allowed: {', '.join(SUFFIXES)}")


def frames_of(course: Course, *, size: int, fps: int, edges: bool | None = None) -> Iterator[Frame]:
    """Draw a fit, moment by moment, from where its target looks best; the last picture stays for a while.

    Args:
        course: what to draw.
        size: width and height of the meshes in pixels.
        fps: pictures a second.
        edges: draw the edges of faces; by default where the faces change on the way, and then not in the result.

    Raises:
        ConfigError: pyvista or pillow is not installed.
    """
    camera = camera_of(course.target).holding(*(moment.mesh for moment in course.moments))
    last, longest = len(course.moments) - 1, max((moment.said for moment in course.moments), key=len)
    for place, moment in enumerate(course.moments):
        shown = edges if edges is not None else course.changes_faces and place < last
        image = draw(moment.mesh, camera, size=(size, size), edges=shown)
        stays = {0: round(fps * _SECONDS_OF_FIRST), last: round(fps * _SECONDS_OF_LAST)}.get(place, 1)
        yield _captioned(image, moment.said, longest), max(1, stays)


def write_film(frames: Iterator[Frame], path: Path, fps: int) -> int:
    """Write a film, whole or not at all; the number of its frames is returned.

    Raises:
        ConfigError: it cannot be written, or what writes it is not installed.
    """
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        part.touch()
        count = _WRITERS[path.suffix.lower()](frames, part, fps)
        part.replace(path)
    except OSError as error:
        raise ConfigError(f"{path}: {write_error_message(path, error)}") from error
    finally:
        part.unlink(missing_ok=True)
    return count


def _captioned(image: Image, text: str, longest: str) -> Image:
    """A picture, of even width and height, as films need it, above a line of text in which the longest would fit."""
    pillow, drawing, fonts = needed("PIL.Image"), needed("PIL.ImageDraw"), needed("PIL.ImageFont")
    height, width = image.shape[:2]
    strip = 2 * round(_CAPTION * height / 2)
    page = pillow.new("RGB", (width + width % 2, height + height % 2 + strip), "white")
    page.paste(pillow.fromarray(np.ascontiguousarray(image[..., :3])))
    pen, at = drawing.Draw(page), (width / 2, height + strip * 0.4)
    largest = max(_LEAST_TEXT, round(0.5 * strip))
    sizes = (size for size in range(largest, _LEAST_TEXT - 1, -1))
    font = next(
        (one for size in sizes if pen.textlength(longest, one := fonts.load_default(size)) <= 0.96 * width),
        fonts.load_default(_LEAST_TEXT),
    )
    pen.text(at, text, fill=_TEXT, font=font, anchor="mm")
    return np.asarray(page, dtype=np.uint8)


def _write_mp4(frames: Iterator[Frame], path: Path, fps: int) -> int:
    first, *_ = frame = next(frames)
    size = (first.shape[1], first.shape[0])
    writer = needed("imageio_ffmpeg").write_frames(
        str(path), size, fps=fps, codec="libx264", quality=8, macro_block_size=2, ffmpeg_log_level="error"
    )
    writer.send(None)
    try:
        return sum(_send(writer, one) for one in _chained(frame, frames))
    finally:
        writer.close()


def _send(writer: Any, frame: Frame) -> int:  # noqa: ANN401  imageio-ffmpeg is optional
    image, stays = frame
    for _ in range(stays):
        writer.send(np.ascontiguousarray(image))
    return stays


def _chained(first: Frame, rest: Iterator[Frame]) -> Iterator[Frame]:
    yield first
    yield from rest


def _write_gif(frames: Iterator[Frame], path: Path, fps: int) -> int:
    pillow = needed("PIL.Image")
    pictures, stays = zip(*((pillow.fromarray(image).quantize(_COLOURS), stay) for image, stay in frames), strict=True)
    # GIF counts hundredths of a second, and viewers make two of one.
    _save_gif(pictures, path, [10 * max(2, round(100 * stay / fps)) for stay in stays])
    return sum(stays)


def _save_gif(pictures: Sequence[Any], path: Path, milliseconds: Sequence[int]) -> None:
    first, *rest = pictures
    first.save(path, save_all=True, append_images=rest, duration=list(milliseconds), loop=0, optimize=False)


_WRITERS: dict[str, Callable[[Iterator[Frame], Path, int], int]] = {".mp4": _write_mp4, ".gif": _write_gif}
