"""The control mesh of a trial's source: a base, a target or a file, decimated and placed; and what files it takes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from meshfit.config.experiment import SourceSettings
from meshfit.errors import ConfigError, MeshError
from meshfit.experiment.ball import refined_on_ball
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import POLYGON_SOLIDS, SOLIDS
from meshfit.mesh.targets import NAMED_TARGETS, load_numbered_polygon_target, load_numbered_target, target_path
from meshfit.mesh.topology import Indices, Topology
from meshfit.specs import parse_spec, suggest
from meshfit.subdivision.refine import refine
from meshfit.subdivision.triangle_table import MIDPOINT

_ICOSPHERE_LEVEL = 2
_MOST_LEVELS = 8


def control_mesh(settings: SourceSettings) -> tuple[Mesh, Indices | None]:
    """The control mesh as triangles, decimated and placed, and which vertex each of its file's is; None if decimated.

    Raises:
        ConfigError: it is neither a base, nor a target, nor a file.
        MeshError: it cannot be used.
    """
    mesh, numbering = _triangles(settings.mesh)
    if settings.decimate is not None and settings.decimate < mesh.num_faces:
        mesh = decimate(mesh, settings.decimate)
        return mesh.with_verts(_placed(mesh.verts, settings)), None
    return mesh.with_verts(_placed(mesh.verts, settings)), numbering


def control_polygons(settings: SourceSettings) -> tuple[PolygonMesh, Indices | None]:
    """The same with its polygons as they are; decimation leaves triangles.

    Raises:
        ConfigError, MeshError: as `control_mesh`.
    """
    mesh, numbering = _polygons(settings.mesh)
    if settings.decimate is not None and settings.decimate < mesh.triangulated().num_faces:
        mesh = PolygonMesh.of(decimate(mesh.triangulated(), settings.decimate))
        return mesh.with_verts(_placed(mesh.verts, settings)), None
    return mesh.with_verts(_placed(mesh.verts, settings)), numbering


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


def _triangles(name: str) -> tuple[Mesh, Indices]:
    if _is_base(name):
        mesh = SOLIDS[name]() if name in SOLIDS else _icosphere(name)
        return mesh, np.arange(mesh.num_verts)
    source_file(SourceSettings(mesh=name))
    return load_numbered_target(name)


def _polygons(name: str) -> tuple[PolygonMesh, Indices]:
    if _is_base(name):
        mesh = POLYGON_SOLIDS[name]() if name in POLYGON_SOLIDS else PolygonMesh.of(_triangles(name)[0])
        return mesh, np.arange(mesh.num_verts)
    source_file(SourceSettings(mesh=name))
    return load_numbered_polygon_target(name)


def _is_base(name: str) -> bool:
    return name in SOLIDS or name.partition(":")[0] == "icosphere"


def _icosphere(name: str) -> Mesh:
    parameters = dict(parse_spec(name).parameters)
    level = parameters.pop("level", _ICOSPHERE_LEVEL)
    if parameters or not isinstance(level, int) or not 0 <= level <= _MOST_LEVELS:
        raise ConfigError(f"source.mesh: '{name}': icosphere takes one parameter, level, from 0 to {_MOST_LEVELS}")
    solid, _ = control_mesh(SourceSettings(mesh="icosahedron"))
    refinement = refine(Topology.of(solid), MIDPOINT, level)
    return Mesh(refined_on_ball(solid.verts, refinement.operators), refinement.faces)


def _placed(verts: Verts, settings: SourceSettings) -> Verts:
    mean = verts.mean(axis=0)
    offset = verts - mean
    extent = float(np.linalg.norm(offset, axis=1).max())
    if not extent > 0:
        raise MeshError(f"source.mesh: {settings.mesh}: the mesh has no extent")
    scale = 1.0 if settings.radius is None else settings.radius / extent
    return np.asarray(offset * scale + (mean if settings.centre is None else settings.centre))
