"""Source meshes: a control mesh, read or built, placed, and refined by a scheme."""

import os
from collections.abc import Callable
from math import cbrt, inf, log, pi, sqrt
from pathlib import Path

import numpy as np

from meshfit.config.source_settings import KEYS_WITH_FILES, MADE_FROM_TARGET, MAX_LEVELS, SourceSettings
from meshfit.errors import ConfigError, MeshError, error_prefix
from meshfit.images.hull_source import ANY_ORIGIN, control_mesh_from
from meshfit.images.views import Views
from meshfit.mesh.cleaning import VertexMap
from meshfit.mesh.cleaning_options import CleaningOptions, Surface
from meshfit.mesh.control_mesh import ControlMesh, Wrap
from meshfit.mesh.geometry import face_areas, signed_volume
from meshfit.mesh.io.vertex_values import read_vertex_property, read_vertex_values
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.normalisation import IDENTITY, Frame, placed
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import POLYGON_SOLIDS, SOLIDS
from meshfit.mesh.targets import NAMED_TARGETS, load_target_with_vertex_map, target_path
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.paths import STREAM, is_regular_file, looks_like_path
from meshfit.specs import parse_spec, suggest
from meshfit.subdivision.creases import Creases, creases_by_angle, read_creases
from meshfit.subdivision.growth import growth
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import (
    PolygonRefinement,
    Refinement,
    refine,
    refined_mesh,
    require_takes_creases,
)
from meshfit.subdivision.registry import Scheme, resolve
from meshfit.subdivision.sphere import MAX_LEVEL, icosphere, refined_on_sphere

_ICOSPHERE_LEVEL = 2
_SPHERE = "sphere"
_USUAL_VERTS = 2562

AnyMesh = Mesh | PolygonMesh


def build_source(
    settings: SourceSettings,
    scheme: str | Scheme,
    name: str = "this scheme",
    target: Mesh | PointCloud | None = None,
    *,
    surface: Surface = "all",
    images: Views | None = None,
    frame: Frame = IDENTITY,
) -> AnyMesh:
    """Build the mesh that a fit starts from: polygons if the scheme refines polygons, else triangles.

    Each polygon begins at the corner from which its fan has the shortest diagonals, so that every reader of the mesh
    cuts it into the same triangles.

    Args:
        settings: the control mesh, its placement, creases and alphas, and the number of levels.
        scheme: the scheme that refines it, or its spec.
        name: the scheme's name in messages; its spec if that is given.
        target: the trial's target in its normalised frame, which some control meshes are made from.
        surface: the part of the target's surface that this is.
        images: views of the target, in the same frame, if it is given by images.
        frame: of the target, for a control mesh in the coordinates of the target's file.

    Raises:
        ConfigError: the control mesh is neither built in, nor a target, nor a file; or it is decimated or made from the
            trial's target, but a file of creases or alphas refers to its original vertices.
        MeshError: the control mesh, or a file of creases or alphas, cannot be used.
        SchemeError: the scheme does not exist, takes no creases or has no alpha.
    """
    if isinstance(scheme, str):
        name = scheme
    scheme = resolve(scheme)
    polygons = isinstance(scheme, PolygonScheme)
    mesh, vertex_map = _control_mesh(settings, target, surface, images, frame, polygons=polygons)
    creases = _creases(settings, scheme, name, mesh, vertex_map)
    scheme = _with_alphas(settings, scheme, name, vertex_map)
    try:
        return _sized(_refined(mesh, settings, scheme, creases), settings)
    except MeshError as error:
        raise MeshError(f"{settings.mesh}: {error}") from None


def source_files(settings: SourceSettings) -> dict[str, str]:
    """Return the files that a source is made from, by role, as the settings name them.

    Raises:
        ConfigError: the control mesh is neither built in, nor a target, nor a file.
    """
    names = {"source": settings.mesh if _control_mesh_path(settings.mesh) is not None else None}
    names |= {key: getattr(getattr(settings, key), "file", None) for key in KEYS_WITH_FILES}
    return {role: name for role, name in names.items() if name is not None}


