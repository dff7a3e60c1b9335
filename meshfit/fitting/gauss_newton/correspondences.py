"""Correspondences: pairs of points that a step brings together, from the surface to the target and back."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from scipy.spatial import cKDTree
from torch import Generator, Tensor

from meshfit.fitting.gauss_newton.fairness import in_membranes, membrane_share
from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.gauss_newton.target import TargetBoundary, TargetCloud
from meshfit.fitting.nearest_neighbours import nearest_neighbour_search
from meshfit.fitting.settings import Direction
from meshfit.remeshing.triangle_geometry import dot, length_of, unit

# Points of a face, as weights of its corners: the middle, and one towards each corner.
_FACE_POINTS = ((1 / 3, 1 / 3, 1 / 3), (0.7, 0.15, 0.15), (0.15, 0.7, 0.15), (0.15, 0.15, 0.7))
# Number of faces beyond which the first of these is enough.
_MANY_FACES = 30_000
_SHARE_OF_VERTS = 0.25
_LEAST_DRAWN, _DRAWN_PER_VERT = 2000, 4
# Least cosines between the normals of a pair, from the surface, and from the target, from where the far side of a thin
# part is often nearest.
_FACING, _FACING_BACK = 0.0, -0.3
# Share of the surface beyond the rim of the target from which on what is unmatched of the rest tells nothing.
_MUCH_BEYOND = 0.2
# Triangles whose double area is below this many roundings of the square of their longest side have no plane.
_FLAT = 16.0
# Weight of the boundary: that of a strip of the surface of this many edge lengths.
_STRIP = 4.0
# Standard deviation of normal values over the median of their absolute ones, less what a vector has more.
_NORMAL_MEDIAN = 1.4826
# Neighbours that tell whether a part of the target is out of reach, or a point of it an outlier.
_AROUND = 8


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Points of the surface, and where they should go.

    Attributes:
        face: (M,) face of each point.
        corners: (M, 3) barycentric coordinates of each point in its face.
        normals: (M, 3) unit normals of the target at the corresponding points.
        residuals: (M, 3) vectors from the points to the corresponding points.
        weights: (M,) with a sum of about 2, 1 per direction.
        matched: share of the points, in both directions, whose nearest neighbour faces the same way.
        reached: the same, of those that can have one: not of points beyond the rim of the target; and where much of the
            surface spans what the target does not show, and so passes behind what it does, of the target's alone.
        membranes: (V,) share of the area at each vertex that spans a gap of the target.
        measured: their distance, if not all rows are pairs of points.
    """

    face: Int64[Tensor, " M"]
    corners: Float[Tensor, "M 3"]
    normals: Float[Tensor, "M 3"]
    residuals: Float[Tensor, "M 3"]
    weights: Float[Tensor, " M"]
    matched: float
    reached: float
    membranes: Float[Tensor, " V"]
    measured: float | None = None

    @property
    def distance(self) -> float:
        """Root of the weighted mean of squared residuals."""
        if self.measured is not None:
            return self.measured
        total = (self.weights * self.residuals.square().sum(1)).sum()
        return math.sqrt(float(total / self.weights.sum().clamp_min(1e-30)))


