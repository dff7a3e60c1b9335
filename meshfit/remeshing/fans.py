"""Fans that lie flat: the faces about a vertex of which none can run through another."""

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

# The least cosine between the normals of a fan and their mean.
_UPRIGHT = 0.1


def simple_fans(
    faces: Int64[Tensor, "F 3"], corners: Float64[Tensor, "F 3 3"], normals: Float64[Tensor, "F 3"], num_verts: int
) -> Bool[Tensor, " V"]:
    """Which verts have faces that, seen along the mean of their normals, close once around them without overlap.

    Of the faces about such a vertex, no two meet but at it and along sides that they share: seen so, all of them are
    counter-clockwise, the verts they lead to are those they come from, and one of them crosses a half-line from the
    vertex, so that they go around once (compare Volino and Magnenat-Thalmann, Efficient self-collision detection on
    smoothly discretized surface animations, 1994). Verts on a boundary have no such fan.

    Args:
        faces: int64, vertex indices.
        corners: float64, the positions of these.
        normals: float64, across each face; 0 where it has none.
        num_verts: V.
    """
    units = normals / dot(normals, normals).sqrt().clamp_min(torch.finfo(torch.float64).tiny)[:, None]
    mean = corners.new_zeros(num_verts, 3)
    for k in range(3):
        mean.index_add_(0, faces[:, k], units)
    mean /= dot(mean, mean).sqrt().clamp_min(torch.finfo(torch.float64).tiny)[:, None]
    level = _level(mean)
    label = _scrambled(torch.arange(num_verts, device=faces.device))
    upright = torch.ones(num_verts, dtype=torch.bool, device=faces.device)
    balance, turns = torch.zeros_like(label), torch.zeros_like(label)
    for k in range(3):
        vert, ahead, behind = faces[:, k], (k + 1) % 3, (k + 2) % 3
        upright[vert[dot(mean.index_select(0, vert), units) < _UPRIGHT]] = False
        balance.index_add_(0, vert, label.index_select(0, faces[:, ahead]) - label.index_select(0, faces[:, behind]))
        axis = level.index_select(0, vert)
        below, above = (dot(corners[:, end] - corners[:, k], axis) < 0 for end in (ahead, behind))
        turns.index_add_(0, vert, (below & ~above).long())
    return upright & (balance == 0) & (turns == 1)


def dot(a: Float64[Tensor, "N 3"], b: Float64[Tensor, "N 3"]) -> Float64[Tensor, " N"]:
    """Inner products of rows, rounded alike wherever a row stands."""
    products = a * b
    return products[:, 0] + products[:, 1] + products[:, 2]


def _level(mean: Float64[Tensor, "V 3"]) -> Float64[Tensor, "V 3"]:
    """A direction across each of some others."""
    x, y, z = mean.unbind(1)
    zero = torch.zeros_like(x)
    return torch.where((x.abs() > z.abs())[:, None], torch.stack([-y, x, zero], 1), torch.stack([zero, -z, y], 1))


def _scrambled(index: Int64[Tensor, " V"]) -> Int64[Tensor, " V"]:
    """Indices as numbers all over 64 bits, sums of which agree for different indices by accident only (SplitMix64)."""
    for shift, factor in ((30, -0x40A7B892E31B1A47), (27, -0x6B2FB644ECCEEE15)):
        index = (index + 1) * factor
        index = index ^ (index >> shift)
    return index