def relocated(settings: SourceSettings, where: Callable[[str], str]) -> SourceSettings:
    """Return the settings with each file replaced by its current path."""
    changes: dict[str, object] = {"mesh": where(settings.mesh)}
    for key in KEYS_WITH_FILES:
        files = getattr(settings, key)
        if files is not None and files.file is not None:
            changes[key] = files.model_copy(update={"file": where(files.file)})
    return settings.model_copy(update=changes)


def made_from_target(
    settings: SourceSettings, target: Mesh | PointCloud, surface: Surface = "all", images: Views | None = None
) -> ControlMesh | None:
    """Return the control mesh that a source is made from with a trial's target; None if it is made without.

    Raises:
        MeshError: the target has nothing to make it from.
    """
    origin = next((origin for origin in ANY_ORIGIN if origin == settings.mesh), None)
    if origin is None:
        return None
    wanted = settings.wanted_verts or _USUAL_VERTS
    verts = max(4, round(wanted / 4**settings.levels)) if settings.decimate is None else None
    wrap = None if settings.wrap is None else Wrap(settings.wrap.alpha, settings.wrap.offset)
    with error_prefix("source.mesh"):
        return control_mesh_from(
            target, images, origin, verts=verts, faces=settings.decimate, wrap=wrap, surface=surface
        )


def stand_in(settings: SourceSettings) -> SourceSettings:
    """Return settings of a source without a trial's target, to be checked or counted before the target is loaded.

    Raises:
        ConfigError: a file refers to the vertices of a mesh that has yet to be made.
    """
    if not settings.is_made_from_target:
        return settings
    for key, options in (("creases", settings.creases), ("alpha", settings.alpha)):
        if options is not None and (key == "alpha" or options.file is not None):
            with error_prefix(f"source.{key}"):
                _undecimated(settings, None)
    return settings.model_copy(update={"mesh": "icosahedron", "wrap": None, "decimate": None})


def control_verts(settings: SourceSettings, scheme: Scheme) -> tuple[int, VertexMap | None]:
    """Return the number of vertices of a control mesh that is not made from a target, and those of its file.

    The second is the vertices that those of its file became; None if it was decimated.
    """
    mesh, vertex_map = _control_mesh(settings, None, "all", None, IDENTITY, polygons=isinstance(scheme, PolygonScheme))
    return mesh.num_verts, vertex_map


def expected_verts(settings: SourceSettings, scheme: Scheme) -> int:
    """Return the number of vertices of a source, or about that of one that has yet to be made from a target."""
    if settings.is_made_from_target and settings.wanted_verts is None and settings.decimate is not None:
        return round(settings.decimate / 2 * growth(scheme, settings.levels))
    return build_source(stand_in(settings), scheme).num_verts


def describe_source(
    settings: SourceSettings, target: Mesh | PointCloud, surface: Surface = "all", images: Views | None = None
) -> dict[str, object]:
    """Return what a source is made from, and why, for the records of a trial."""
    made = made_from_target(settings, target, surface, images)
    if made is not None:
        return made.record
    kind = "sphere" if settings.project == "sphere" else "solid"
    return {"made_from": "file" if _control_mesh_path(settings.mesh) is not None else kind, "reason": "as set"}


def _control_mesh(
    settings: SourceSettings,
    target: Mesh | PointCloud | None,
    surface: Surface,
    images: Views | None,
    frame: Frame,
    *,
    polygons: bool,
) -> tuple[AnyMesh, VertexMap | None]:
    """Load, decimate and place the control mesh.

    Returns:
        The mesh, and the vertices of it that those of its file became; None if it was decimated, or has no file.
    """
    mesh: AnyMesh
    vertex_map: VertexMap | None
    if settings.is_made_from_target:
        if target is None:
            raise MeshError(f"source.mesh: {settings.mesh}: made from the target of a trial, and there is none")
        made = made_from_target(settings, target, surface, images)
        assert made is not None  # noqa: S101  as it is made from the target
        return PolygonMesh.of(made.mesh) if polygons else made.mesh, None
    mesh, vertex_map = own_control_mesh(settings, polygons=polygons)
    if settings.frame == "target":
        mesh = frame.normalise(mesh)
    return mesh.with_verts(_placed(mesh.verts, settings)), vertex_map


