"""How fine a surface is to be where: shorter edges where the target is curved."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.remeshing.sizing import limited, num_verts_for
from meshfit.remeshing.triangle_geometry import dot

# Lengths go with curvature to this power: -1/4 is best for the mean distance of a mesh of given size, -1/3 for the root
# mean square, -1/2 for the largest, as distances go with curvature times squared length.
_POWER = 0.35
_LARGEST_RATIO = 2.5
_GRADATION = 0.3
_SMOOTHINGS = 2


def lengths_for(
    shape: Shape, num_verts: float, target: TargetCloud | None, power: float = _POWER
) -> Float[Tensor, " V"]:
    """The edge length wanted at each vertex, such that there will be about so many verts.

    Args:
        shape: the surface.
        num_verts: wanted.
        target: where curvature is to be taken from; None for one length everywhere.
        power: of curvature that lengths go down with.
    """
    lengths = torch.ones_like(shape.verts[:, 0])
    if target is not None:
        curvature = _curvature(shape, target)
        lengths = (curvature / curvature.median().clamp_min(1e-12) + 0.1).pow(-power)
        lengths = lengths.clamp(1 / _LARGEST_RATIO, _LARGEST_RATIO)
        # Limited growth takes off length, which takes another scale.
        for _ in range(2):
            lengths = _scaled(shape, lengths, num_verts)
            lengths = limited(lengths, shape.verts, shape.connectivity.faces, _GRADATION)
    return _scaled(shape, lengths, num_verts)


def _scaled(shape: Shape, lengths: Tensor, num_verts: float) -> Tensor:
    return lengths * math.sqrt(num_verts_for(shape.verts, shape.connectivity.faces, lengths) / num_verts)


def _curvature(shape: Shape, target: TargetCloud) -> Tensor:
    """(V,) the root of the mean squared turn of the target's normals along edges, over their lengths."""
    connectivity = shape.connectivity
    found = target.normals[target.nearest(shape.verts)]
    alike = dot(found, shape.vert_normals) > 0
    normals = torch.where(alike[:, None], found, shape.vert_normals)
    tail, head = connectivity.ends
    turn = (normals[tail] - normals[head]).square().sum(1) / shape.edge_lengths.square().clamp_min(1e-20)
    total = torch.zeros_like(shape.verts[:, :1]).index_add_(0, tail, turn[:, None]).index_add_(0, head, turn[:, None])
    square = total / connectivity.edges.valence.clamp_min(1)[:, None]
    for _ in range(_SMOOTHINGS):
        square = square - (square - connectivity.neighbour_mean(square)) / 2
    return square[:, 0].sqrt()
