"""Animations of fits from their snapshots: the source, the surface step by step, and the result."""

import csv
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from meshfit.errors import ConfigError, MeshfitWarning, StoreError
from meshfit.experiment.storage.checkpoint import snapshots_in
from meshfit.experiment.storage.plan_file import UpChoice, planned_up
from meshfit.experiment.storage.run_directory import Result
from meshfit.fitting.gauss_newton.schedule import stage_at
from meshfit.fitting.settings import METHODS, GaussNewtonSettings
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.mesh import Mesh
from meshfit.optional import import_optional
from meshfit.paths import write_error_message
from meshfit.report.figures.camera import camera_of, is_turned
from meshfit.report.figures.colours import INK
from meshfit.report.figures.drawing import Image, draw
from meshfit.report.figures.trial_meshes import TrialMeshes, read_normalised, read_trial_meshes
from meshfit.settings import build

SUFFIXES = (".mp4", ".gif")

_METRIC = "hausdorff.symmetric"
_SECONDS_OF_FIRST, _SECONDS_OF_LAST = 0.5, 2.0
_CAPTION = 0.075  # height of the caption, as a share of the picture's
_SMALLEST_FONT = 9
_COLOURS = 128

TimedImage = tuple[Image, int]
"""A picture, and the number of video frames it stays."""


@dataclass(frozen=True)
class AnimationFrame:
    """The surface at one step, and the caption below it."""

    mesh: Mesh
    caption: str


@dataclass(frozen=True)
class Animation:
    """A fit from its source to its result.

    Attributes:
        target: the target.
        frames: the source, the snapshots and the result, in the target's normalised frame.
        up: the axis that points up.
        view: as for `camera_of`.
    """

    target: Mesh
    frames: tuple[AnimationFrame, ...]
    up: UpChoice = "auto"
    view: str = "best"

    @property
    def is_turned(self) -> bool:
        """Whether z is up because the target seems to stand that way."""
        return is_turned(self.target, self.up)

    @property
    def changes_faces(self) -> bool:
        """Whether the connectivity changes during the fit."""
        return len({frame.mesh.num_faces for frame in self.frames}) > 1