def own_control_mesh(settings: SourceSettings, *, polygons: bool) -> tuple[AnyMesh, VertexMap | None]:
    """Load and decimate a control mesh that is not made from a target, in the coordinates of its file.

    Returns:
        The mesh, and the vertices of it that those of its file became; None if it was decimated.
    """
    mesh: AnyMesh
    vertex_map: VertexMap | None
    mesh, vertex_map = _load(settings.mesh, settings.cleaning, polygons=polygons)
    triangles = mesh.triangulated() if isinstance(mesh, PolygonMesh) else mesh
    if settings.decimate is not None and settings.decimate < triangles.num_faces:
        triangles = _decimated(triangles, settings.decimate)
        mesh, vertex_map = PolygonMesh.of(triangles) if polygons else triangles, None
    return mesh, vertex_map


def levels_of(settings: SourceSettings, mesh: AnyMesh, scheme: Scheme) -> int:
    """Return the number of levels by which a control mesh is refined."""
    if settings.wanted_verts is None:
        return settings.levels
    topology = Topology.of(mesh) if isinstance(mesh, Mesh) else PolygonTopology.of(mesh)
    return len(_nearest_in_size(topology, scheme, settings.wanted_verts, None).operators)


def _decimated(mesh: Mesh, num_faces: int) -> Mesh:
    """Decimate a mesh, and project its attributes."""
    fewer = decimate(mesh, num_faces)
    if not mesh.attributes:
        return fewer
    from meshfit.mesh.projection import projected_attributes  # brings libigl

    return fewer.with_attributes(projected_attributes(fewer, fewer.verts, mesh))


def _load(name: str, cleaning: CleaningOptions, *, polygons: bool) -> tuple[AnyMesh, VertexMap]:
    if _control_mesh_path(name) is not None:
        return load_target_with_vertex_map(name, cleaning, polygons=polygons)
    mesh: AnyMesh
    if name == _SPHERE:
        name = "icosahedron"
    if polygons and name in POLYGON_SOLIDS:
        mesh = POLYGON_SOLIDS[name]()
    else:
        triangles = SOLIDS[name]() if name in SOLIDS else _icosphere(name)
        mesh = PolygonMesh.of(triangles) if polygons else triangles
    return mesh, VertexMap(np.arange(mesh.num_verts))


def is_own_mesh(settings: SourceSettings) -> bool:
    """Return whether the control mesh is one of the user's own, from a file, rather than made to start from."""
    return settings.project == "none" and _control_mesh_path(settings.mesh) is not None


def _control_mesh_path(name: str) -> Path | None:
    """The file of a control mesh; None for a built-in one."""
    if name in SOLIDS or name in (_SPHERE, *MADE_FROM_TARGET) or name.partition(":")[0] == "icosphere":
        return None
    if name in NAMED_TARGETS or is_regular_file(name):
        return target_path(name)
    if name == STREAM or looks_like_path(name) or os.path.lexists(name):
        with error_prefix("source.mesh"):
            return target_path(name)
    allowed = [*MADE_FROM_TARGET, _SPHERE, *SOLIDS, "icosphere", *NAMED_TARGETS]
    raise ConfigError(f"source.mesh: '{name}': {suggest(name, allowed)}, or the path of a mesh file")


def _icosphere(name: str) -> Mesh:
    parameters = dict(parse_spec(name).parameters)
    level = parameters.pop("level", _ICOSPHERE_LEVEL)
    if parameters or not isinstance(level, int) or not 0 <= level <= MAX_LEVEL:
        allowed = f"icosphere takes one parameter, level, from 0 to {MAX_LEVEL}"
        raise ConfigError(f"source.mesh: '{name}': {allowed}")
    return icosphere(level)


def _placed(verts: Verts, settings: SourceSettings) -> Verts:
    """Scale and move the vertices of a control mesh to its radius and centre."""
    try:
        return placed(verts, settings.radius, settings.centre)
    except MeshError as error:
        raise MeshError(f"source.mesh: {settings.mesh}: {error}") from None


