"""The source of a trial: a control mesh, placed, and refined by the trial's scheme."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from meshfit.config.experiment import SourceSettings
from meshfit.errors import ConfigError, MeshError, MeshfitError
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.solids import SOLIDS
from meshfit.mesh.targets import NAMED_TARGETS, load_numbered_target, target_path
from meshfit.mesh.topology import Indices, Topology
from meshfit.mesh.vertex_values import read_attribute, read_values
from meshfit.specs import parse_spec, suggest
from meshfit.subdivision.choose import declared
from meshfit.subdivision.crease_files import read_creases
from meshfit.subdivision.creases import Creases, creases_by_angle
from meshfit.subdivision.refine import refine, require_takes_creases
from meshfit.subdivision.scheme import Scheme

_ICOSPHERE_LEVEL = 2
_MOST_LEVELS = 8


@dataclass(frozen=True)
class _Ball:
    """The sphere that verts are put on after each level."""

    centre: tuple[float, float, float]
    radius: float

    def put(self, verts: Verts) -> Verts:
        offset = verts - np.asarray(self.centre)
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        return np.asarray(self.centre + offset * (self.radius / length))


def build_source(settings: SourceSettings, scheme: str | Scheme, name: str = "this scheme") -> Mesh:
    """The mesh that a fit starts from.

    Args:
        settings: which control mesh, how it is placed, creased and weighed, and how many levels.
        scheme: the scheme that refines it, or its spec.
        name: what messages call a scheme that is given as such.

    Raises:
        ConfigError: the control mesh is neither a base, nor a target, nor a file; or it is decimated, and a file counts
            the verts that it had before.
        MeshError: it, or a file that goes with it, cannot be used.
        SchemeError: no such scheme, or one that takes no creases or has no alpha.
    """
    mesh, numbering = _control(settings)
    masks, name = declared(scheme), scheme if isinstance(scheme, str) else name
    creases = _creases(settings, masks, name, mesh, numbering)
    masks = _with_alphas(settings, masks, name, numbering)
    try:
        return _refined(mesh, settings, masks, creases)
    except MeshError as error:
        raise MeshError(f"{settings.mesh}: {error}") from None


def _refined(mesh: Mesh, settings: SourceSettings, scheme: Scheme, creases: Creases | None) -> Mesh:
    refinement = refine(Topology.of(mesh), scheme, settings.levels, creases)
    if settings.project == "none":
        return Mesh(refinement(mesh.verts), refinement.faces)
    ball = _ball_about(mesh)
    verts = ball.put(mesh.verts)
    for operator in refinement.operators:
        verts = ball.put(operator @ verts)
    return Mesh(verts, refinement.faces)


def _creases(
    settings: SourceSettings, masks: Scheme, name: str, mesh: Mesh, numbering: Indices | None
) -> Creases | None:
    wanted = settings.creases
    if wanted is None:
        return None
    sharpness = inf if wanted.sharpness is None else wanted.sharpness
    with _naming("source.creases"):
        require_takes_creases(masks, name)
        if wanted.angle is not None:
            return creases_by_angle(mesh, wanted.angle, sharpness)
        assert wanted.file is not None  # noqa: S101  one of both is there
        return read_creases(wanted.file, Topology.of(mesh), _undecimated(settings, numbering), sharpness)


def _with_alphas(settings: SourceSettings, masks: Scheme, name: str, numbering: Indices | None) -> Scheme:
    wanted = settings.alpha
    if wanted is None:
        return masks
    with _naming(f"source.alpha: {name}"):
        masks = masks.with_alpha(0.0)
    with _naming("source.alpha"):
        verts = _undecimated(settings, numbering)
        if wanted.file is not None:
            return masks.with_alpha(read_values(wanted.file, verts, (0.0, 1.0)))
        assert wanted.attribute is not None  # noqa: S101  one of both is there
        path = source_file(settings)
        if path is None:
            raise MeshError(f"attribute: {settings.mesh} is no file that could have one")
        return masks.with_alpha(read_attribute(path, wanted.attribute, verts, (0.0, 1.0)))


@contextmanager
def _naming(key: str) -> Iterator[None]:
    """Put the key at fault in front of what is said."""
    try:
        yield
    except MeshfitError as error:
        raise type(error)(f"{key}: {error}") from None


def _undecimated(settings: SourceSettings, numbering: Indices | None) -> Indices:
    if numbering is None:
        raise ConfigError(
            f"it counts the verts of {settings.mesh}, of which source.decimate leaves others; set it to null"
        )
    return numbering


def control_mesh(settings: SourceSettings) -> Mesh:
    """The control mesh, decimated and placed, before any refinement.

    Raises:
        ConfigError, MeshError: as `build_source`.
    """
    return _control(settings)[0]


def _control(settings: SourceSettings) -> tuple[Mesh, Indices | None]:
    """The same, and which vertex each of its file's is; None if it was decimated."""
    mesh, found = _named_or_file(settings.mesh)
    numbering: Indices | None = found
    if settings.decimate is not None and settings.decimate < mesh.num_faces:
        mesh, numbering = decimate(mesh, settings.decimate), None
    mean = mesh.verts.mean(axis=0)
    offset = mesh.verts - mean
    extent = float(np.linalg.norm(offset, axis=1).max())
    if not extent > 0:
        raise MeshError(f"source.mesh: {settings.mesh}: the mesh has no extent")
    scale = 1.0 if settings.radius is None else settings.radius / extent
    return Mesh(offset * scale + (mean if settings.centre is None else settings.centre), mesh.faces), numbering


