"""Edge scores: distances between the creases of two meshes, its sharp edges.

Edge chamfer distance and edge F-score are those of BSP-Net (Chen et al. 2020, sec. 4) and Neural Marching Cubes (Chen
and Zhang 2021, sec. 4), with two changes that remove their noise: creases are found on the edges of the mesh, by their
dihedral angle, and not on samples whose neighbours have other normals; and distances are to the creases themselves, not
to samples of them, so that identical creases are at distance 0.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.measuring.distance import angles_between
from meshfit.measuring.surface import require_surface
from meshfit.mesh.geometry import face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import segment_distances
from meshfit.mesh.topology import Topology

Segments = Float64[np.ndarray, "S 2 3"]


@dataclass(frozen=True)
class Edges:
    """Agreement of the creases of two meshes.

    Attributes:
        chamfer: sum of the mean distances in both directions, in the unit of the vertices; None where a mesh has no
            creases.
        f1: harmonic mean of precision and recall, 0 where only one mesh has creases; None where neither has.
        precision: share of the length of the result's creases within tau of a crease of the target; None where the
            result has no creases.
        recall: share of the length of the target's creases within tau of a crease of the result; None where the target
            has no creases.
        reason: why a value is missing; empty where none is.
    """

    chamfer: float | None
    f1: float | None
    precision: float | None
    recall: float | None
    reason: str


def edge_scores(result: Mesh, target: Mesh, count: int, angle: float, tau: float, seed: int) -> Edges:
    """Compare the creases of two meshes, at points drawn uniformly by length.

    Args:
        result: the fitted mesh.
        target: the mesh that it was fitted to.
        count: number of points on the creases of each mesh.
        angle: least angle between the normals of the two faces of a crease, in degrees.
        tau: distance of the F-score, in the unit of the vertices.
        seed: of the points; each mesh has its own random stream.

    Raises:
        MeasureError: a mesh without a surface.
    """
    require_surface(result, "result")
    require_surface(target, "target")
    of_result, of_target = crease_segments(result, angle), crease_segments(target, angle)
    if not (len(of_result) and len(of_target)):
        return _without_creases(result=not len(of_result), target=not len(of_target), angle=angle)
    for_result, for_target = np.random.default_rng(seed).spawn(2)
    forward = segment_distances(of_target, _sample(of_result, count, for_result))
    backward = segment_distances(of_result, _sample(of_target, count, for_target))
    precision, recall = float((forward <= tau).mean()), float((backward <= tau).mean())
    f1 = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
    return Edges(float(forward.mean() + backward.mean()), f1, precision, recall, "")


def crease_segments(mesh: Mesh, angle: float) -> Segments:
    """Return (S, 2, 3) the ends of the edges between two faces whose normals differ by at least an angle.

    Boundary edges, and edges of a face without area, are no creases.

    Args:
        mesh: the mesh.
        angle: in degrees.
    """
    topology = Topology.of(mesh)
    pairs, normals = topology.face_pairs, face_normals(mesh)
    first, second = (normals[halfedge // 3] for halfedge in pairs.T)
    misoriented = topology.tail[pairs[:, 0]] == topology.tail[pairs[:, 1]]
    second = np.where(misoriented[:, None], -second, second)
    sharp = first.any(axis=1) & second.any(axis=1) & (angles_between(first, second) >= angle)
    halfedges = pairs[sharp, 0]
    return np.asarray(mesh.verts[np.stack([topology.tail[halfedges], topology.head[halfedges]], axis=1)])


def _without_creases(*, result: bool, target: bool, angle: float) -> Edges:
    """Return the scores where the result, the target or both have no creases."""
    who = "neither mesh has" if result and target else f"the {'result' if result else 'target'} has no"
    return Edges(
        chamfer=None,
        f1=None if result and target else 0.0,
        precision=None if result else 0.0,
        recall=None if target else 0.0,
        reason=f"{who} creases of {angle:g}° or more",
    )


def _sample(segments: Segments, count: int, generator: np.random.Generator) -> Float64[np.ndarray, "N 3"]:
    """Draw points uniformly by length, one in each of `count` equal parts of the total length."""
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    ends = np.cumsum(lengths)
    at = (np.arange(count) + generator.random(count)) * (ends[-1] / count)
    chosen = np.searchsorted(ends, at, side="right").clip(max=len(segments) - 1)
    share = ((at - ends[chosen]) / lengths[chosen] + 1).clip(0, 1)[:, None]
    return np.asarray((1 - share) * segments[chosen, 0] + share * segments[chosen, 1])