def _sized(mesh: AnyMesh, settings: SourceSettings) -> AnyMesh:
    """Scale a refined source about the mean of its vertices to the area or the volume that is asked for."""
    if settings.radius_of is None or settings.radius is None:
        return mesh
    triangles = mesh.triangulated() if isinstance(mesh, PolygonMesh) else mesh
    if settings.radius_of == "area":
        radius = sqrt(float(face_areas(triangles).sum()) / (4 * pi))
    elif Topology.of(triangles).is_watertight:
        radius = cbrt(abs(signed_volume(triangles)) / (4 / 3 * pi))
    else:
        raise MeshError("radius_of: an open surface has no volume; use radius_of: area")
    if not radius > 0:
        raise MeshError(f"radius_of: the surface has no {settings.radius_of}")
    mean = mesh.verts.mean(axis=0)
    return mesh.with_verts(mean + (mesh.verts - mean) * (settings.radius / radius))


def _refined(mesh: AnyMesh, settings: SourceSettings, scheme: Scheme, creases: Creases | None) -> AnyMesh:
    topology = Topology.of(mesh) if isinstance(mesh, Mesh) else PolygonTopology.of(mesh)
    if settings.wanted_verts is None:
        refinement = refine(topology, scheme, settings.levels, creases)
    else:
        refinement = _nearest_in_size(topology, scheme, settings.wanted_verts, creases)
    on_sphere = settings.project == "sphere" and not settings.is_made_from_target
    verts = refined_on_sphere(mesh.verts, refinement.operators) if on_sphere else None
    return refined_mesh(mesh, scheme, refinement, creases, verts)


def _nearest_in_size(
    topology: Topology | PolygonTopology, scheme: Scheme, wanted: int, creases: Creases | None
) -> Refinement | PolygonRefinement:
    """Refine to the level at which the number of vertices is nearest to the wanted one, by ratio."""
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
    settings: SourceSettings, scheme: Scheme, name: str, mesh: AnyMesh, vertex_map: VertexMap | None
) -> Creases | None:
    options = settings.creases
    if options is None:
        return None
    sharpness = inf if options.sharpness is None else options.sharpness
    with error_prefix("source.creases"):
        require_takes_creases(scheme, name)
        assert isinstance(mesh, Mesh)  # noqa: S101  schemes that take creases are on triangles
        if options.angle is not None:
            return creases_by_angle(mesh, options.angle, sharpness)
        assert options.file is not None  # noqa: S101  the settings hold one of the two
        return read_creases(options.file, Topology.of(mesh), _undecimated(settings, vertex_map), sharpness)


def _with_alphas(settings: SourceSettings, scheme: Scheme, name: str, vertex_map: VertexMap | None) -> Scheme:
    options = settings.alpha
    if options is None:
        return scheme
    with error_prefix(f"source.alpha: {name}"):
        scheme = scheme.with_alpha(0.0)  # refuses schemes without an alpha before any file is read
    with error_prefix("source.alpha"):
        verts = _undecimated(settings, vertex_map)
        if options.file is not None:
            return scheme.with_alpha(read_vertex_values(options.file, verts, (0.0, 1.0)))
        assert options.attribute is not None  # noqa: S101  the settings hold one of the two
        path = _control_mesh_path(settings.mesh)
        if path is None:
            raise MeshError(f"attribute: {settings.mesh} is built in and has no attributes")
        return scheme.with_alpha(read_vertex_property(path, options.attribute, verts, (0.0, 1.0)))


def _undecimated(settings: SourceSettings, vertex_map: VertexMap | None) -> VertexMap:
    if vertex_map is None:
        if settings.is_made_from_target:
            text = f"refers to the vertices of a file, and source.mesh: {settings.mesh} has none"
            raise ConfigError(f"{text}; use creases.angle, or another mesh")
        raise ConfigError(
            f"refers to the vertices of {settings.mesh}, which source.decimate replaces; set source.decimate to null"
        )
    return vertex_map
