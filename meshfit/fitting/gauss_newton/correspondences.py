"""Pairs of points that a step is to bring together: of the surface to the target, and of the target to the surface."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Generator, Tensor

from meshfit.fitting.gauss_newton.boundary import BoundaryPairs, boundary_correspondences
from meshfit.fitting.gauss_newton.fairness import in_membranes, membrane_share
from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.fitting.nearest_neighbours import nearest_neighbour_search
from meshfit.remeshing.triangle_geometry import dot

# Places within a face, as weights of its corners: the middle, and three towards the corners.
_PLACES = ((1 / 3, 1 / 3, 1 / 3), (0.7, 0.15, 0.15), (0.15, 0.7, 0.15), (0.15, 0.15, 0.7))
_SHARE_OF_VERTS = 0.25
_LEAST_DRAWN, _DRAWN_PER_VERT = 2000, 4
# Cosines between the normals of a pair above which it counts: from the surface, and from the target, of which points
# on thin parts find the far side first.
_FACING, _FACING_BACK = 0.0, -0.3


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Points of the surface and where they are to go.

    Attributes:
        face: (M,) the face that each point of the surface lies on.
        corners: (M, 3) its place there, as weights of the corners.
        normals: (M, 3) unit normals of the target at the other point.
        residuals: (M, 3) from the point of the surface to the other one.
        weights: (M,) that add up to about 2, 1 for each direction.
        matched: the share of points, in both directions, that found one facing alike.
        membranes: (V,) the share of the area at each vertex that spans a gap of the target.
    """

    face: Int64[Tensor, " M"]
    corners: Float[Tensor, "M 3"]
    normals: Float[Tensor, "M 3"]
    residuals: Float[Tensor, "M 3"]
    weights: Float[Tensor, " M"]
    matched: float
    membranes: Float[Tensor, " V"]

    @property
    def distance(self) -> float:
        """The root of the weighted mean of squared residuals."""
        total = (self.weights * self.residuals.square().sum(1)).sum()
        return math.sqrt(float(total / self.weights.sum().clamp_min(1e-30)))

    def with_boundary(self, boundary: BoundaryPairs) -> "Correspondences":
        """These and those of boundaries."""
        return Correspondences(
            torch.cat([self.face, boundary.face]),
            torch.cat([self.corners, boundary.corners]),
            torch.cat([self.normals, boundary.normals]),
            torch.cat([self.residuals, boundary.residuals]),
            torch.cat([self.weights, boundary.weights]),
            self.matched,
            self.membranes,
        )


def find_correspondences(shape: Shape, target: TargetCloud, generator: Generator) -> Correspondences:
    """Pair points of the surface with the nearest of the target, and the other way round; those that face alike.

    Points of webs are paired with none.

    Points of the target are drawn at random. Those of the surface are its verts and fixed places in each face,
    weighted by area; a point of the target that finds one of them is paired with the nearest point of its face. Where
    both have a boundary, so are points of these.

    Args:
        shape: the surface.
        target: the target.
        generator: of the random points, on the CPU.
    """
    face, corners, weights = _places(shape)
    points = (corners[:, :, None] * shape.corners[face]).sum(1)
    normals = torch.cat([shape.normals.repeat_interleave(len(_PLACES), 0), shape.vert_normals])
    there = target.nearest(points)
    spanning = in_membranes(shape, face, points - target.points[there], normals, target.normals[there])
    in_faces = spanning[: len(_PLACES) * len(shape.corners)].view(-1, len(_PLACES))
    ahead = (dot(normals, target.normals[there]) > _FACING) & ~spanning
    drawn = target.draw(max(_LEAST_DRAWN, _DRAWN_PER_VERT * len(shape.verts)), generator)
    here = nearest_neighbour_search(points)(target.points[drawn])
    back = dot(normals[here], target.normals[drawn]) > _FACING_BACK
    here, drawn = here[back], drawn[back]
    found = torch.cat([there[ahead], drawn])
    of_face = torch.cat([face[ahead], face[here]])
    exact = nearest_in_triangles(target.points[drawn], shape.corners[face[here]])
    at = torch.cat([corners[ahead], exact])
    start = (at[:, :, None] * shape.corners[of_face]).sum(1)
    pairs = Correspondences(
        face=of_face,
        corners=at,
        normals=target.normals[found],
        residuals=target.points[found] - start,
        weights=torch.cat([weights[ahead], weights.new_full((len(drawn),), 1 / len(back))]),
        matched=float(ahead.sum() + back.sum()) / (len(ahead) + len(back)),
        membranes=membrane_share(shape, in_faces.to(points).mean(1)),
    )
    if target.boundary is None or not len(shape.connectivity.edges.outer):
        return pairs
    return pairs.with_boundary(boundary_correspondences(shape, target.boundary, generator))


def _places(shape: Shape) -> tuple[Tensor, Tensor, Tensor]:
    """Faces, weights of corners and weights in the sum of the places on the surface: those in faces, then the verts."""
    area = shape.double_area / shape.double_area.sum()
    pattern = area.new_tensor(_PLACES)
    numbers = torch.arange(len(area), device=area.device)
    face_of_vert, corner = shape.connectivity.face_of_vert
    at_verts = shape.connectivity.at_verts(area[:, None] / 3)[:, 0]
    in_faces = (area * ((1 - _SHARE_OF_VERTS) / len(pattern))).repeat_interleave(len(pattern))
    return (
        torch.cat([numbers.repeat_interleave(len(pattern)), face_of_vert]),
        torch.cat([pattern.repeat(len(area), 1), torch.nn.functional.one_hot(corner, 3).to(area)]),
        torch.cat([in_faces, _SHARE_OF_VERTS * at_verts]),
    )


def nearest_in_triangles(points: Float[Tensor, "N 3"], corners: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 3"]:
    """The point of each triangle that is nearest to a point, as weights of its corners.

    It is the nearest of four: the foot of the perpendicular, if that falls inside, and the nearest on each side. So
    triangles without area need no rule of their own.
    """
    found = [_inside(points, corners)]
    for k in range(3):
        start, side = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        tiny = torch.finfo(points.dtype).tiny
        share = (dot(points - start, side) / dot(side, side).clamp_min(tiny)).clamp(0, 1)
        found.append(torch.stack([1 - share, share, torch.zeros_like(share)], 1).roll(k, 1))
    weights = torch.stack(found)
    distances = ((weights[:, :, :, None] * corners).sum(2) - points).square().sum(2)
    best = distances.nan_to_num(torch.inf).argmin(0)
    return weights[best, torch.arange(len(points), device=points.device)]


def _inside(points: Tensor, corners: Tensor) -> Tensor:
    """Weights of the corners at the foot of the perpendicular; NaN where that is outside."""
    a, b, c = corners.unbind(1)
    across = torch.linalg.cross(b - a, c - a)
    parts = [torch.linalg.cross(q - p, points - p) for p, q in ((b, c), (c, a), (a, b))]
    weights = torch.stack([dot(part, across) for part in parts], 1)
    weights = weights / weights.sum(1, keepdim=True)
    return weights.masked_fill(~(weights >= 0).all(1, keepdim=True), torch.nan)
