"""Measure a result against its target."""

from dataclasses import asdict, dataclass
from typing import Any

from meshfit.measuring.distance import Distance, Farthest, Hausdorff, NormalAngle, surface_distances
from meshfit.measuring.edges import Edges, edge_scores
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
        distance: mean and RMS distances, and percentiles.
        chamfer: chamfer distances between point clouds.
        f_score: share of points matched within a distance.
        normal_consistency: agreement of normals.
        normal_angle: angles between normals at nearest points.
        edges: agreement of creases.
        quality: mesh quality of the result; independent of the target.
        farthest: where the largest distances are.
    """

    hausdorff: Hausdorff
    distance: Distance
    chamfer: Chamfer
    f_score: FScore
    normal_consistency: NormalConsistency
    normal_angle: NormalAngle
    edges: Edges
    quality: Quality
    farthest: Farthest

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return nested dicts of plain values for JSON; `MEASURED` names each metric as `group.name`.

        Besides metrics, there are the numbers of points, tau, the reason of a missing value, and the farthest points.
        """
        values = asdict(self)
        for point in values["farthest"].values():
            point |= {key: list(point[key]) for key in ("position", "nearest")}
        return values


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
    hausdorff, distance, normal_angle, farthest = surface_distances(result, target, settings.samples, settings.seed)
    points, tau = settings.points, settings.f_score_tau
    chamfer, f_score, normal_consistency = point_scores(result, target, points, tau, settings.seed)
    edges = edge_scores(result, target, points, settings.crease_angle, tau, settings.seed)
    quality = mesh_quality(result, "result")
    return Measurement(
        hausdorff, distance, chamfer, f_score, normal_consistency, normal_angle, edges, quality, farthest
    )
