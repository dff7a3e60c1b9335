"""The source of a trial: a control mesh, refined by the trial's scheme."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import inf, log

from meshfit.config.experiment import MOST_LEVELS, SourceSettings
from meshfit.errors import ConfigError, MeshError, MeshfitError
from meshfit.experiment.ball import refined_on_ball
from meshfit.experiment.control import control_mesh, control_polygons, source_file
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygon_topology import PolygonTopology
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import Indices, Topology
from meshfit.mesh.vertex_values import read_attribute, read_values
from meshfit.subdivision.choose import declared
from meshfit.subdivision.crease_files import read_creases
from meshfit.subdivision.creases import Creases, creases_by_angle
from meshfit.subdivision.polygon_scheme import PolygonScheme
from meshfit.subdivision.refine import refine, require_takes_creases
from meshfit.subdivision.refinement import PolygonRefinement, Refinement
from meshfit.subdivision.scheme import Scheme


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
    masks, name = declared(scheme), scheme if isinstance(scheme, str) else name
    on_polygons = isinstance(masks, PolygonScheme)
    mesh, numbering = control_polygons(settings) if on_polygons else control_mesh(settings)
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
    verts = refinement(mesh.verts) if settings.project == "none" else refined_on_ball(mesh.verts, operators)
    if isinstance(refinement, Refinement):
        return Mesh(verts, refinement.faces)
    return refinement.mesh(verts).with_short_diagonals()


def _nearest_in_size(
    topology: Topology | PolygonTopology, scheme: Scheme, wanted: int, creases: Creases | None
) -> Refinement | PolygonRefinement:
    """As many levels as bring the number of verts nearest to that, by its ratio."""
    last = refine(topology, scheme, 0, creases)
    for levels in range(1, MOST_LEVELS + 1):
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