def find_correspondences(
    shape: Shape,
    target: TargetCloud,
    generator: Generator,
    direction: Direction = "both",
    robust: float | None = None,
) -> Correspondences:
    """Pair points of the surface with the nearest of the target, and the other way round, where normals agree.

    The points of the surface are its vertices and fixed points of each face, weighted by area; those on membranes are
    left out, and so are those beyond the rim of the target. The points of the target are drawn at random; each is
    paired with the nearest point of the face on which its nearest point of the surface lies. If both have a boundary,
    its points are paired as well.

    Args:
        shape: the surface.
        target: the target.
        generator: generator of the random points, on the CPU.
        direction: pairs to return.
        robust: number of robust standard deviations beyond which residuals count little; None for no limit.
    """
    pattern = _FACE_POINTS[: 1 if len(shape.connectivity.faces) > _MANY_FACES else None]
    face, corners, weights = _surface_points(shape, pattern)
    points = shape.points(face, corners)
    normals = torch.cat([shape.normals.repeat_interleave(len(pattern), 0), shape.vert_normals])
    nearest = target.nearest(points)
    away, opposite = points - target.points.index_select(0, nearest), target.normals.index_select(0, nearest)
    beyond = target.is_beyond(points, nearest)
    spanning = in_membranes(shape, face, away, normals, opposite) & ~beyond
    spanning_in_faces = spanning[: len(pattern) * len(shape.corners)].view(-1, len(pattern))
    forward = (dot(normals, opposite) > _FACING) & ~spanning & ~beyond
    drawn = target.draw(max(_LEAST_DRAWN, _DRAWN_PER_VERT * len(shape.verts)), generator)
    hit = nearest_neighbour_search(points)(target.points[drawn])
    backward = dot(normals[hit], target.normals[drawn]) > _FACING_BACK
    matched = float(forward.sum() + backward.sum()) / (len(forward) + len(backward))
    reached = _share_reached(forward, backward, beyond)
    if direction == "to-source":
        forward = torch.zeros_like(forward)
    if direction == "to-target":
        backward = torch.zeros_like(backward)
    weights = weights[forward]
    hit, drawn = hit[backward], drawn[backward]
    goals = torch.cat([nearest[forward], drawn])
    faces = torch.cat([face[forward], face[hit]])
    at = torch.cat(
        [corners[forward], nearest_in_triangles(target.points[drawn], shape.corners.index_select(0, face[hit]))]
    )
    residuals = target.points.index_select(0, goals) - shape.points(faces, at)
    weights = torch.cat([weights, weights.new_full((len(drawn),), 1 / len(backward))])
    if robust is not None and target.noise and len(drawn):
        weights = weights * _welsch(residuals, target, drawn, robust)
    pairs = Correspondences(
        face=faces,
        corners=at,
        normals=target.normals.index_select(0, goals),
        residuals=residuals,
        weights=weights,
        matched=matched,
        reached=reached,
        membranes=membrane_share(shape, spanning_in_faces.to(points).mean(1)),
    )
    if target.boundary is None or not len(shape.connectivity.edges.outer):
        return pairs
    return _with_boundary(pairs, shape, target.boundary, generator)


def _share_reached(forward: Bool[Tensor, " M"], backward: Bool[Tensor, " N"], beyond: Bool[Tensor, " M"]) -> float:
    """Return the share of the points that can be matched that are; see `Correspondences.reached`."""
    num_beyond = int(beyond.sum())
    if num_beyond > _MUCH_BEYOND * len(beyond):
        return float(backward.double().mean())
    return float(forward.sum() + backward.sum()) / (len(forward) - num_beyond + len(backward))


def _welsch(
    residuals: Float[Tensor, "M 3"], target: TargetCloud, drawn: Int64[Tensor, " N"], robust: float
) -> Float[Tensor, " M"]:
    """Return the weights of residuals, the last N of which are those of points of the target (Welsch's function).

    Those of the surface's points stay 1. So do those of points of the target around which most others are as far from
    the surface: it has yet to reach them.
    """
    lengths, weights = length_of(residuals), torch.ones_like(residuals[:, 0])
    scale = robust * max(target.noise, _NORMAL_MEDIAN * float(lengths.median()))
    lengths = lengths[len(lengths) - len(drawn) :]
    far = lengths > scale
    # A point may be drawn more than once.
    rows, first = np.unique(drawn.cpu().numpy(), return_index=True)
    if bool(far.any()) and len(rows) > _AROUND:
        points, far_rows = target.points[drawn].cpu().double().numpy(), far.cpu().numpy()
        around = np.asarray(cKDTree(points[first]).query(points[far_rows], _AROUND + 1)[1])[:, 1:]
        reached = (~far_rows[first])[around].sum(axis=1) * 2 >= _AROUND
        far[far.clone()] = torch.tensor(reached, device=far.device)
    else:
        far[:] = False
    within = (lengths <= scale) | far
    weights[len(weights) - len(drawn) :] = torch.where(within, (-(lengths / scale).square()).exp(), 1.0)
    return weights


