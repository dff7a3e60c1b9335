"""Pairs of points that a step is to bring together: of the surface to the target, and of the target to the surface."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Generator, Tensor

from meshfit.fitting.gauss_newton.boundary import RimPairs, find_rim_pairs
from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.fitting.matching import nearest_to
from meshfit.remeshing.shapes import dot

# Places within a face, as weights of its corners: the middle, and three towards the corners.
_PLACES = ((1 / 3, 1 / 3, 1 / 3), (0.7, 0.15, 0.15), (0.15, 0.7, 0.15), (0.15, 0.15, 0.7))
_SHARE_OF_VERTS = 0.25
_LEAST_DRAWN, _DRAWN_PER_VERT = 2000, 4
# Cosines between the normals of a pair above which it counts: from the surface, and from the target, of which points
# on thin parts find the far side first.
_FACING, _FACING_BACK = 0.0, -0.3


@dataclass(frozen=True, eq=False)
class Pairs:
    """Points of the surface and where they are to go.

    Attributes:
        face: (M,) the face that each point of the surface lies on.
        corners: (M, 3) its place there, as weights of the corners.
        normals: (M, 3) unit normals of the target at the other point.
        residuals: (M, 3) from the point of the surface to the other one.
        weights: (M,) that add up to about 2, 1 for each direction.
        matched: the share of points, in both directions, that found one facing alike.
    """

    face: Int64[Tensor, " M"]
    corners: Float[Tensor, "M 3"]
    normals: Float[Tensor, "M 3"]
    residuals: Float[Tensor, "M 3"]
    weights: Float[Tensor, " M"]
    matched: float

    @property
    def distance(self) -> float:
        """The root of the weighted mean of squared residuals."""
        total = (self.weights * self.residuals.square().sum(1)).sum()
        return math.sqrt(float(total / self.weights.sum().clamp_min(1e-30)))

    def with_those_of(self, rim: RimPairs) -> "Pairs":
        """These and those of boundaries."""
        return Pairs(
            torch.cat([self.face, rim.face]),
            torch.cat([self.corners, rim.corners]),
            torch.cat([self.normals, rim.normals]),
            torch.cat([self.residuals, rim.residuals]),
            torch.cat([self.weights, rim.weights]),
            self.matched,
        )


def find_pairs(shape: Shape, target: TargetCloud, generator: Generator) -> Pairs:
    """Pair points of the surface with the nearest of the target, and the other way round; those that face alike.

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
    ahead = dot(normals, target.normals[there]) > _FACING
    drawn = target.draw(max(_LEAST_DRAWN, _DRAWN_PER_VERT * len(shape.verts)), generator)
    here = nearest_to(points)(target.points[drawn])
    back = dot(normals[here], target.normals[drawn]) > _FACING_BACK
    here, drawn = here[back], drawn[back]
    found = torch.cat([there[ahead], drawn])
    of_face = torch.cat([face[ahead], face[here]])
    exact = nearest_in_triangles(target.points[drawn], shape.corners[face[here]])
    at = torch.cat([corners[ahead], exact])
    start = (at[:, :, None] * shape.corners[of_face]).sum(1)
    pairs = Pairs(
        face=of_face,
        corners=at,
        normals=target.normals[found],
        residuals=target.points[found] - start,
        weights=torch.cat([weights[ahead], weights.new_full((len(drawn),), 1 / len(back))]),
        matched=float(ahead.sum() + back.sum()) / (len(ahead) + len(back)),
    )
    if target.rim is None or not len(shape.connectivity.edges.outer):
        return pairs
    return pairs.with_those_of(find_rim_pairs(shape, target.rim, generator))


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

    The plane's Voronoi regions of corners, sides and inside are told apart by signs of inner products (Ericson,
    Real-Time Collision Detection, 2004, 5.1.5).
    """
    a, b, c = corners.unbind(1)
    ab, ac = b - a, c - a
    d1, d2 = dot(ab, points - a), dot(ac, points - a)
    d3, d4 = dot(ab, points - b), dot(ac, points - b)
    d5, d6 = dot(ab, points - c), dot(ac, points - c)
    inside = torch.stack([d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2], 1)
    tiny = torch.finfo(points.dtype).tiny
    zero = torch.zeros_like(d1)

    def along(rise: Tensor, run: Tensor) -> Tensor:
        return (rise / torch.where(run.abs() > tiny, run, 1.0)).clamp(0, 1)

    s = along(d1, d1 - d3)
    on_ab = torch.stack([1 - s, s, zero], 1)
    s = along(d2, d2 - d6)
    on_ac = torch.stack([1 - s, zero, s], 1)
    s = along(d4 - d3, (d4 - d3) + (d5 - d6))
    on_bc = torch.stack([zero, 1 - s, s], 1)
    one_a, one_b, one_c = torch.eye(3, dtype=points.dtype, device=points.device).expand(len(points), 3, 3).unbind(1)
    total = inside.sum(1, keepdim=True)
    found = inside / torch.where(total.abs() > tiny, total, 1.0)
    for region, weights in (
        ((inside[:, 2] <= 0) & (d1 >= 0) & (d3 <= 0), on_ab),
        ((inside[:, 1] <= 0) & (d2 >= 0) & (d6 <= 0), on_ac),
        ((inside[:, 0] <= 0) & (d4 >= d3) & (d5 >= d6), on_bc),
        ((d1 <= 0) & (d2 <= 0), one_a),
        ((d3 >= 0) & (d4 <= d3), one_b),
        ((d6 >= 0) & (d5 <= d6), one_c),
    ):
        found = torch.where(region[:, None], weights, found)
    return found
