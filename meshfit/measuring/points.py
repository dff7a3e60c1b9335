"""Chamfer distance, F-score and normal consistency between two clouds of area-uniform points.

Nearest points are those of the other cloud, not of the other surface, so that even identical surfaces are about half a
point spacing apart. These values compare fits at the same number of points; they do not tend to zero.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.measuring.surface import require_surface
from meshfit.mesh.geometry import face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.sampling import sample_surface


@dataclass(frozen=True)
class Chamfer:
    """Chamfer distances: the sum of the means in both directions, as in PyTorch3D.

    Attributes:
        l1: mean distance, forward plus backward, in the unit of the vertices.
        l2_squared: mean squared distance, forward plus backward.
        points: number of points on each surface.
    """

    l1: float
    l2_squared: float
    points: int


@dataclass(frozen=True)
class FScore:
    """F-score at a distance (Knapitsch et al. 2017, Tanks and Temples, eqs. 3 to 5), as fractions of 1.

    Attributes:
        tau: the distance, in the unit of the vertices.
        f1: harmonic mean of precision and recall; 0 where both are 0.
        precision: share of the result's points within tau of a point of the target.
        recall: share of the target's points within tau of a point of the result.
    """

    tau: float
    f1: float
    precision: float
    recall: float


@dataclass(frozen=True)
class NormalConsistency:
    """Mean cosine between the normals of nearest points (Mescheder et al. 2019, Occupancy Networks, sec. 4).

    Attributes:
        signed: mean of both directions; -1 where one surface is the other turned inside out. None for a cloud whose
            normals are estimated, which have no side.
        absolute: mean of the absolute cosines, whatever the orientation.
    """

    signed: float | None
    absolute: float


@dataclass(frozen=True, eq=False)
class Samples:
    """Points on a surface, with its unit normals there."""

    points: Float64[np.ndarray, "N 3"]
    normals: Float64[np.ndarray, "N 3"]


def point_scores(
    result: Mesh, target: Mesh, count: int, tau: float, seed: int
) -> tuple[Chamfer, FScore, NormalConsistency]:
    """Return chamfer distance, F-score and normal consistency of two surfaces.

    Args:
        result: the fitted mesh.
        target: the mesh that it was fitted to.
        count: number of area-uniform points on each.
        tau: distance of the F-score, in the unit of the vertices.
        seed: of the points; each surface has its own random stream.

    Raises:
        MeasureError: a mesh without a surface.
    """
    require_surface(result, "result")
    require_surface(target, "target")
    for_result, for_target = np.random.default_rng(seed).spawn(2)
    return scores_of(surface_samples(result, count, for_result), surface_samples(target, count, for_target), tau)


def scores_of(on_result: Samples, on_target: Samples, tau: float) -> tuple[Chamfer, FScore, NormalConsistency]:
    """Return chamfer distance, F-score and normal consistency of as many points on each of two surfaces."""
    count = len(on_result.points)
    forward, forward_cosine = _to_nearest(on_result, on_target)
    backward, backward_cosine = _to_nearest(on_target, on_result)
    cosines = np.stack([forward_cosine, backward_cosine])
    return (
        Chamfer(float(forward.mean() + backward.mean()), float((forward**2).mean() + (backward**2).mean()), count),
        _f_score(tau, precision=float((forward <= tau).mean()), recall=float((backward <= tau).mean())),
        NormalConsistency(float(cosines.mean()), float(np.abs(cosines).mean())),
    )


def surface_samples(mesh: Mesh, count: int, generator: np.random.Generator) -> Samples:
    """Return area-uniform points on a mesh."""
    samples = sample_surface(mesh, count, generator)
    return Samples(samples.points, face_normals(mesh)[samples.faces])


def _to_nearest(origin: Samples, destination: Samples) -> tuple[Float64[np.ndarray, " N"], Float64[np.ndarray, " N"]]:
    """Return the distance from each point to the nearest of the other cloud, and the cosine between their normals."""
    nearest = nearest_point_query(destination.points)(origin.points)
    distance = np.linalg.norm(origin.points - destination.points[nearest], axis=1)
    return np.asarray(distance), np.asarray((origin.normals * destination.normals[nearest]).sum(axis=1))


def _f_score(tau: float, *, precision: float, recall: float) -> FScore:
    total = precision + recall
    return FScore(tau, 2 * precision * recall / total if total else 0.0, precision, recall)
