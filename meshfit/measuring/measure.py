"""Measure a result against its target."""

from dataclasses import asdict, dataclass
from typing import Any

from meshfit.measuring.distance import Distance, Hausdorff, surface_distances
from meshfit.measuring.points import Chamfer, FScore, NormalConsistency, point_scores
from meshfit.measuring.quality import Quality, mesh_quality
from meshfit.measuring.settings import MeasureSettings
from meshfit.mesh.mesh import Mesh
from meshfit.settings import override


@dataclass(frozen=True)
class Measurement:
    """Distances of a result from its target, and its mesh quality; lengths are in the frame of both meshes.

    Attributes:
        hausdorff: largest distances.
        distance: mean and RMS distances.
        chamfer: chamfer distances between point clouds.
        f_score: share of points matched within a distance.
        normal_consistency: agreement of normals.
        quality: mesh quality of the result; independent of the target.
    """

    hausdorff: Hausdorff
    distance: Distance
    chamfer: Chamfer
    f_score: FScore
    normal_consistency: NormalConsistency
    quality: Quality

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return nested dicts of plain numbers and booleans for JSON; `MEASURED` names each value as `group.name`."""
        return asdict(self)


def measure(
    result: Mesh, target: Mesh, settings: MeasureSettings | None = None, **overrides: int | float
) -> Measurement:
    """Measure a result against its target, both in the same frame.

    The same meshes and settings give bit-identical results.

    Example:
        >>> from meshfit.mesh.solids import cube, octahedron
        >>> measure(octahedron(), cube(), samples=1000).quality.watertight
        True

    Args:
        result: the fitted mesh.
        target: the mesh that it was fitted to.
        settings: numbers of samples and points, tau and seed; defaults if not given.
        **overrides: single settings by name, such as `samples=10_000`.

    Raises:
        MeasureError: a mesh without faces or area, or a vertex that is not finite.
        ConfigError: an unknown setting, or a value that is not allowed.
    """
    settings = override(settings or MeasureSettings(), overrides)
    hausdorff, distance = surface_distances(result, target, settings.samples, settings.seed)
    points, tau = settings.points, settings.f_score_tau
    chamfer, f_score, normal_consistency = point_scores(result, target, points, tau, settings.seed)
    quality = mesh_quality(result, "result")
    return Measurement(hausdorff, distance, chamfer, f_score, normal_consistency, quality)