def read_animation(folder: Path, up: UpChoice | None = None) -> Animation:
    """Read the animation of a complete trial; consecutive equal surfaces give one frame.

    Args:
        folder: the folder of the trial.
        up: the axis that points up; by default that of its experiment.

    Raises:
        StoreError: a file cannot be read.
        MeshError: a mesh cannot be read, or the target no longer exists.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # about meshes that meshfit itself wrote
        trial = read_trial_meshes(folder)
        caption = _captions(trial.facts, folder)
        frames = [AnimationFrame(mesh, caption(step, mesh)) for step, mesh in _surfaces(trial, folder)]
    moved = [frames[0], *(after for before, after in pairwise(frames) if not _equal(before.mesh, after.mesh))]
    last = AnimationFrame(trial.result, _last_caption(trial.facts, trial.result))
    return Animation(trial.target, (*moved, last), up or planned_up(folder))


def _surfaces(trial: TrialMeshes, folder: Path) -> Iterator[tuple[int, Mesh]]:
    """The source, and each snapshot with the number of steps before it."""
    yield 0, trial.source
    for step, path in snapshots_in(folder).items():
        yield step, read_normalised(path, trial.facts)


def _equal(first: Mesh, second: Mesh) -> bool:
    return first.verts.tobytes() == second.verts.tobytes() and first.faces.tobytes() == second.faces.tobytes()


def _captions(facts: Result, folder: Path) -> Callable[[int, Mesh], str]:
    """The captions of surfaces: the stage if the fit has several, step, traced value and number of vertices."""
    fit = facts["settings"]["fit"]
    settings = build(METHODS[fit.get("method", "first-order")], fit)
    name, values = ("", {}) if settings.method == "external" else _read_trace(folder)

    def caption(step: int, mesh: Mesh) -> str:
        traced = max((row for row in values if row <= step), default=None)
        stage = stage_at(settings, step - 1).name if isinstance(settings, GaussNewtonSettings) and step else ""
        place = f"step {step} of {settings.steps}" if step else "source"
        return _joined(stage, place, "" if traced is None else f"{name} {values[traced]:.2g}", _size(mesh))

    return caption


def _last_caption(facts: Result, mesh: Mesh) -> str:
    group, _, key = _METRIC.partition(".")
    return _joined("result", f"{METRICS[_METRIC].title} {facts[group][key]:.4g}", _size(mesh))


def _size(mesh: Mesh) -> str:
    return f"{mesh.num_verts:,} vertices"


def _joined(*parts: str) -> str:
    return "  ·  ".join(filter(None, parts))


def _read_trace(folder: Path) -> tuple[str, Mapping[int, float]]:
    """The name of the quantity that the fit minimises, and its value before each traced step."""
    path = folder / "trace.csv"
    try:
        head, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
        return head[1], {int(row[0]): float(row[1]) for row in rows}
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, IndexError, csv.Error) as error:
        raise StoreError(f"{path}: not a trace: {error}; run the trial again with --force") from None


def require_video_suffix(path: Path) -> None:
    """Refuse a path whose suffix is not one of `SUFFIXES`.

    Raises:
        ConfigError: naming the allowed suffixes.
    """
    if path.suffix.lower() not in SUFFIXES:
        found = f"'{path.suffix}'" if path.suffix else "no suffix"
        raise ConfigError(f"{path}: {found} is not a video format; allowed: {', '.join(SUFFIXES)}")


def draw_animation(animation: Animation, *, size: int, fps: int, edges: bool | None = None) -> Iterator[TimedImage]:
    """Draw the frames one by one from the target's camera; the first and the last stay for a while.

    Args:
        animation: the fit.
        size: width and height of the meshes in pixels.
        fps: video frames per second.
        edges: draw the edges of faces; by default if the faces change during the fit, except in the result.

    Raises:
        ConfigError: pyvista or pillow is not installed.
    """
    frames = animation.frames
    camera = camera_of(animation.target, animation.up, animation.view).containing(*(frame.mesh for frame in frames))
    last, longest = len(frames) - 1, max((frame.caption for frame in frames), key=len)
    for place, frame in enumerate(frames):
        with_edges = edges if edges is not None else animation.changes_faces and place < last
        image = draw(frame.mesh, camera, size=(size, size), edges=with_edges)
        stays = {0: round(fps * _SECONDS_OF_FIRST), last: round(fps * _SECONDS_OF_LAST)}.get(place, 1)
        yield _captioned(image, frame.caption, longest), max(1, stays)


def write_video(images: Iterator[TimedImage], path: Path, fps: int) -> int:
    """Write a video completely or not at all, and return the number of its frames.

    Raises:
        ConfigError: it cannot be written, or a library is not installed.
    """
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        part.touch()
        count = _WRITERS[path.suffix.lower()](images, part, fps)
        part.replace(path)
    except OSError as error:
        raise ConfigError(f"{path}: {write_error_message(path, error)}") from error
    finally:
        part.unlink(missing_ok=True)
    return count


def _captioned(image: Image, text: str, longest: str) -> Image:
    """A picture above a caption, in a font size at which the longest caption fits.

    Width and height are even, as video codecs require.
    """
    pillow, drawing, fonts = (import_optional(f"PIL.{name}") for name in ("Image", "ImageDraw", "ImageFont"))
    height, width = image.shape[:2]
    strip = 2 * round(_CAPTION * height / 2)
    page = pillow.new("RGB", (width + width % 2, height + height % 2 + strip), "white")
    page.paste(pillow.fromarray(np.ascontiguousarray(image[..., :3])))
    pen, middle = drawing.Draw(page), (width / 2, height + strip * 0.4)
    largest = max(_SMALLEST_FONT, round(0.5 * strip))
    sizes = range(largest, _SMALLEST_FONT - 1, -1)
    fitting = (size for size in sizes if pen.textlength(longest, fonts.load_default(size)) <= 0.96 * width)
    font = fonts.load_default(next(fitting, _SMALLEST_FONT))
    pen.text(middle, text, fill=INK, font=font, anchor="mm")
    return np.asarray(page, dtype=np.uint8)


def _write_mp4(images: Iterator[TimedImage], path: Path, fps: int) -> int:
    first = next(images)
    size = (first[0].shape[1], first[0].shape[0])
    writer = import_optional("imageio_ffmpeg").write_frames(
        str(path), size, fps=fps, codec="libx264", quality=8, macro_block_size=2, ffmpeg_log_level="error"
    )
    writer.send(None)
    try:
        return sum(_send(writer, image) for image in chain([first], images))
    finally:
        writer.close()


def _send(writer: Any, timed: TimedImage) -> int:  # noqa: ANN401  imageio-ffmpeg is optional
    image, stays = timed
    for _ in range(stays):
        writer.send(np.ascontiguousarray(image))
    return stays


def _write_gif(images: Iterator[TimedImage], path: Path, fps: int) -> int:
    pillow = import_optional("PIL.Image")
    pictures, stays = zip(*((pillow.fromarray(image).quantize(_COLOURS), stay) for image, stay in images), strict=True)
    # GIF counts hundredths of a second, and viewers slow frames of one down.
    durations = [10 * max(2, round(100 * stay / fps)) for stay in stays]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=False)
    return sum(stays)


_WRITERS: Mapping[str, Callable[[Iterator[TimedImage], Path, int], int]] = {".mp4": _write_mp4, ".gif": _write_gif}
