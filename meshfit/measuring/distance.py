"""Distances between two surfaces in both directions: largest, mean, RMS and percentiles, and angles between normals.

Forward is from the result to the target, backward from the target to the result. Both are measured because a
result that never reached an ear of its target has a small forward and a large backward distance.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.measuring.surface import require_surface
from meshfit.mesh.geometry import bounding_box_diagonal, face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import nearest_on_surface
from meshfit.mesh.sampling import SurfacePoints, sample_surface
from meshfit.mesh.topology import Topology

PERCENTILES = (50, 90, 95, 99)
"""Percentiles of distances and angles; between two values, they are interpolated linearly."""

Position = tuple[float, float, float]


@dataclass(frozen=True)
class Hausdorff:
    """Largest distances between two surfaces, in the unit of the vertices; lower bounds of the true ones.

    Attributes:
        forward: from the result to the target.
        backward: from the target to the result.
        symmetric: the larger of the two.
        samples: number of area-uniform points in each direction, in addition to all vertices and edge midpoints.
        percent_of_diagonal: symmetric, in percent of the diagonal of the target's bounding box.
    """

    forward: float
    backward: float
    symmetric: float
    samples: int
    percent_of_diagonal: float


@dataclass(frozen=True)
class Distance:
    """Distances between two surfaces over their areas, in the unit of the vertices.

    Attributes:
        mean: (forward_mean + backward_mean) / 2.
        rms: sqrt((forward_rms² + backward_rms²) / 2).
        forward_mean: mean from the result to the target.
        backward_mean: mean from the target to the result.
        forward_rms: root mean square from the result to the target.
        backward_rms: root mean square from the target to the result.
        forward_p50: median from the result to the target.
        forward_p90: 90th percentile from the result to the target.
        forward_p95: 95th percentile from the result to the target.
        forward_p99: 99th percentile from the result to the target.
        backward_p50: median from the target to the result.
        backward_p90: 90th percentile from the target to the result.
        backward_p95: 95th percentile from the target to the result.
        backward_p99: 99th percentile from the target to the result.
    """

    mean: float
    rms: float
    forward_mean: float
    backward_mean: float
    forward_rms: float
    backward_rms: float
    forward_p50: float
    forward_p90: float
    forward_p95: float
    forward_p99: float
    backward_p50: float
    backward_p90: float
    backward_p95: float
    backward_p99: float


@dataclass(frozen=True)
class NormalAngle:
    """Angles between the normals of two surfaces at nearest points, over both areas, in degrees from 0 to 180.

    They are those of the faces: between a point on a face, and the face of the other surface that is nearest to it.
    Where the nearest point is on an edge, one of its faces counts.

    Attributes:
        mean: mean angle; None where no face has a normal.
        p50: median.
        p90: 90th percentile.
        p95: 95th percentile.
        p99: 99th percentile.
    """

    mean: float | None
    p50: float | None
    p90: float | None
    p95: float | None
    p99: float | None


@dataclass(frozen=True)
class FarthestPoint:
    """The point of one surface that is farthest from the other, among those that were measured.

    Attributes:
        distance: its distance.
        position: of the point.
        face: a face with the point, of the surface that it is on; None for a point of a cloud.
        nearest: position of the nearest point on the other surface.
        nearest_face: a face of the other surface with that point; None for a point of a cloud.
    """

    distance: float
    position: Position
    face: int | None
    nearest: Position
    nearest_face: int | None


@dataclass(frozen=True)
class Farthest:
    """Where the largest distances are.

    Attributes:
        forward: the point of the result that is farthest from the target.
        backward: the point of the target that is farthest from the result.
    """

    forward: FarthestPoint
    backward: FarthestPoint


@dataclass(frozen=True, eq=False)
class _Directed:
    """Distances and angles at area-uniform points of one surface, and its farthest point."""

    distances: Float64[np.ndarray, " N"]
    angles: Float64[np.ndarray, " M"]
    farthest: FarthestPoint

    @property
    def mean(self) -> float:
        return float(self.distances.mean())

    @property
    def rms(self) -> float:
        return math.sqrt(float((self.distances**2).mean()))


def surface_distances(
    result: Mesh, target: Mesh, samples: int, seed: int
) -> tuple[Hausdorff, Distance, NormalAngle, Farthest]:
    """Return the distances between two surfaces in both directions (Cignoni et al. 1998, Metro, sec. 2).

    The largest is over area-uniform points, all vertices and all edge midpoints, where sharp features have their
    extremes. Mean, RMS, percentiles and angles are over the area-uniform points alone, since vertices are dense where a
    mesh is fine. Each point's distance is exact to about 1e-15 diagonals.

    Args:
        result: the fitted mesh.
        target: the mesh that it was fitted to.
        samples: number of area-uniform points in each direction.
        seed: of the points; each direction has its own random stream.

    Raises:
        MeasureError: a mesh without a surface.
    """
    require_surface(result, "result")
    require_surface(target, "target")
    to_target, to_result = np.random.default_rng(seed).spawn(2)
    forward = _directed(result, target, samples, to_target)
    backward = _directed(target, result, samples, to_result)
    largest = (forward.farthest.distance, backward.farthest.distance)
    percent = 100.0 * max(largest) / bounding_box_diagonal(target.verts)
    means, roots = (forward.mean, backward.mean), (forward.rms, backward.rms)
    percentiles = [float(value) for part in (forward, backward) for value in np.percentile(part.distances, PERCENTILES)]
    return (
        Hausdorff(*largest, max(largest), samples, percent),
        Distance(sum(means) / 2, math.hypot(*roots) / math.sqrt(2), *means, *roots, *percentiles),
        normal_angle(np.concatenate([forward.angles, backward.angles])),
        Farthest(forward.farthest, backward.farthest),
    )


def _directed(origin: Mesh, destination: Mesh, samples: int, generator: np.random.Generator) -> _Directed:
    uniform, features = sample_surface(origin, samples, generator), feature_points(origin)
    points, faces = np.concatenate([uniform.points, features.points]), np.concatenate([uniform.faces, features.faces])
    nearest = nearest_on_surface(destination, points)
    worst = int(nearest.distances.argmax())
    farthest = FarthestPoint(
        distance=float(nearest.distances[worst]),
        position=position(points[worst]),
        face=int(faces[worst]),
        nearest=position(nearest.points[worst]),
        nearest_face=int(nearest.faces[worst]),
    )
    own, other = face_normals(origin)[uniform.faces], face_normals(destination)[nearest.faces[:samples]]
    have_normals = own.any(axis=1) & other.any(axis=1)
    return _Directed(nearest.distances[:samples], angles_between(own[have_normals], other[have_normals]), farthest)


def angles_between(first: Float64[np.ndarray, "N 3"], second: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, " N"]:
    """Return (N,) the angles between unit vectors, in degrees; small ones are as exact as large ones."""
    difference, total = np.linalg.norm(first - second, axis=1), np.linalg.norm(first + second, axis=1)
    return np.asarray(np.degrees(2 * np.arctan2(difference, total)))


def normal_angle(angles: Float64[np.ndarray, " N"]) -> NormalAngle:
    """Return the mean and the percentiles of angles; None where there are none."""
    if not len(angles):
        return NormalAngle(None, None, None, None, None)
    return NormalAngle(float(angles.mean()), *map(float, np.percentile(angles, PERCENTILES)))


def feature_points(mesh: Mesh) -> SurfacePoints:
    """Return the vertices that faces use, and the midpoint of every edge, each with a face."""
    topology = Topology.of(mesh)
    used, first_corner = np.unique(mesh.faces, return_index=True)
    first_halfedge = np.unique(topology.edge_of, return_index=True)[1]
    faces: Int64[np.ndarray, " N"] = np.concatenate([first_corner, first_halfedge]) // 3
    return SurfacePoints(np.concatenate([mesh.verts[used], mesh.verts[topology.edges].mean(axis=1)]), faces)


def position(point: Float64[np.ndarray, "3"]) -> Position:
    """Return a point as plain numbers."""
    x, y, z = point.tolist()
    return x, y, z
