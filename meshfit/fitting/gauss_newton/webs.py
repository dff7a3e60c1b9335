"""Webs: parts of the surface that span a gap in the target, such as those between two legs.

Nothing draws them anywhere, since what is nearest to them faces aside. Under tension they shrink towards where they
hang, as soap films do.
"""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from meshfit.fitting.gauss_newton.fairness import Tension
from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.remeshing.shapes import dot, length_of

# A point belongs to a web if it is outside the target, this far from it in sides of its face, and the cosine between
# the normals there is below this.
_FAR, _ASIDE = 0.5, 0.7
# Of an edge in a web, as a share of the weight of all pairs, over the number of verts; less where fairness is less.
_TENSION, _FULL_FAIRNESS = 1.0, 0.1
# What an edge is drawn to, as a share of the median edge.
_REST = 0.3


def in_webs(
    shape: Shape,
    face: Int64[Tensor, " M"],
    away: Float[Tensor, "M 3"],
    normals: Float[Tensor, "M 3"],
    nearest: Float[Tensor, "M 3"],
) -> Bool[Tensor, " M"]:
    """Which points of the surface belong to a web.

    Args:
        shape: the surface.
        face: the face that each point lies on.
        away: from the nearest point of the target to each.
        normals: of the surface at each.
        nearest: of the target at the nearest point.
    """
    sides = shape.edge_lengths[shape.connectivity.edges.of_side].mean(1)
    far = length_of(away) > _FAR * sides[face]
    return far & (dot(away, nearest) > 0) & (dot(normals, nearest) < _ASIDE)


def share_at_verts(shape: Shape, per_face: Float[Tensor, " F"]) -> Float[Tensor, " V"]:
    """The share of the area at each vertex that belongs to webs, from that of each face."""
    area = shape.double_area[:, None]
    whole = shape.connectivity.at_verts(area).clamp_min(torch.finfo(area.dtype).tiny)
    return (shape.connectivity.at_verts(area * per_face[:, None]) / whole)[:, 0]


def tension(shape: Shape, share: Float[Tensor, " V"], fairness: float) -> Tension:
    """How strongly each edge draws its ends together, and how near.

    Edges that are short already are not drawn, so that no part is strangled: they are for remeshing to take away.

    Args:
        shape: the surface.
        share: of each vertex, that belongs to webs.
        fairness: the weight of smoothness; what is nearly done has webs that are hardly more than noise.
    """
    (tail, head), lengths = shape.connectivity.ends, shape.edge_lengths
    weight = _TENSION * min(fairness / _FULL_FAIRNESS, 1.0) / shape.connectivity.num_verts
    rest = (_REST * lengths.median() / lengths.clamp_min(torch.finfo(lengths.dtype).tiny)).clamp_max(1)
    return Tension(((share[tail] + share[head]) * (weight / 2))[:, None], rest[:, None])
