"""Checks of the inputs of an experiment before its first trial starts: source, targets, landmarks and truth."""

import os
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.source_settings import SourceSettings
from meshfit.errors import ConfigError, Faults, MeshfitError, MeshfitWarning, error_prefix
from meshfit.experiment.guidance import guidance_of, landmarks_path, read_landmarks
from meshfit.experiment.source import build_source, is_own_mesh, source_files, stand_in
from meshfit.experiment.truth import truth_path, vertex_counts
from meshfit.fitting.external.tools import TOOLS
from meshfit.fitting.registration.guidance import NO_GUIDANCE
from meshfit.fitting.settings import ExternalSettings, FirstOrderSettings, FitSettings, GaussNewtonSettings
from meshfit.images.specs import RenderedViews, image_spec, is_image_target, label_of_target
from meshfit.images.targets import load_images, load_shape
from meshfit.mesh.cleaning import with_turning
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.places import Numbering
from meshfit.mesh.targets import file_sha256, target_path
from meshfit.paths import is_folder, looks_like_path, path_text
from meshfit.subdivision.growth import require_memory_for_levels
from meshfit.subdivision.registry import NamedScheme
from meshfit.units import count_text

# About the faces of a visual hull, for estimates of time before it has been carved.
_HULL_FACES = 60_000


class TargetCopy(NamedTuple):
    """A copy of a target in a run directory.

    Attributes:
        name: the target, as its trials record it; of images, the path of the copy.
        path: path of the copy.
        sha256: of the file or files that it was made from.
    """

    name: str
    path: Path
    sha256: str


CopyFinder = Callable[[str, str, str, CleaningOptions], TargetCopy | None]
"""Function that finds the copy of a target whose file is missing, by the name of the experiment, the target as the
config names it, its short name, and the cleaning of its file."""


class CheckedInputs(NamedTuple):
    """The inputs of an experiment that can be used.

    Attributes:
        source: SHA-256 of the files of the source, by role.
        targets: SHA-256 of each target that can be used.
        faults: why each other target cannot be used, in one line.
        copies: copies of targets whose files are missing.
    """

    source: tuple[tuple[str, str], ...]
    targets: dict[str, str]
    faults: dict[str, str]
    copies: dict[str, TargetCopy]


Errors = dict[tuple[str, CleaningOptions], MeshfitError]
"""Why targets cannot be loaded."""


def check_inputs(
    settings: ExperimentSettings,
    schemes: tuple[NamedScheme, ...],
    errors_in_loading: Errors,
    copies: Mapping[str, TargetCopy],
) -> CheckedInputs:
    """Load the source and each target once, and read what is known of both.

    Args:
        settings: the settings.
        schemes: the schemes, with their definitions.
        errors_in_loading: those that are known, to which further ones are added, so that a damaged file is read once
            for all points of a sweep.
        copies: copies of targets whose files are missing.

    Raises:
        MeshfitError: the source cannot be used, or none of the targets, or one is neither the path of a file nor a name
            of `NAMED_TARGETS`; with a line for the source and each target at fault.
    """
    source: tuple[tuple[str, str], ...] = ()
    faults = Faults()
    with faults.collected():
        files = _state(*source_files(settings.source).values())
        source = _check_source(settings.source, schemes, files)
        _check_symmetry(settings.source, schemes, settings.fit, files)
        if settings.target.truth is not None:
            _check_vertices_stay(settings)
    is_sound = not faults
    checked = {
        target: _checked(target, settings, schemes if is_sound else (), errors_in_loading, copies.get(target))
        for target in settings.targets
    }
    errors = {target: error for target, error in checked.items() if isinstance(error, MeshfitError)}
    if not is_sound or len(errors) == len(checked) or any(map(_is_misspelt, errors)):
        for error in errors.values():
            with faults.collected():
                raise error
        faults.raise_any()
    targets = {target: sha256 for target, sha256 in checked.items() if isinstance(sha256, str)}
    used = {target: copy for target, copy in copies.items() if target in targets}
    for target, copy in used.items():
        text = f"{path_text(target)}: no such file; its copy in the run directory is used: {copy.path}"
        warnings.warn(text, MeshfitWarning, stacklevel=2)
    texts = {target: "; ".join(error.faults) for target, error in errors.items()}
    return CheckedInputs(source, targets, texts, used)


def _is_misspelt(target: str) -> bool:
    """Whether what is not a target was meant as the name of one, rather than as a file."""
    return not (is_image_target(target) or looks_like_path(target) or os.path.lexists(target))


def _checked(
    target: str,
    settings: ExperimentSettings,
    schemes: tuple[NamedScheme, ...],
    errors_in_loading: Errors,
    copy: TargetCopy | None,
) -> str | MeshfitError:
    """Return the SHA-256 of a target, or why it cannot be used; with schemes, read its landmarks and truth, too."""
    key = target, settings.cleaning
    if key in errors_in_loading:
        return errors_in_loading[key]
    try:
        checked = checked_target(target, settings.cleaning) if copy is None else _checked_copy(copy, settings.cleaning)
    except MeshfitError as error:
        errors_in_loading[key] = error
        return error
    try:
        _check_kind(target, checked, settings)
        if schemes:
            _check_what_is_known(target, settings, schemes)
    except MeshfitError as error:
        return error
    return checked.sha256


