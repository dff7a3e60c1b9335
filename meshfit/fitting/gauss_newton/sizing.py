"""Sizing field of a fit: shorter edges where the target is curved."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.remeshing.sizing import limit_gradation, num_verts_for
from meshfit.remeshing.triangle_geometry import dot

# Lengths fall with curvature to this power. Distances grow as curvature times squared length, so for a given number of
# vertices 1/4 is best for the mean distance, 1/3 for the root mean square, 1/2 for the largest.
_POWER = 0.35
_LARGEST_RATIO = 2.5
_GRADATION = 0.3
_SMOOTHINGS = 2


def lengths_for(
    shape: Shape, num_verts: float, target: TargetCloud | None, power: float = _POWER
) -> Float[Tensor, " V"]:
    """Return the target edge length at each vertex for about `num_verts` vertices.

    Args:
        shape: the surface.
        num_verts: number of vertices after remeshing.
        target: the source of curvature; None for one length everywhere.
        power: power of the curvature with which lengths fall.
    """
    lengths = torch.ones_like(shape.verts[:, 0])
    if target is not None:
        curvature = _curvature(shape, target)
        lengths = (curvature / curvature.median().clamp_min(1e-12) + 0.1).pow(-power)
        lengths = lengths.clamp(1 / _LARGEST_RATIO, _LARGEST_RATIO)
        # Limiting the gradation shortens edges, which changes the scale.
        for _ in range(2):
            lengths = _scaled(shape, lengths, num_verts)
            lengths = limit_gradation(lengths, shape.verts, shape.connectivity.faces, _GRADATION)
    return _scaled(shape, lengths, num_verts)


def _scaled(shape: Shape, lengths: Tensor, num_verts: float) -> Tensor:
    # Of a surface with many handles, the prediction may be below 0.
    predicted = max(1.0, num_verts_for(shape.verts, shape.connectivity.faces, lengths))
    return lengths * math.sqrt(predicted / num_verts)


def _curvature(shape: Shape, target: TargetCloud) -> Tensor:
    """Return (V,) the root mean square, over edges, of the turn of the target's normals per length."""
    connectivity = shape.connectivity
    nearest = target.normals[target.nearest(shape.verts)]
    agrees = dot(nearest, shape.vert_normals) > 0
    normals = torch.where(agrees[:, None], nearest, shape.vert_normals)
    tail, head = connectivity.ends
    turn = (normals[tail] - normals[head]).square().sum(1) / shape.edge_lengths.square().clamp_min(1e-20)
    total = torch.zeros_like(shape.verts[:, :1]).index_add_(0, tail, turn[:, None]).index_add_(0, head, turn[:, None])
    square = total / connectivity.edges.valence.clamp_min(1)[:, None]
    for _ in range(_SMOOTHINGS):
        square = square - (square - connectivity.neighbour_mean(square)) / 2
    return square[:, 0].sqrt()