def _surface_points(shape: Shape, face_points: Sequence[Sequence[float]]) -> tuple[Tensor, Tensor, Tensor]:
    """Return faces, barycentric coordinates and weights of the points in faces, then of the vertices."""
    area = shape.double_area / shape.double_area.sum()
    pattern = area.new_tensor(face_points)
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
    """Return the point of each triangle that is nearest to a point, in barycentric coordinates.

    It is the foot of the perpendicular, if that is inside, and else the nearest of the nearest points of the sides.
    Triangles without area have no foot.
    """
    ends = corners.unbind(1)
    sides = [ends[(k + 1) % 3] - ends[k] for k in range(3)]
    away = [points - end for end in ends]
    normal = torch.linalg.cross(sides[0], sides[1])
    # Side k - 2 is opposite corner k.
    weights = torch.stack([dot(torch.linalg.cross(sides[k - 2], away[k - 2]), normal) for k in range(3)], 1)
    weights = weights / weights.sum(1, keepdim=True)
    longest = torch.stack([dot(side, side) for side in sides]).amax(0)
    flat = dot(normal, normal) <= (_FLAT * torch.finfo(points.dtype).eps * longest).square()
    outside = (flat | ~(weights >= 0).all(1)).nonzero()[:, 0]
    sides, away = ([vectors.index_select(0, outside) for vectors in each] for each in (sides, away))
    weights[outside] = _nearest_on_sides(sides, away)
    return weights


def _nearest_on_sides(sides: Sequence[Tensor], away: Sequence[Tensor]) -> Tensor:
    """Return the nearest points of the three sides of triangles, in barycentric coordinates.

    Args:
        sides: for each side k, (N, 3) vectors from corner k to the next corner.
        away: for each side k, (N, 3) vectors from corner k to the point that is looked for.
    """
    tiny = torch.finfo(sides[0].dtype).tiny
    shares = [(dot(p, side) / dot(side, side).clamp_min(tiny)).clamp(0, 1) for p, side in zip(away, sides, strict=True)]
    rest = [p - share[:, None] * side for p, side, share in zip(away, sides, shares, strict=True)]
    best = torch.stack([dot(offset, offset) for offset in rest]).nan_to_num(torch.inf).argmin(0)
    share = torch.stack(shares).gather(0, best[None])[0]
    weights = sides[0].new_zeros(len(best), 3)
    weights.scatter_(1, best[:, None], (1 - share)[:, None])
    return weights.scatter_(1, (best[:, None] + 1) % 3, share[:, None])


def _with_boundary(
    pairs: Correspondences, shape: Shape, boundary: TargetBoundary, generator: Generator
) -> Correspondences:
    """Add pairs of boundary points, which are free to slide along the target's boundary.

    Vertices and middles of boundary edges go to the nearest points of the target's boundary, and random points of that
    to the nearest of these. Each pair is added twice, once for each of two normals of the target's boundary curve.
    """
    side = shape.connectivity.edges.left[shape.connectivity.edges.outer]
    first = torch.nn.functional.one_hot(side % 3, 3).to(shape.verts)
    second = torch.nn.functional.one_hot((side + 1) % 3, 3).to(shape.verts)
    face, corners = (side // 3).repeat(2), torch.cat([first, (first + second) / 2])
    points = shape.points(face, corners)
    drawn = torch.randint(len(boundary.points), (len(points),), generator=generator).to(points.device)
    goals = torch.cat([nearest_neighbour_search(boundary.points)(points), drawn])
    nearest = nearest_neighbour_search(points)(boundary.points[drawn])
    rows = torch.cat([torch.arange(len(points), device=points.device), nearest])
    outer = shape.edge_lengths[shape.connectivity.edges.outer]
    weight = _STRIP * float(outer.sum() * outer.mean() / (shape.double_area.sum() / 2)) / len(points)
    return replace(
        pairs,
        face=torch.cat([pairs.face, face[rows].repeat(2)]),
        corners=torch.cat([pairs.corners, corners[rows].repeat(2, 1)]),
        normals=torch.cat([pairs.normals, *_curve_normals(boundary.tangents[goals])]),
        residuals=torch.cat([pairs.residuals, (boundary.points[goals] - points[rows]).repeat(2, 1)]),
        weights=torch.cat([pairs.weights, points.new_full((2 * len(rows),), weight)]),
    )


def _curve_normals(tangents: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"]]:
    """Return two unit vectors orthogonal to each tangent and to each other."""
    least = torch.nn.functional.one_hot(tangents.abs().argmin(1), 3).to(tangents)
    normal = unit(torch.linalg.cross(tangents, least))
    return normal, torch.linalg.cross(tangents, normal)
