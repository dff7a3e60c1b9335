"""Distances between a surface and a cloud of points, such as a scan.

From the target to the result, each point's distance is to the surface itself, exact to about 1e-15 diagonals, and
weighted by the area that the point stands for, so that a side that was scanned twice counts once. From the result to
the target, distances are to the nearest points, so that they are too large by a share of the points' spacing, which
they do not fall below however good the result; nothing is subtracted. Where a scan shows only a part, they grow with
what the result adds to it. The first direction is the one to compare results by.

Of more than 400,000 points, as many are drawn at random, always the same, for all but the largest distance from the
target, which is that of all points.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from meshfit.measuring.distance import (
    PERCENTILES,
    Distance,
    Farthest,
    FarthestPoint,
    Hausdorff,
    NormalAngle,
    angles_between,
    feature_points,
    position,
)
from meshfit.measuring.edges import Edges
from meshfit.measuring.points import Chamfer, FScore, NormalConsistency, Samples, scores_of, surface_samples
from meshfit.measuring.settings import MeasureSettings
from meshfit.measuring.surface import require_surface, require_target
from meshfit.mesh.geometry import bounding_box_diagonal, face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.point_cloud import MOST_POINTS, PointCloud, local_areas, oriented_cloud, plane_normals
from meshfit.mesh.proximity import NearestPoints, nearest_on_surface
from meshfit.mesh.sampling import SurfacePoints, sample_surface

_MOST_POINTS = MOST_POINTS
_NO_CREASES = "the target is a cloud of points, which has no creases"

Values = Float64[np.ndarray, " N"]


@dataclass(frozen=True)
class CloudFacts:
    """The cloud of points that a result was measured to.

    Attributes:
        points: number of its points.
        normals: `own`, or `estimated` from nearest neighbours, without a side.
        spacing: median distance of neighbouring points, in the unit of the points; distances from the result to the
            target do not fall below about half of it.
    """

    points: int
    normals: str
    spacing: float


class CloudMeasurement(NamedTuple):
    """Everything about a result and a cloud but the quality of the result."""

    hausdorff: Hausdorff
    distance: Distance
    chamfer: Chamfer
    f_score: FScore
    normal_consistency: NormalConsistency
    normal_angle: NormalAngle
    edges: Edges
    farthest: Farthest
    cloud: CloudFacts


def measure_to_cloud(result: Mesh, cloud: PointCloud, settings: MeasureSettings) -> CloudMeasurement:
    """Measure a surface against a cloud of points.

    Args:
        result: the fitted mesh.
        cloud: the points that it was fitted to; without normals, those of neighbouring points are taken.
        settings: numbers of samples and points, tau and seed.

    Raises:
        MeasureError: a mesh without a surface, or a point that is not finite.
    """
    require_surface(result, "result")
    require_target(cloud)
    whole, cloud = cloud, cloud.thinned(_MOST_POINTS)
    signed = cloud.normals is not None
    normals = oriented_cloud(cloud).normals if signed else plane_normals(cloud.verts)
    assert normals is not None  # noqa: S101  its own or estimated
    areas = _usable(local_areas(cloud.verts))
    # The streams of measurements against a mesh.
    generator, _ = np.random.default_rng(settings.seed).spawn(2)
    forward = _to_cloud(result, cloud, normals, sample_surface(result, settings.samples, generator))
    backward = _to_surface(cloud, normals, areas, result)
    if whole is not cloud:
        backward = replace(backward, farthest=_farthest_point(whole, nearest_on_surface(result, whole.verts)))
    chamfer, f_score, consistency = _scores(result, cloud, normals, areas, settings)
    largest = forward.farthest.distance, backward.farthest.distance
    percent = 100.0 * max(largest) / bounding_box_diagonal(cloud.verts)
    means, roots = (forward.mean, backward.mean), (forward.rms, backward.rms)
    percentiles = [value for part in (forward, backward) for value in percentiles_of(part.distances, part.weights)]
    return CloudMeasurement(
        Hausdorff(*largest, max(largest), settings.samples, percent),
        Distance(sum(means) / 2, math.hypot(*roots) / math.sqrt(2), *means, *roots, *percentiles),
        chamfer,
        f_score,
        consistency if signed else NormalConsistency(None, consistency.absolute),
        _normal_angle((forward, backward), signed=signed),
        Edges(None, None, None, None, _NO_CREASES),
        Farthest(forward.farthest, backward.farthest),
        CloudFacts(whole.num_verts, "own" if signed else "estimated", float(np.sqrt(np.median(areas)))),
    )


@dataclass(frozen=True, eq=False)
class _Directed:
    """Distances and cosines of angles between normals at points of one side, with the area of each, and the farthest.

    Attributes:
        distances: (N,) to the other side.
        weights: (N,) areas.
        normals: (N, 3) at the points.
        others: (N, 3) at the nearest points.
        farthest: the farthest point.
    """

    distances: Values
    weights: Values
    normals: Float64[np.ndarray, "N 3"]
    others: Float64[np.ndarray, "N 3"]
    farthest: FarthestPoint

    @property
    def mean(self) -> float:
        return float(np.average(self.distances, weights=self.weights))

    @property
    def rms(self) -> float:
        return math.sqrt(float(np.average(self.distances**2, weights=self.weights)))


def _to_cloud(
    result: Mesh, cloud: PointCloud, normals: Float64[np.ndarray, "N 3"], uniform: SurfacePoints
) -> _Directed:
    """Measure from points on the result, which are uniform by area, to the nearest points of the cloud."""
    features = feature_points(result)
    points, faces = np.concatenate([uniform.points, features.points]), np.concatenate([uniform.faces, features.faces])
    nearest = nearest_point_query(cloud.verts)(points)
    distances = np.linalg.norm(points - cloud.verts[nearest], axis=1)
    worst, count = int(distances.argmax()), len(uniform.points)
    farthest = FarthestPoint(
        distance=float(distances[worst]),
        position=position(points[worst]),
        face=int(faces[worst]),
        nearest=position(cloud.verts[nearest[worst]]),
        nearest_face=None,
    )
    own = face_normals(result)[uniform.faces]
    return _Directed(distances[:count], np.ones(count), own, normals[nearest[:count]], farthest)


def _to_surface(cloud: PointCloud, normals: Float64[np.ndarray, "N 3"], areas: Values, result: Mesh) -> _Directed:
    """Measure from all points of the cloud to the result."""
    nearest = nearest_on_surface(result, cloud.verts)
    others = face_normals(result)[nearest.faces]
    return _Directed(nearest.distances, areas, normals, others, _farthest_point(cloud, nearest))


def _farthest_point(cloud: PointCloud, nearest: NearestPoints) -> FarthestPoint:
    worst = int(nearest.distances.argmax())
    return FarthestPoint(
        distance=float(nearest.distances[worst]),
        position=position(cloud.verts[worst]),
        face=None,
        nearest=position(nearest.points[worst]),
        nearest_face=int(nearest.faces[worst]),
    )


def _scores(
    result: Mesh, cloud: PointCloud, normals: Float64[np.ndarray, "N 3"], areas: Values, settings: MeasureSettings
) -> tuple[Chamfer, FScore, NormalConsistency]:
    """Return the scores of as many points of the cloud, drawn by area, as on the result."""
    for_result, for_target = np.random.default_rng(settings.seed).spawn(2)
    total = areas.cumsum()
    at = (np.arange(settings.points) + for_target.random(settings.points)) * (total[-1] / settings.points)
    drawn = np.searchsorted(total, at, side="right").clip(max=cloud.num_verts - 1)
    on_target = Samples(cloud.verts[drawn], normals[drawn])
    return scores_of(
        surface_samples(result, settings.points, for_result),
        on_target,
        settings.tau(bounding_box_diagonal(cloud.verts)),
    )


def _normal_angle(ways: tuple[_Directed, _Directed], *, signed: bool) -> NormalAngle:
    """Return angles over both sides, which count the same; of normals without a side, the smaller ones."""
    angles, weights = [], []
    for way in ways:
        have_normals = way.normals.any(axis=1) & way.others.any(axis=1)
        between = angles_between(way.normals[have_normals], way.others[have_normals])
        angles.append(between if signed else np.minimum(between, 180.0 - between))
        weights.append(way.weights[have_normals] / way.weights.sum())
    values, shares = np.concatenate(angles), np.concatenate(weights)
    if not len(values) or not shares.sum() > 0:
        return NormalAngle(None, None, None, None, None)
    return NormalAngle(float(np.average(values, weights=shares)), *percentiles_of(values, shares))


def _usable(areas: Values) -> Values:
    """Return the areas of points, or equal ones where all points have several duplicates."""
    return areas if areas.sum() > 0 else np.ones_like(areas)


def percentiles_of(values: Values, weights: Values) -> list[float]:
    """Return the percentiles of weighted values, interpolated linearly; with equal weights, those of numpy."""
    order = np.argsort(values, kind="stable")
    ends = weights[order].cumsum()
    middles = ends - weights[order] / 2
    span = middles[-1] - middles[0]
    places = (middles - middles[0]) / span if span > 0 else np.zeros(len(values))
    return [float(value) for value in np.interp(np.array(PERCENTILES) / 100, places, values[order])]