def source_file(settings: SourceSettings) -> Path | None:
    """The file that the control mesh is read from; None for a base that meshfit builds itself.

    Raises:
        ConfigError: neither a base, nor a target, nor a file.
    """
    if _is_base(settings.mesh):
        return None
    if settings.mesh in NAMED_TARGETS or Path(settings.mesh).is_file():
        return target_path(settings.mesh)
    allowed = [*SOLIDS, "icosphere", *NAMED_TARGETS]
    raise ConfigError(f"source.mesh: '{settings.mesh}': {suggest(settings.mesh, allowed)}, or the path of a mesh file")


def source_files(settings: SourceSettings) -> dict[str, str]:
    """The files that the source is made from, by role, as the settings name them.

    Raises:
        ConfigError: as `source_file`.
    """
    creases, alpha = settings.creases, settings.alpha
    names = {
        "source": settings.mesh if source_file(settings) is not None else None,
        "creases": creases.file if creases is not None else None,
        "alpha": alpha.file if alpha is not None else None,
    }
    return {role: name for role, name in names.items() if name is not None}


def relocated(settings: SourceSettings, where: Callable[[str], str]) -> SourceSettings:
    """The same settings with files where they lie now."""
    changes: dict[str, object] = {"mesh": where(settings.mesh)}
    for key, files in (("creases", settings.creases), ("alpha", settings.alpha)):
        if files is not None and files.file is not None:
            changes[key] = files.model_copy(update={"file": where(files.file)})
    return settings.model_copy(update=changes)


def _named_or_file(name: str) -> tuple[Mesh, Indices]:
    if _is_base(name):
        mesh = SOLIDS[name]() if name in SOLIDS else _icosphere(name)
        return mesh, np.arange(mesh.num_verts)
    source_file(SourceSettings(mesh=name))
    return load_numbered_target(name)


def _is_base(name: str) -> bool:
    return name in SOLIDS or name.partition(":")[0] == "icosphere"


def _icosphere(name: str) -> Mesh:
    parameters = dict(parse_spec(name).parameters)
    level = parameters.pop("level", _ICOSPHERE_LEVEL)
    if parameters or not isinstance(level, int) or not 0 <= level <= _MOST_LEVELS:
        raise ConfigError(f"source.mesh: '{name}': icosphere takes one parameter, level, from 0 to {_MOST_LEVELS}")
    return build_source(SourceSettings(levels=level, project="sphere"), "midpoint")


def _ball_about(mesh: Mesh) -> _Ball:
    centre = mesh.verts.mean(axis=0)
    radius = float(np.linalg.norm(mesh.verts - centre, axis=1).max())
    return _Ball((float(centre[0]), float(centre[1]), float(centre[2])), radius)
