"""Hausdorff, mean and RMS distance between two surfaces, in both directions.

Forward is from the result to the target, backward from the target to the result. Both are measured because a
result that never reached an ear of its target has a small forward and a large backward distance.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.measuring.proximity import distance_statistics
from meshfit.measuring.surface import require_surface
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import DistanceStatistics
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import Topology


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
    """Mean and root mean square distances between two surfaces, over their areas, in the unit of the vertices.

    Attributes:
        mean: (forward_mean + backward_mean) / 2.
        rms: sqrt((forward_rms² + backward_rms²) / 2).
        forward_mean: from the result to the target.
        backward_mean: from the target to the result.
        forward_rms: from the result to the target.
        backward_rms: from the target to the result.
    """

    mean: float
    rms: float
    forward_mean: float
    backward_mean: float
    forward_rms: float
    backward_rms: float


def surface_distances(result: Mesh, target: Mesh, samples: int, seed: int) -> tuple[Hausdorff, Distance]:
    """Return the distances between two surfaces in both directions (Cignoni et al. 1998, Metro, sec. 2).

    MeshLab's single precision limits each value to a relative accuracy of about 1e-7.

    Args:
        result: the fitted mesh.
        target: the mesh that it was fitted to.
        samples: number of area-uniform points in each direction.
        seed: of the points; each direction has its own random stream.

    Raises:
        MeasureError: a mesh without a surface, or MeshLab left out some of the points.
    """
    require_surface(result, "result")
    require_surface(target, "target")
    to_target, to_result = np.random.default_rng(seed).spawn(2)
    forward = directed_distances(result, target, samples, to_target)
    backward = directed_distances(target, result, samples, to_result)
    symmetric = max(forward.largest, backward.largest)
    percent = 100.0 * symmetric / bounding_box_diagonal(target.verts)
    mean = (forward.mean + backward.mean) / 2
    rms = math.hypot(forward.rms, backward.rms) / math.sqrt(2)
    return (
        Hausdorff(forward.largest, backward.largest, symmetric, samples, percent),
        Distance(mean, rms, forward.mean, backward.mean, forward.rms, backward.rms),
    )


def directed_distances(
    origin: Mesh, destination: Mesh, samples: int, generator: np.random.Generator
) -> DistanceStatistics:
    """Return statistics of the distances from one surface to another.

    The largest is over the area-uniform points, all vertices and all edge midpoints, where sharp features have their
    extremes. Mean and RMS are over the area-uniform points alone, since vertices are dense where a mesh is fine.

    Args:
        origin: the surface with the points.
        destination: the surface to measure to.
        samples: number of area-uniform points.
        generator: of the points.

    Raises:
        MeasureError: MeshLab left out some of the points.
    """
    uniform = distance_statistics(destination, sample_surface(origin, samples, generator).points)
    features = distance_statistics(destination, _feature_points(origin))
    return DistanceStatistics(max(uniform.largest, features.largest), uniform.mean, uniform.rms, samples)


def _feature_points(mesh: Mesh) -> Float64[np.ndarray, "N 3"]:
    """Return the vertices that faces use, and the midpoint of every edge."""
    ends = mesh.verts[Topology.of(mesh).edges]
    return np.concatenate([mesh.verts[np.unique(mesh.faces)], ends.mean(axis=1)])