def _check_what_is_known(target: str, settings: ExperimentSettings, schemes: tuple[NamedScheme, ...]) -> None:
    """Read the landmarks and the truth of a target.

    Raises:
        MeshfitError: they cannot be read, or do not go with the source or the target.
    """
    label = label_of_target(target)
    places = landmarks_path(settings, label)
    files = _state(*source_files(settings.source).values(), places, target)
    _check_guidance(settings.source, schemes, places, target, settings.cleaning, files)
    for scheme in schemes if settings.target.truth is not None else ():
        _check_truth(settings, label, scheme)


def _check_vertices_stay(settings: ExperimentSettings) -> None:
    """Refuse a truth for results whose vertices are not those of one source.

    Raises:
        ConfigError: naming the setting.
    """
    if settings.source.is_made_from_target:
        made = f"made from the target ({settings.source.mesh})"
        raise ConfigError(
            f"target.truth: the vertices of a source that is {made} belong nowhere; set source.mesh to a file, or "
            "remove it"
        )
    if getattr(settings.fit, "connectivity", "fixed") != "fixed":
        raise ConfigError(
            "target.truth: a remeshed result has other vertices than the source; set fit.connectivity: fixed, or "
            "remove it"
        )


def _check_truth(settings: ExperimentSettings, target: str, scheme: NamedScheme) -> None:
    """Read the file of the truth.

    Raises:
        MeshfitError: it cannot be read, or has another number of vertices.
    """
    path = truth_path(settings, target, scheme.spec)
    assert path is not None  # noqa: S101  the settings have one
    vertex_counts(settings.source, scheme, settings.fit).truth(path, path)


def _state(*names: str | None) -> tuple[object, ...]:
    """Return what changes when files do, so that what was read of them is not taken for what they hold now."""
    found = list[object]()
    for name in filter(None, names):
        place = Path(name)
        paths = sorted(place.rglob("*")) if is_folder(place) else [place]
        for path in paths:
            with suppress(OSError):
                status = path.stat()
                found.append((str(path), status.st_mtime_ns, status.st_size, status.st_ino))
    return tuple(found)


