"""The source of a trial: built, and aligned with the target."""

import warnings
from dataclasses import dataclass
from typing import Any

from meshfit.config.source_settings import SourceSettings
from meshfit.errors import MeshfitWarning
from meshfit.experiment.running.trial_target import TrialTarget
from meshfit.experiment.source import build_source, describe_source, made_from_target
from meshfit.fitting.registration.alignment import Aligned, align
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.subdivision.registry import Scheme


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
