"""Tangential relaxation: vertices slide within the surface towards the centroid of their faces."""

import math

import torch
from torch import Tensor

from meshfit.remeshing.state import RemeshState, around
from meshfit.remeshing.triangle_geometry import corners_of, dot, length_of, normal_and_sine, unit

_TURN = math.cos(math.radians(20))
_SINE = math.sin(math.radians(30))
_DAMPING = 0.8
# Faces weigh as their area over length to this power: a vertex between faces of size h and k stays if they weigh as
# 1/h and 1/k.
_POWER = 3
# Number of times a move is halved before it is given up.
_HALVINGS = 3


def relax(surface: RemeshState) -> RemeshState:
    """Move inner vertices within their tangent planes towards the weighted centroid of their faces.

    Faces weigh as their area over the cube of their target length, which leaves a mesh graded as wanted unchanged.
    The tangent plane is orthogonal to the sum of the area vectors, so that moving one vertex keeps the volume. Moves
    are halved three times, then refused, where a face would turn by more than 20 degrees or flip, or get an angle
    below 30 degrees that is smaller than before. The target lengths stay where they are in space.
    """
    step, gradient = _step(surface)
    verts, faces, edges = surface.verts, surface.faces, surface.edges
    before, sine = normal_and_sine(*corners_of(verts, faces))
    least = sine.clamp_max(_SINE)
    were_flipped = edges.flipped(before)
    scale, attempts = torch.ones_like(surface.lengths), 0
    while True:
        moved = verts + step * scale[:, None]
        after, sine = normal_and_sine(*corners_of(moved, faces))
        stop = around(edges, faces, edges.flipped(after) & ~were_flipped)
        bad = ((dot(before, after) < _TURN) | (sine < least)).nonzero()[:, 0]
        stop[faces.index_select(0, bad).reshape(-1)] = True
        stop &= scale > 0
        # Vertices that do not move are as before, so the loop ends.
        if not bool(stop.any()):
            break
        attempts += 1
        scale = torch.where(stop, scale / 2 if attempts <= _HALVINGS else 0, scale)
    low, high = surface.lengths.aminmax()
    return RemeshState(
        moved, faces, (surface.lengths + dot(gradient, step) * scale).clamp(low, high), edges, surface.on_sphere
    )


def _step(surface: RemeshState) -> tuple[Tensor, Tensor]:
    """Return the move of each vertex, 0 on the boundary, and the gradient of the target lengths there."""
    verts, faces, lengths = surface.verts, surface.faces, surface.lengths
    tiny = torch.finfo(verts.dtype).tiny
    a, b, c = corners_of(verts, faces)
    p, q, r = (lengths.index_select(0, faces[:, k]) for k in range(3))
    across = torch.linalg.cross(b - a, c - a)
    double_area = length_of(across)
    weight = double_area / ((p + q + r) / 3) ** _POWER
    # The gradient on a face times its double area is n × (the sum of lengths times opposite sides).
    rise = torch.linalg.cross(unit(across), (c - a) * (p - q)[:, None] - (b - a) * (p - r)[:, None])
    middle = (a + b + c) * (weight / 3)[:, None]
    table = torch.cat([middle, weight[:, None], across, rise, double_area[:, None]], 1)
    total = table.new_zeros(len(verts), table.shape[1])
    for k in range(3):
        total.index_add_(0, faces[:, k], table)
    centroid, normal = total[:, :3] / total[:, 3:4].clamp_min(tiny), unit(total[:, 4:7])
    step = (centroid - verts) * _DAMPING
    step = step - normal * dot(step, normal)[:, None]
    still = surface.edges.on_boundary | (surface.edges.valence == 0)
    return step.masked_fill(still[:, None], 0), total[:, 7:10] / total[:, 10:11].clamp_min(tiny)
