"""The source of a trial: built, aligned with the target, and compared with it before the fit."""

import warnings
from dataclasses import dataclass
from typing import Any

from meshfit.config.experiment import SourceSettings
from meshfit.errors import MeshfitWarning
from meshfit.experiment.running.trial_target import TrialTarget
from meshfit.experiment.source import build_source, describe_source, made_from_target
from meshfit.fitting.external.tools import works_from_target
from meshfit.fitting.registration.alignment import Aligned, align
from meshfit.fitting.settings import ExternalSettings, FitSettings, GaussNewtonSettings
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.manifold import TopologyCounts, describe_topology
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.mismatch import boxes_are_disjoint
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import Topology
from meshfit.subdivision.registry import Scheme
from meshfit.units import count_text

# A source whose box has this many times the diagonal of the target's is reported.
_MUCH_LARGER = 2.5
# A target that is so many times as large as the source is reported.
_MUCH_SMALLER = 10.0


@dataclass(frozen=True, eq=False)
class TrialSource:
    """The source of a trial in its place.

    Attributes:
        mesh: its triangles.
        polygons: the same with its polygons; None if it was built of triangles.
        record: of what it was made, why, and how it was aligned.
        notes: the same for the log.
    """

    mesh: Mesh
    polygons: PolygonMesh | None
    record: dict[str, Any]
    notes: tuple[str, ...]

    @property
    def built(self) -> Mesh | PolygonMesh:
        """The source with the faces that it was built with."""
        return self.polygons or self.mesh


def prepare_source(
    settings: SourceSettings,
    scheme: Scheme,
    target: TrialTarget,
    surface: Surface,
) -> TrialSource:
    """Build a source and align it with the target.

    Args:
        settings: of the source, with the present paths of files.
        scheme: that refines it.
        target: the target.
        surface: the part of its surface that counts.

    Raises:
        MeshfitError: the source cannot be made.

    Warns:
        MeshfitWarning: another alignment serves about as well.
    """
    images = None if target.images is None else target.images.views
    built = build_source(settings, scheme, target=target.mesh, surface=surface, images=images, frame=target.frame)
    made = made_from_target(settings, target.mesh, surface, images)
    record = describe_source(settings, target.mesh, surface, images)
    triangles = built.triangulated() if isinstance(built, PolygonMesh) else built
    notes = () if made is None or not made.line else (made.line,)
    if made is not None or settings.align == "none":
        return _source(built, Aligned(triangles), record, notes)
    aligned, setting = align(triangles, target.mesh, settings.align), f"source.align: {settings.align}"
    if aligned.doubt:
        text = f"{setting}: {aligned.doubt}; look at source.ply, or set another source.align"
        warnings.warn(text, MeshfitWarning, stacklevel=2)
    record |= {"align": {"method": settings.align} | aligned.record}
    return _source(built, aligned, record, (f"{setting}: the source is {aligned.line}",))


def _source(built: Mesh | PolygonMesh, aligned: Aligned, record: dict[str, Any], notes: tuple[str, ...]) -> TrialSource:
    polygons = built.with_verts(aligned.mesh.verts) if isinstance(built, PolygonMesh) else None
    return TrialSource(aligned.mesh, polygons, record, notes)


def warn_of_differences(
    source: Mesh, target: Mesh | PointCloud, fit: FitSettings, surface: Surface, *, fills: bool
) -> None:
    """Warn of a source that the fit cannot bring onto the target; a tool may start from the target, or cut and glue.

    One that fills the holes of the target, as set, differs from it on purpose.
    """
    tool = fit.tool if isinstance(fit, ExternalSettings) else None
    if works_from_target(tool):
        return
    if not fills and surface == "all":
        _warn_of_openings(source, target)
    of_source = describe_topology(Topology.of(source))
    of_target = of_source
    if isinstance(target, Mesh) and (surface == "all" or Topology.of(target).is_watertight):  # skins close others
        of_target = describe_topology(Topology.of(target))
    if not fills and of_source != of_target and (tool is not None or not isinstance(fit, ExternalSettings)):
        text = f"source and target differ in topology ({of_source}; {of_target}); the fit keeps that of the source"
        warnings.warn(text, MeshfitWarning, stacklevel=2)
    if isinstance(fit, GaussNewtonSettings) and fit.prior is not None:
        return  # its place and its size are found
    if boxes_are_disjoint(source, target):
        text = "the bounding boxes of source and target do not overlap; set source.align, source.centre or source.frame"
        warnings.warn(text, MeshfitWarning, stacklevel=2)
    sizes = [bounding_box_diagonal(mesh.verts) for mesh in (source, target)]
    if sizes[0] > _MUCH_LARGER * sizes[1]:
        text = (
            f"the source is {sizes[0] / sizes[1]:.2g} times as large as the target (diagonals {sizes[0]:.3g} and "
            f"{sizes[1]:.3g} in the normalised frame); set a smaller source.radius, or source.align: pca"
        )
        warnings.warn(text, MeshfitWarning, stacklevel=2)
    elif sizes[1] > _MUCH_SMALLER * sizes[0] > 0:
        text = (
            f"the target is {sizes[1] / sizes[0]:.2g} times as large as the source (diagonals {sizes[1]:.3g} and "
            f"{sizes[0]:.3g} in the normalised frame); set a larger source.radius, or source.align: pca"
        )
        warnings.warn(text, MeshfitWarning, stacklevel=2)


def _warn_of_openings(source: Mesh, target: Mesh | PointCloud) -> None:
    """Warn of a closed source for an open target, and name the source that keeps its openings."""
    if not isinstance(target, Mesh) or not Topology.of(source).is_watertight:
        return
    openings = int(Topology.of(target).boundary_edges.sum()) and TopologyCounts.of(Topology.of(target)).openings
    if openings:
        text = (
            f"the target is open ({count_text(openings, 'opening')}), and the source is closed, so it will cover what "
            "is open; source.mesh: target (or auto) starts from an open surface"
        )
        warnings.warn(text, MeshfitWarning, stacklevel=3)
