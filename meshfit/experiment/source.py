"""The source of a trial: a control mesh, placed, and refined by the trial's scheme."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshfit.config.experiment import SourceSettings
from meshfit.errors import ConfigError, MeshError
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.polygon_topology import PolygonTopology
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import POLYGON_SOLIDS, SOLIDS
from meshfit.mesh.targets import NAMED_TARGETS, load_polygon_target, load_target, target_path
from meshfit.mesh.topology import Topology
from meshfit.specs import parse_spec, suggest
from meshfit.subdivision.choose import declared
from meshfit.subdivision.polygon_scheme import PolygonScheme
from meshfit.subdivision.refine import refine
from meshfit.subdivision.refinement import Refinement
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


def build_source(settings: SourceSettings, scheme: str | Scheme) -> Mesh | PolygonMesh:
    """The mesh that a fit starts from: of triangles or, from a scheme on polygons, of polygons.

    Polygons begin at the corner from which their fan has the shortest diagonals, so that every reader of the mesh cuts
    them into the same triangles.

    Args:
        settings: which control mesh, how it is placed, and how many levels.
        scheme: the scheme that refines it, or its spec.

    Raises:
        ConfigError: the control mesh is neither a base, nor a target, nor a file.
        MeshError: it cannot be used or refined.
        SchemeError: no such scheme.
    """
    masks = declared(scheme)
    mesh = control_polygons(settings) if isinstance(masks, PolygonScheme) else control_mesh(settings)
    try:
        return _refined(mesh, settings, masks)
    except MeshError as error:
        raise MeshError(f"{settings.mesh}: {error}") from None


def _refined(mesh: Mesh | PolygonMesh, settings: SourceSettings, scheme: Scheme) -> Mesh | PolygonMesh:
    topology = Topology.of(mesh) if isinstance(mesh, Mesh) else PolygonTopology.of(mesh)
    refinement = refine(topology, scheme, settings.levels)
    if settings.project == "none":
        verts = refinement(mesh.verts)
    else:
        ball = _ball_about(mesh.verts)
        verts = ball.put(mesh.verts)
        for operator in refinement.operators:
            verts = ball.put(operator @ verts)
    if isinstance(refinement, Refinement):
        return Mesh(verts, refinement.faces)
    return refinement.mesh(verts).with_short_diagonals()


def control_mesh(settings: SourceSettings) -> Mesh:
    """The control mesh as triangles, decimated and placed, before any refinement.

    Raises:
        ConfigError, MeshError: as `build_source`.
    """
    mesh = _named_or_file(settings.mesh)
    if settings.decimate is not None and settings.decimate < mesh.num_faces:
        mesh = decimate(mesh, settings.decimate)
    return mesh.with_verts(_placed(mesh.verts, settings))


def control_polygons(settings: SourceSettings) -> PolygonMesh:
    """The control mesh with its polygons as they are, placed, before any refinement; decimation leaves triangles.

    Raises:
        ConfigError, MeshError: as `build_source`.
    """
    mesh = _polygons_named_or_of_file(settings.mesh)
    if settings.decimate is not None and settings.decimate < mesh.num_faces:
        mesh = PolygonMesh.of(decimate(mesh.triangulated(), settings.decimate))
    return mesh.with_verts(_placed(mesh.verts, settings))


def _placed(verts: Verts, settings: SourceSettings) -> Verts:
    mean = verts.mean(axis=0)
    offset = verts - mean
    extent = float(np.linalg.norm(offset, axis=1).max())
    if not extent > 0:
        raise MeshError(f"source.mesh: {settings.mesh}: the mesh has no extent")
    scale = 1.0 if settings.radius is None else settings.radius / extent
    return np.asarray(offset * scale + (mean if settings.centre is None else settings.centre))


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


def _named_or_file(name: str) -> Mesh:
    if _is_base(name):
        return SOLIDS[name]() if name in SOLIDS else _icosphere(name)
    source_file(SourceSettings(mesh=name))
    return load_target(name)


def _polygons_named_or_of_file(name: str) -> PolygonMesh:
    if name in POLYGON_SOLIDS:
        return POLYGON_SOLIDS[name]()
    if _is_base(name):
        return PolygonMesh.of(_named_or_file(name))
    source_file(SourceSettings(mesh=name))
    return load_polygon_target(name)


def _is_base(name: str) -> bool:
    return name in SOLIDS or name.partition(":")[0] == "icosphere"


def _icosphere(name: str) -> Mesh:
    parameters = dict(parse_spec(name).parameters)
    level = parameters.pop("level", _ICOSPHERE_LEVEL)
    if parameters or not isinstance(level, int) or not 0 <= level <= _MOST_LEVELS:
        raise ConfigError(f"source.mesh: '{name}': icosphere takes one parameter, level, from 0 to {_MOST_LEVELS}")
    sphere = build_source(SourceSettings(levels=level, project="sphere"), "midpoint")
    assert isinstance(sphere, Mesh)  # noqa: S101  midpoint is on triangles
    return sphere


def _ball_about(verts: Verts) -> _Ball:
    centre = verts.mean(axis=0)
    radius = float(np.linalg.norm(verts - centre, axis=1).max())
    return _Ball((float(centre[0]), float(centre[1]), float(centre[2])), radius)
