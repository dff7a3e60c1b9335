"""Closeness of a surface to the target: whether a fit may skip the search for the rough shape, and how it ended."""

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from meshfit.fitting.gauss_newton.correspondences import find_correspondences, nearest_in_triangles
from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.fitting.nearest_neighbours import nearest_neighbour_search

# A surface is near if its mean distance from the target is below this share of its mean edge length, and of the
# target's diagonal; if this share of its points is matched; and if nearly all points are within so many edge lengths.
# Decimated targets measured 0.03 to 0.56 edge lengths, spheres 5.8 to 9.9.
_NEAR_EDGES, _NEAR_DIAGONAL = 0.5, 0.02
_NEAR_MATCHED = 0.9
_NEARLY_ALL, _FAR_EDGES = 0.98, 2.0
# Points of the target that distances are measured from, and of each face.
_DRAWN = 20_000
_FACE_POINTS = ((1 / 3, 1 / 3, 1 / 3), (0.6, 0.2, 0.2), (0.2, 0.6, 0.2), (0.2, 0.2, 0.6))
# Within so many spacings of the target's samples, the distance from a sample is that from its tangent plane.
_SPACINGS = 3.0


# A fit ends worse than it began if its root mean square distance is larger, or its largest one so many times as large.
_WORSE_RMS, _WORSE_MAX = 1.02, 1.5


@dataclass(frozen=True)
class Closeness:
    """Distances between a surface and the target, in both directions.

    Attributes:
        rms: root mean square distance.
        worst: largest distance.
    """

    rms: float
    worst: float

    @classmethod
    def of(cls, shape: Shape, target: TargetCloud) -> "Closeness":
        """Measure a surface; the same points of the target are used every time."""
        pattern = shape.verts.new_tensor(_FACE_POINTS)
        count = len(shape.corners)
        points = torch.cat([torch.einsum("kc,fcx->fkx", pattern, shape.corners).reshape(-1, 3), shape.verts])
        faces = torch.arange(count, device=points.device).repeat_interleave(len(pattern))
        face = torch.cat([faces, shape.connectivity.face_of_vert[0]])
        forward = _distances_to(target, points)
        drawn = target.points[target.draw(_DRAWN, Generator().manual_seed(0))]
        corners = shape.corners[face[nearest_neighbour_search(points)(drawn)]]
        nearest = (nearest_in_triangles(drawn, corners)[:, :, None] * corners).sum(1)
        backward = (drawn - nearest).square().sum(1)
        of_faces = forward[: len(faces)].square().view(count, -1).mean(1)
        square = ((shape.double_area * of_faces).sum() / shape.double_area.sum() + backward.mean()) / 2
        return cls(float(square.sqrt()), float(torch.maximum(forward.max(), backward.max().sqrt())))

    def is_worse_than(self, other: "Closeness") -> bool:
        """Return whether a fit that ends so has lost what it began with."""
        return self.rms > _WORSE_RMS * other.rms or self.worst > _WORSE_MAX * other.worst


def _distances_to(target: TargetCloud, points: Tensor) -> Tensor:
    """Return about the distance of points from the target: from its samples, or their tangent planes where near."""
    nearest = target.nearest(points)
    offset = points - target.points[nearest]
    straight = offset.square().sum(1).sqrt()
    plane = (offset * target.normals[nearest]).sum(1).abs()
    return torch.where(straight < _SPACINGS * target.spacing, plane, straight)


def is_near(shape: Shape, target: TargetCloud) -> tuple[bool, float]:
    """Return whether a surface is so near to the target that only details are missing, and its distance from it."""
    pairs = find_correspondences(shape, target, Generator().manual_seed(0))
    if not len(pairs.residuals):
        return False, pairs.distance
    lengths = pairs.residuals.square().sum(1).sqrt()
    mean = float((pairs.weights * lengths).sum() / pairs.weights.sum())
    nearly_all = float(lengths.kthvalue(math.ceil(_NEARLY_ALL * len(lengths))).values)
    edge = float(shape.edge_lengths.mean())
    diagonal = float((target.points.amax(0) - target.points.amin(0)).square().sum().sqrt())
    small = mean < min(_NEAR_EDGES * edge, _NEAR_DIAGONAL * diagonal) and nearly_all < _FAR_EDGES * edge
    return small and pairs.matched > _NEAR_MATCHED, pairs.distance