@cache
def _check_guidance(
    source: SourceSettings,
    schemes: tuple[NamedScheme, ...],
    target_landmarks: str | None,
    target: str,
    cleaning: CleaningOptions,
    _files: tuple[object, ...],
) -> None:
    """Read the landmarks and the values of vertices.

    Raises:
        MeshfitError: they cannot be read, or do not go with the source or the target.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # a trial gives them
        landmarks = read_landmarks(source, target_landmarks)
        if landmarks is not None and landmarks.goals_are_numbered:
            landmarks.goal_positions(load_shape(target, cleaning), Numbering.of_file(target))
        guidance_of(source.model_copy(update={"levels": 0, "wanted_verts": None}), schemes[0].resolve())


@cache
def _check_symmetry(
    source: SourceSettings, schemes: tuple[NamedScheme, ...], fit: FitSettings, _files: tuple[object, ...]
) -> None:
    """Check that a source, or its first level, is symmetric where the fit is to keep it so.

    Raises:
        MeshfitError: it is not, or it is not registered.
    """
    if not (isinstance(fit, GaussNewtonSettings) and fit.symmetric):
        return
    if fit.register == "auto" and not is_own_mesh(source):
        raise ConfigError(
            f"fit.symmetric: source.mesh: {source.mesh} is made to start from, and is not registered; set source.mesh "
            "to a file, or remove it"
        )
    short = source.model_copy(update={"levels": min(source.levels, 1), "wanted_verts": None})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # a trial gives them
        for scheme in schemes:
            masks = scheme.resolve()
            known = guidance_of(short, masks) or NO_GUIDANCE
            with error_prefix("fit"):
                known.mirrored(build_source(stand_in(short), masks, scheme.spec))


class CheckedTarget(NamedTuple):
    """A target that can be loaded.

    Attributes:
        sha256: of its file, or of all that images are made from.
        faces: their number; of images, about that of their shape.
        points: their number, where there are no faces.
        fault: why no closed surface can be fitted to the points, in words; empty if one can.
        views: number of images; 0 for a mesh or points.
        maps: what all images have besides masks, of `depth` and `normals`.
    """

    sha256: str
    faces: int
    points: int
    fault: str
    views: int = 0
    maps: tuple[str, ...] = ()


def checked_target(target: str, cleaning: CleaningOptions) -> CheckedTarget:
    """Load a target, once in this process unless its files change, and return what a plan needs to know of it."""
    return _checked_target(target, cleaning, _state(*_files_of(target)))


def _files_of(target: str) -> tuple[str, ...]:
    """Return the files and folders that a target is read from."""
    if not is_image_target(target):
        return (target,)
    spec = image_spec(target)
    return (spec.of,) if isinstance(spec, RenderedViews) else (spec.images, spec.cameras, spec.truth)


@cache
def _checked_target(target: str, cleaning: CleaningOptions, _files: tuple[object, ...]) -> CheckedTarget:
    from meshfit.mesh.point_cloud import PointCloud, no_closed_surface

    if is_image_target(target):
        images = load_images(target)
        shape = images.target.shape if images.target.views.have_depth else None
        points = 0 if shape is None else shape.num_verts
        fault = no_closed_surface(shape) if isinstance(shape, PointCloud) else ""
        faces = 0 if points else _HULL_FACES
        views = images.target.views
        return CheckedTarget(images.sha256, faces, points, fault, len(views), views.maps)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        loaded = load_shape(target, cleaning)
    for warning in caught:  # in the words of the trials, so that each is shown once
        warnings.warn(with_turning([str(warning.message)], "fit")[0], warning.category, stacklevel=2)
    points = 0 if loaded.num_faces else loaded.num_verts
    fault = no_closed_surface(loaded) if isinstance(loaded, PointCloud) else ""
    return CheckedTarget(file_sha256(target_path(target)), loaded.num_faces, points, fault)


def _checked_copy(copy: TargetCopy, cleaning: CleaningOptions) -> CheckedTarget:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # those of its file were given when that was read
        return checked_target(str(copy.path), cleaning)._replace(sha256=copy.sha256)


def _check_images(name: str, checked: CheckedTarget, settings: ExperimentSettings) -> None:
    """Refuse settings that images make needless, and those that only images have."""
    if settings.source.mesh == "hull" and not checked.views:
        raise ConfigError(f"{name}: not given by images, whose masks have a visual hull; use source.mesh: auto")
    if checked.views and settings.target.surface == "outer":
        raise ConfigError(f"{name}: images show the outside alone; remove target.surface: outer")
    if checked.views and settings.target.keep is not None:
        raise ConfigError(f"{name}: images have no pieces to choose from before the fit; remove target.keep")
    if settings.target.sensor is not None and (checked.views or not checked.points):
        known = "its cameras are known" if checked.views else "its faces tell the outside"
        raise ConfigError(f"{name}: {known}, so target.sensor has no effect; remove it")


def _check_kind(target: str, checked: CheckedTarget, settings: ExperimentSettings) -> None:
    """Refuse settings that do not go with a target of points, or with one of faces.

    Raises:
        ConfigError: naming the setting.
    """
    fit, name = settings.fit, path_text(target)
    _check_images(name, checked, settings)
    if isinstance(fit, FirstOrderSettings) and (fault := fit.fault_with(checked.maps if checked.views else None)):
        raise ConfigError(f"{name}: fit.{fault}")
    if not checked.points or (checked.views and isinstance(fit, FirstOrderSettings)):
        return
    cloud = f"{name}: a cloud of {count_text(checked.points, 'point')}, without the faces that"
    if isinstance(fit, FirstOrderSettings):
        raise ConfigError(f"{cloud} fit.method: first-order samples; use fit.method: gauss-newton")
    if isinstance(fit, ExternalSettings) and not fit.takes_points:
        able = [tool for tool, entry in TOOLS.items() if entry.points]
        remedy = f"fit.tool: {', '.join(able)}" if fit.tool is not None else "fit.format: ply or obj"
        raise ConfigError(f"{cloud} {fit.name} needs; use {remedy}, or fit.method: gauss-newton")
    if settings.target.surface == "outer":
        raise ConfigError(f"{cloud} target.surface: outer selects from; remove it")
    if settings.source.mesh == "target":
        raise ConfigError(f"{cloud} source.mesh: target starts from; use source.mesh: wrap or auto")
    if checked.fault and not source_files(settings.source):
        raise ConfigError(f"{name}: {checked.fault}")


@cache
def _check_source(
    settings: SourceSettings, schemes: tuple[NamedScheme, ...], _files: tuple[object, ...]
) -> tuple[tuple[str, str], ...]:
    """Build the first level of a source with each scheme, and return the SHA-256 of its files, by role.

    A control mesh that will be made from a target is not made yet, as this takes seconds for each.
    """
    files = source_files(settings)
    for scheme in schemes:
        short = stand_in(settings.model_copy(update={"levels": 0, "wanted_verts": None}))
        control = build_source(short, scheme.resolve(), scheme.spec)
        with error_prefix("source.levels"):
            require_memory_for_levels(control, scheme.resolve(), settings.levels)
        if settings.levels:
            build_source(short.model_copy(update={"levels": 1}), scheme.resolve(), scheme.spec)
    return tuple((role, file_sha256(target_path(name))) for role, name in files.items())
