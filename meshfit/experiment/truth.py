"""Truth of a trial: the places where the vertices of its source belong, read from a file."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.source_settings import SourceSettings
from meshfit.errors import ConfigError, MeshError
from meshfit.experiment.source import build_source, control_verts
from meshfit.fitting.settings import FitSettings, GaussNewtonSettings
from meshfit.measuring.vertex_error import Truth
from meshfit.mesh.cleaning import VertexMap
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.paths import path_text
from meshfit.specs import spec_folder
from meshfit.subdivision.polygons.scheme import PolygonScheme, PolygonSplit
from meshfit.subdivision.refine import refine, refined_mesh
from meshfit.subdivision.registry import NamedScheme, Scheme
from meshfit.units import count_text

_KEY = "target.truth"


def truth_path(settings: ExperimentSettings, target: str, scheme: str) -> str | None:
    """Return the file of the truth of a trial; None if it has none.

    Args:
        settings: of the experiment.
        target: short name of the target.
        scheme: spec of the scheme.
    """
    pattern = settings.target.truth
    return None if pattern is None else pattern.replace("{target}", target).replace("{scheme}", spec_folder(scheme))


@dataclass(frozen=True, eq=False)
class VertexCounts:
    """Numbers of vertices, from the file of a source to a result with its faces.

    Attributes:
        control: of the control mesh.
        source: of the refined source.
        result: of the result.
        vertex_map: vertices of the control mesh that those of its file became; None if it was decimated.
        is_dual: whether a level of the scheme has none of the vertices of the one before.
    """

    control: int
    source: int
    result: int
    vertex_map: VertexMap | None
    is_dual: bool

    def truth(self, path: str | Path, name: str) -> Truth:
        """Read where vertices of a result belong.

        Args:
            path: of a mesh or of points.
            name: of the file in messages.

        Raises:
            ConfigError: another number of vertices than any of these.
            MeshError: the file cannot be read.
        """
        from meshfit.mesh.io.point_clouds import load_points

        try:
            positions = load_points(path)
        except MeshError as error:
            raise MeshError(f"{_KEY}: {error}") from None
        kept = self.vertex_map if not self.is_dual or self.control == self.result else None
        if kept is not None and len(positions) == kept.num_file_verts:
            in_file, in_mesh = kept.pairs()
            return Truth(in_mesh, positions[in_file])
        allowed = (self.result,) if self.is_dual else (self.control, self.source, self.result)
        if len(positions) in allowed:
            return Truth.of_first(positions)
        file = () if kept is None else (kept.num_file_verts,)
        counts = " or ".join(f"{count:,}" for count in dict.fromkeys((*file, *allowed)))
        raise ConfigError(
            f"{_KEY}: {path_text(name)}: {count_text(len(positions), 'vertex')}; expected {counts}, as many as the "
            "source has, or has refined"
        )


@cache
def vertex_counts(settings: SourceSettings, scheme: NamedScheme, fit: FitSettings) -> VertexCounts:
    """Return the numbers of vertices of a source that is not made from a target."""
    resolved = scheme.resolve()
    source = build_source(settings, resolved, scheme.spec)
    control, vertex_map = control_verts(settings, resolved)
    topology = Topology.of(source) if isinstance(source, Mesh) else PolygonTopology.of(source)
    result = refine(topology, resolved, fitted_levels(fit)).num_fine
    is_dual = isinstance(resolved, PolygonScheme) and resolved.split is PolygonSplit.DUAL
    return VertexCounts(control, source.num_verts, result, vertex_map, is_dual and control != result)


def fitted_levels(fit: FitSettings) -> int:
    """Return the number of levels by which a fit refines its source."""
    return fit.levels if isinstance(fit, GaussNewtonSettings) else 0


def source_with_faces_of(
    result: Mesh, source: Mesh | PolygonMesh, scheme: Scheme, fit: FitSettings, triangles: Mesh
) -> Mesh | None:
    """Return the source with the faces of a result, refined if the fit has refined it; None if it has others.

    Args:
        result: the result, with its polygons triangulated.
        source: that the fit started from.
        scheme: by which the fit refines it.
        fit: settings of the fit.
        triangles: the source with its polygons triangulated.
    """
    if triangles.num_verts == result.num_verts and (triangles.faces == result.faces).all():
        return triangles
    if isinstance(fit, GaussNewtonSettings) and fit.connectivity == "fixed":
        topology = Topology.of(source) if isinstance(source, Mesh) else PolygonTopology.of(source)
        refined = refined_mesh(source, scheme, refine(topology, scheme, fit.levels))
        refined = refined.triangulated() if isinstance(refined, PolygonMesh) else refined
        # Polygons that have moved may be cut otherwise.
        if refined.num_verts == result.num_verts and refined.num_faces == result.num_faces:
            return Mesh(refined.verts, result.faces)
    return None
