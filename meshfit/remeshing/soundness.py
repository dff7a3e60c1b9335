"""Which collapses leave a sound surface: its topology, and the shape of its faces."""

import math

import torch
from jaxtyping import Bool
from torch import Tensor

from meshfit.remeshing.candidates import Collapses
from meshfit.remeshing.connectivity import Edges
from meshfit.remeshing.moving import Moving
from meshfit.remeshing.shapes import corners_of, dot, length_of, normal_and_sine

_TURN = math.cos(math.radians(60))
_SINE = math.sin(math.radians(15))
# Edges shorter than this share of what is wanted may leave longer ones behind, by as much as they are shorter.
_VERY_SHORT = 0.5


def linked(surface: Moving, chosen: Collapses) -> Bool[Tensor, " C"]:
    """Which edges have ends without common neighbours but those across from the edge.

    With the valences asked for, this is the link condition (Dey, Edelsbrunner, Guha and Nekhayev, Topology preserving
    edge contraction, 1999), under which a collapse keeps the topology.
    """
    edges = surface.edges
    owner = torch.full((edges.num_verts,), -1, device=edges.keys.device)
    owner[chosen.gone] = torch.arange(len(chosen.edge), device=owner.device)
    common = torch.zeros_like(chosen.edge)
    for here, there in ((edges.tail, edges.head), (edges.head, edges.tail)):
        collapse = owner.index_select(0, here)
        which = (collapse >= 0).nonzero()[:, 0]
        collapse = collapse.index_select(0, which)
        both = edges.have(chosen.kept.index_select(0, collapse), there.index_select(0, which))
        common.index_add_(0, collapse, both.long())
    return common == 1 + edges.inner.index_select(0, chosen.edge).long()


def shapely(surface: Moving, chosen: Collapses, moved: Tensor, long: float) -> Bool[Tensor, " C"]:
    """Which collapses leave faces that neither turn nor become slivers, and edges that are not too long.

    Args:
        surface: as it is.
        chosen: the collapses.
        moved: (V, 3) the verts as they will be.
        long: the longest edge allowed, as a share of the length wanted.
    """
    owner, shared = chosen.owners(surface.faces, len(moved))
    near = (shared > 0).nonzero()[:, 0]
    owner, rows = owner.index_select(0, near), surface.faces.index_select(0, near)
    stays = shared.index_select(0, near) == 1
    before, sine_before = normal_and_sine(*corners_of(surface.verts, rows))
    after, sine = normal_and_sine(*corners_of(moved, rows))
    least = torch.full_like(chosen.length, _SINE).scatter_reduce_(0, owner, sine_before, "amin")
    bad = (sine < least.index_select(0, owner)) | _too_long(surface, chosen, moved, rows, long)
    turned = (stays & (dot(before, after) < _TURN)).nonzero()[:, 0]
    beyond = _normals_beyond(surface, chosen, near.index_select(0, turned))
    now, was = (dot(normals.index_select(0, turned), beyond) for normals in (after, before))
    bad[turned] |= (now < _TURN) | (now < was)
    fine = torch.ones_like(chosen.edge, dtype=torch.bool)
    fine[owner.masked_select(bad & stays)] = False
    return fine


def _too_long(surface: Moving, chosen: Collapses, moved: Tensor, rows: Tensor, long: float) -> Tensor:
    """Which of some faces get an edge that is too long."""
    wanted = surface.lengths.clone()
    wanted[chosen.kept], wanted[chosen.gone] = chosen.length, chosen.length
    # A share where a collapse moves the vertex, 0 elsewhere.
    share = torch.zeros_like(wanted)
    spare = (_VERY_SHORT - surface.ratio.index_select(0, chosen.edge)).clamp_min(0)
    share[chosen.kept], share[chosen.gone] = long + spare, long + spare
    bad = torch.zeros_like(rows[:, 0], dtype=torch.bool)
    for k in range(3):
        p, q = rows[:, k], rows[:, (k + 1) % 3]
        limit = torch.maximum(share.index_select(0, p), share.index_select(0, q))
        side = length_of(moved.index_select(0, p) - moved.index_select(0, q))
        bad |= (limit > 0) & (side > limit * (wanted.index_select(0, p) + wanted.index_select(0, q)) / 2)
    return bad


def _normals_beyond(surface: Moving, chosen: Collapses, which: Tensor) -> Tensor:
    """The normals of the neighbours across from the one corner of faces that moves; 0 on the boundary."""
    edges = surface.edges
    moves = torch.zeros(edges.num_verts, dtype=torch.int32, device=which.device)
    moves[chosen.kept], moves[chosen.gone] = 1, 1
    corner = moves.index_select(0, surface.faces.index_select(0, which).reshape(-1)).view(-1, 3).argmax(1)
    side = edges.of_side.index_select(0, which).gather(1, ((corner + 1) % 3)[:, None])[:, 0]
    left, right = edges.left.index_select(0, side) // 3, edges.right.index_select(0, side)
    beyond = torch.where(left == which, right.clamp_min(0) // 3, left)
    return surface.normals.index_select(0, beyond).masked_fill((right < 0)[:, None], 0)


def in_turn(edges: Edges, chosen: Collapses) -> Collapses:
    """Without those that would, together with others, take too many edges from a vertex; they may come next time."""
    apexes = [apex.index_select(0, chosen.edge) for apex in (edges.left_apex, edges.right_apex)]
    number = torch.arange(len(chosen.edge), device=chosen.edge.device)
    lost = sum((torch.bincount(apex, minlength=edges.num_verts) for apex in apexes), torch.zeros_like(edges.valence))
    free = edges.valence - lost >= edges.least_valence
    first = torch.full_like(lost, len(number))
    for apex in apexes:
        first.scatter_reduce_(0, apex, number, "amin")
    left, right = (free.index_select(0, apex) | (first.index_select(0, apex) == number) for apex in apexes)
    return chosen.only(left & right)
