"""The target of a trial: loaded, turned outwards, and normalised."""

import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from meshfit.config.target_settings import TargetSettings
from meshfit.errors import MeshError, MeshfitWarning
from meshfit.experiment.storage.targets import carried_name, carry, carry_images, read_carried
from meshfit.images.specs import is_image_target
from meshfit.images.target import ImageTarget
from meshfit.images.targets import content_sha256, load_images
from meshfit.mesh.cleaning import outward, with_turning
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame, frame_of
from meshfit.mesh.outer_surface import outer_surface
from meshfit.mesh.placing_options import Normalisation
from meshfit.mesh.point_cloud import MOST_HIDDEN, PointCloud, Position, hidden_from_sensor, seen_cloud
from meshfit.mesh.separate_pieces import describe_floaters, kept_pieces
from meshfit.mesh.targets import load_target
from meshfit.paths import path_text
from meshfit.units import count_text


class TrialTarget(NamedTuple):
    """A normalised target, its frame, the warnings of loading it, and a note for the log.

    A target of images has these, normalised, and what results are compared with.
    """

    frame: Frame
    mesh: Mesh | PointCloud
    warnings: tuple[str, ...]
    note: str
    images: ImageTarget | None = None
    reference: Mesh | PointCloud | None = None


@lru_cache(maxsize=2)  # a worker runs the trials of a target in succession, and loading takes longer than measuring
def load_trial_target(
    name: str,
    sha256: str | None,
    normalise: Normalisation,
    cleaning: CleaningOptions,
    settings: TargetSettings,
    carried: Path | None,
) -> TrialTarget:
    """Load a target, and normalise it.

    Args:
        name: its name, or the present path of its file, or of its copy in a run directory, which is taken as it is.
        sha256: of its content when the trial was planned; None if that is not known.
        normalise: the frame.
        cleaning: options for cleaning its file.
        settings: the part of it that counts, and where it was scanned from.
        carried: file to write it to, in its own coordinates; None for none.

    Raises:
        MeshError: it cannot be read, or has changed.
    """
    if is_image_target(name):
        return _load_image_target(name, sha256, normalise, carried)
    is_copy = sha256 is not None and Path(name).name == carried_name(sha256, cleaning)
    if not is_copy:
        check_unchanged(name, sha256)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        mesh = read_carried(Path(name)) if is_copy else load_target(name, cleaning)
    turned, texts = outward(mesh), warning_texts(caught)
    if turned is not mesh:  # fits match normals, and would turn the source inside out
        texts = with_turning(texts, "fit")
    carry(carried, lambda: turned)
    parts, note = kept_pieces(turned, settings.keep), ""
    if settings.keep is not None:
        note = _dropped_share(turned, parts)
    elif floaters := describe_floaters(turned):
        remedy = "set target.keep: largest, or meshfit fit --keep-pieces largest, if they are no part of the shape"
        texts = [*texts, f"{path_text(name)}: {floaters} draw the fit to them; {remedy}"]
    frame = frame_of(mesh.verts if parts is turned else parts.verts, normalise)
    fitted = turned = parts
    if isinstance(turned, PointCloud):
        fitted = seen_cloud(turned, settings.sensor)
        if settings.sensor is not None and turned.normals is None:
            texts = [*texts, *_doubts_of_sensor(turned, settings.sensor)]
        if settings.sensor is None and turned.sensor is not None and turned.normals is None:
            note = f"target: normals point towards its file's viewpoint, {turned.sensor}"
    elif settings.surface == "outer":
        fitted = outer_surface(turned)
        note = "" if fitted is turned else _hidden_share(turned, fitted)
    return TrialTarget(frame, frame.normalise(fitted), tuple(texts), note)


def _load_image_target(name: str, sha256: str | None, normalise: Normalisation, carried: Path | None) -> TrialTarget:
    """Load images, and normalise them by the frame of their shape, which needs no truth."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        loaded = load_images(name)
        if sha256 is not None and loaded.sha256 != sha256:
            raise MeshError(f"{name}: the images have changed since the run began; run the same command again")
        target = loaded.target
        shape = target.shape
    carry_images(carried, lambda: loaded)
    frame = frame_of(shape.verts, normalise)
    kind = count_text(shape.num_verts, "point") + " of depth maps" if isinstance(shape, PointCloud) else "visual hull"
    note, texts = f"target: {count_text(len(target.views), 'view')}; its shape: {kind}", tuple(warning_texts(caught))
    reference = None if target.reference is shape else frame.normalise(target.reference)
    return TrialTarget(frame, frame.normalise(shape), texts, note, target.moved(frame), reference)


def _doubts_of_sensor(cloud: PointCloud, sensor: Position) -> list[str]:
    """Return a warning if the points cannot have been seen from one place, as others are in front of them."""
    hidden = hidden_from_sensor(PointCloud(cloud.verts, None, sensor))
    if hidden < MOST_HIDDEN:
        return []
    place = ", ".join(f"{number:g}" for number in sensor)
    text = f"target.sensor: from ({place}), {100 * hidden:.0f} % of the points are hidden behind others"
    return [f"{text}, and their normals face inwards; give the place they were seen from, or none"]


def _dropped_share(whole: Mesh | PointCloud, kept: Mesh | PointCloud) -> str:
    if isinstance(whole, Mesh) and isinstance(kept, Mesh):
        return f"target.keep: {kept.num_faces:,} of {count_text(whole.num_faces, 'face')}"
    return f"target.keep: {kept.num_verts:,} of {count_text(whole.num_verts, 'point')}"


def _hidden_share(whole: Mesh, outer: Mesh) -> str:
    areas = [float(face_areas(mesh).sum()) for mesh in (whole, outer)]
    faces = count_text(outer.num_faces, "face")
    return f"target: its outer surface, {faces}; {1 - areas[1] / areas[0]:.1%} of its area is hidden"


def check_unchanged(name: str, sha256: str | None) -> None:
    """Check that a file has the content that the trial's identity is derived from.

    Raises:
        MeshError: it has changed since the trial was planned.
    """
    if sha256 is not None and content_sha256(name) != sha256:
        raise MeshError(f"{name}: the file has changed since the run began; run the same command again")


def warning_texts(caught: Sequence[warnings.WarningMessage]) -> list[str]:
    """Return the texts of meshfit's own warnings among those that were caught."""
    return [str(warning.message) for warning in caught if issubclass(warning.category, MeshfitWarning)]
