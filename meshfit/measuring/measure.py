"""The one call that measures a result against its target."""

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
    """How far a result is from its target, and how sound it is; lengths are in the frame that both meshes came in.

    Attributes:
        hausdorff: largest distances.
        distance: mean and RMS distances.
        chamfer: chamfer distances between point clouds.
        f_score: share of points that are matched within a distance.
        normal_consistency: how well normals agree.
        quality: soundness of the result; the target is not looked at.
    """

    hausdorff: Hausdorff
    distance: Distance
    chamfer: Chamfer
    f_score: FScore
    normal_consistency: NormalConsistency
    quality: Quality

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Nested dicts of plain numbers and booleans, fit for JSON; `MEASURED` names each as `group.figure`."""
        return asdict(self)


def measure(
    result: Mesh, target: Mesh, settings: MeasureSettings | None = None, **overrides: int | float
) -> Measurement:
    """Measure a result against its target, both in the same frame.

    The same meshes and settings give the same figures, to the bit.

    Example:
        >>> from meshfit.mesh.solids import cube, octahedron
        >>> measure(octahedron(), cube(), samples=1000).quality.watertight
        True

    Args:
        result: the fitted mesh.
        target: the mesh that it was fitted to.
        settings: numbers of samples and points, tau and seed; the defaults where it is not given.
        **overrides: single settings by name, such as `samples=10_000`.

    Raises:
        MeasureError: a mesh that has no faces or no area, or a vertex that is not finite.
        ConfigError: a setting that does not exist, or a value that is not allowed.
    """
    settings = override(settings or MeasureSettings(), overrides)
    hausdorff, distance = surface_distances(result, target, settings.samples, settings.seed)
    scores = point_scores(result, target, settings.points, settings.f_score_tau, settings.seed)
    return Measurement(
        hausdorff,
        distance,
        scores.chamfer,
        scores.f_score,
        scores.normal_consistency,
        mesh_quality(result, "result"),
    )
