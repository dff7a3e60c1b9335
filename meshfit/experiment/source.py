"""Spheres that verts are put on."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf, log
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from meshfit.config.experiment import MAX_LEVELS, SourceSettings
from meshfit.errors import ConfigError, MeshError, MeshfitError
from meshfit.mesh.io.vertex_values import read_vertex_property, read_vertex_values
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import POLYGON_SOLIDS, SOLIDS
from meshfit.mesh.targets import (
    NAMED_TARGETS,
    load_polygon_target_with_vertex_map,
    load_target_with_vertex_map,
    target_path,
)
from meshfit.mesh.topology import Indices, PolygonTopology, Topology
from meshfit.specs import parse_spec, suggest
from meshfit.subdivision.crease_files import read_creases
from meshfit.subdivision.creases import Creases, creases_by_angle
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import refine, require_takes_creases
from meshfit.subdivision.refinement import PolygonRefinement, Refinement
from meshfit.subdivision.registry import resolve
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.triangles.table import MIDPOINT


@dataclass(frozen=True)
class Sphere:
    """A sphere by its centre and its radius."""

    centre: tuple[float, float, float]
    radius: float

    @classmethod
    def about(cls, verts: Verts) -> "Sphere":
        """The one about the mean of some verts that goes through the farthest of them."""
        centre = verts.mean(axis=0)
        radius = float(np.linalg.norm(verts - centre, axis=1).max())
        return cls((float(centre[0]), float(centre[1]), float(centre[2])), radius)

    def put(self, verts: Verts) -> Verts:
        """The verts, each moved along its ray from the centre."""
        offset = verts - np.asarray(self.centre)
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        return np.asarray(self.centre + offset * (self.radius / length))


def refine_on_sphere(verts: Verts, operators: Iterable[csr_array]) -> Verts:
    """Verts refined level by level, put on their ball before the first and after each."""
    ball = Sphere.about(verts)
    verts = ball.put(verts)
    for operator in operators:
        verts = ball.put(operator @ verts)
    return verts


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


def control_polygon_mesh(settings: SourceSettings) -> tuple[PolygonMesh, Indices | None]:
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
    return load_target_with_vertex_map(name)


def _polygons(name: str) -> tuple[PolygonMesh, Indices]:
    if _is_base(name):
        mesh = POLYGON_SOLIDS[name]() if name in POLYGON_SOLIDS else PolygonMesh.of(_triangles(name)[0])
        return mesh, np.arange(mesh.num_verts)
    source_file(SourceSettings(mesh=name))
    return load_polygon_target_with_vertex_map(name)


def _is_base(name: str) -> bool:
    return name in SOLIDS or name.partition(":")[0] == "icosphere"


def _icosphere(name: str) -> Mesh:
    parameters = dict(parse_spec(name).parameters)
    level = parameters.pop("level", _ICOSPHERE_LEVEL)
    if parameters or not isinstance(level, int) or not 0 <= level <= _MOST_LEVELS:
        raise ConfigError(f"source.mesh: '{name}': icosphere takes one parameter, level, from 0 to {_MOST_LEVELS}")
    solid, _ = control_mesh(SourceSettings(mesh="icosahedron"))
    refinement = refine(Topology.of(solid), MIDPOINT, level)
    return Mesh(refine_on_sphere(solid.verts, refinement.operators), refinement.faces)


def _placed(verts: Verts, settings: SourceSettings) -> Verts:
    mean = verts.mean(axis=0)
    offset = verts - mean
    extent = float(np.linalg.norm(offset, axis=1).max())
    if not extent > 0:
        raise MeshError(f"source.mesh: {settings.mesh}: the mesh has no extent")
    scale = 1.0 if settings.radius is None else settings.radius / extent
    return np.asarray(offset * scale + (mean if settings.centre is None else settings.centre))


def build_source(settings: SourceSettings, scheme: str | Scheme, name: str = "this scheme") -> Mesh | PolygonMesh:
    """The mesh that a fit starts from: of triangles or, from a scheme on polygons, of polygons.

    Polygons begin at the corner from which their fan has the shortest diagonals, so that every reader of the mesh cuts
    them into the same triangles.

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
    masks, name = resolve(scheme), scheme if isinstance(scheme, str) else name
    on_polygons = isinstance(masks, PolygonScheme)
    mesh, numbering = control_polygon_mesh(settings) if on_polygons else control_mesh(settings)
    creases = _creases(settings, masks, name, mesh, numbering)
    masks = _with_alphas(settings, masks, name, numbering)
    try:
        return _refined(mesh, settings, masks, creases)
    except MeshError as error:
        raise MeshError(f"{settings.mesh}: {error}") from None


def _refined(
    mesh: Mesh | PolygonMesh, settings: SourceSettings, scheme: Scheme, creases: Creases | None
) -> Mesh | PolygonMesh:
    topology = Topology.of(mesh) if isinstance(mesh, Mesh) else PolygonTopology.of(mesh)
    if settings.wanted_verts is None:
        refinement = refine(topology, scheme, settings.levels, creases)
    else:
        refinement = _nearest_in_size(topology, scheme, settings.wanted_verts, creases)
    operators = refinement.operators
    verts = refinement(mesh.verts) if settings.project == "none" else refine_on_sphere(mesh.verts, operators)
    if isinstance(refinement, Refinement):
        return Mesh(verts, refinement.faces)
    return refinement.mesh(verts).with_short_diagonals()


def _nearest_in_size(
    topology: Topology | PolygonTopology, scheme: Scheme, wanted: int, creases: Creases | None
) -> Refinement | PolygonRefinement:
    """As many levels as bring the number of verts nearest to that, by its ratio."""
    last = refine(topology, scheme, 0, creases)
    for levels in range(1, MAX_LEVELS + 1):
        if last.num_fine >= wanted:
            break
        finer = refine(topology, scheme, levels, creases)
        if abs(log(finer.num_fine / wanted)) >= abs(log(last.num_fine / wanted)):
            break
        last = finer
    return last


def _creases(
    settings: SourceSettings, masks: Scheme, name: str, mesh: Mesh | PolygonMesh, numbering: Indices | None
) -> Creases | None:
    wanted = settings.creases
    if wanted is None:
        return None
    sharpness = inf if wanted.sharpness is None else wanted.sharpness
    with _naming("source.creases"):
        require_takes_creases(masks, name)
        assert isinstance(mesh, Mesh)  # noqa: S101  schemes that take creases are on triangles
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
            return masks.with_alpha(read_vertex_values(wanted.file, verts, (0.0, 1.0)))
        assert wanted.attribute is not None  # noqa: S101  one of both is there
        path = source_file(settings)
        if path is None:
            raise MeshError(f"attribute: {settings.mesh} is no file that could have one")
        return masks.with_alpha(read_vertex_property(path, wanted.attribute, verts, (0.0, 1.0)))


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
