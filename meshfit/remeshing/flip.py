"""Edge flips, towards valence 6 and larger angles."""

import math

import torch
from torch import Tensor

from meshfit.remeshing.connectivity import Edges, contained
from meshfit.remeshing.state import RemeshState
from meshfit.remeshing.triangle_geometry import dot, normal_and_sine

_PASSES = 8
_LAYERS = 3
# A pass that flips fewer edges per vertex is the last of its round.
_WORTHWHILE = 0.001
_LEAN = math.cos(math.radians(30))
_SINE = math.sin(math.radians(25))
_GAIN = math.sin(math.radians(2))


def flip(surface: RemeshState) -> RemeshState:
    """Flip edges towards valence 6, or 4 on the boundary, and for equal valences towards larger smallest angles.

    An edge stays where a new face would lean by more than 30 degrees against an old one, would be flipped, or would
    have a smallest angle below 25 degrees that is smaller than the old one, or where the new edge exists already.
    """
    refused = surface.faces.new_empty(0)
    for _ in range(_PASSES):
        edge, rank = _candidates(surface)
        untried = ~contained(surface.edges.keys.index_select(0, edge), refused)
        tried = _apart(surface.edges, edge.masked_select(untried), rank.masked_select(untried))
        if not len(tried):
            break
        surface, done, keys = *_without_flips(surface, tried), surface.edges.keys
        bad = tried[~contained(tried, done.sort().values)]
        refused = torch.cat([refused, keys.index_select(0, bad)]).sort().values
        if len(done) < _WORTHWHILE * len(surface.verts):
            break
    return surface


def _without_flips(surface: RemeshState, edge: Tensor) -> tuple[RemeshState, Tensor]:
    """Flip edges, except near faces that would look away from their neighbours; return the edges that were flipped."""
    while True:
        a, b, c, d = _quad(surface.edges, edge)
        faces = surface.faces.clone()
        faces[surface.edges.left.index_select(0, edge) // 3] = torch.stack([a, d, c], 1)
        faces[surface.edges.right.index_select(0, edge) // 3] = torch.stack([d, b, c], 1)
        after = RemeshState(surface.verts, faces, surface.lengths, on_sphere=surface.on_sphere)
        near = after.around_flipped(~surface.flipped)
        spoilt = torch.stack([near.index_select(0, vert) for vert in (a, b, c, d)]).any(0)
        if not bool(spoilt.any()):
            return after, edge
        edge = edge.masked_select(~spoilt)


def _quad(edges: Edges, edge: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return tail, head, left apex and right apex of edges."""
    a, b, c, d = (x.index_select(0, edge) for x in (edges.tail, edges.head, edges.left_apex, edges.right_apex))
    return a, b, c, d


def _gain_in_valence(edges: Edges) -> Tensor:
    """Return the decrease of the sum of squared valence errors per flip; -99 where a valence would become too low."""
    # (x - 1)² and (x + 1)² differ from x² by 1 ∓ 2 x.
    twice = 2 * (edges.valence - torch.where(edges.on_boundary, 4, 6))
    gain = twice.index_select(0, edges.tail) + twice.index_select(0, edges.head) - 4
    gain -= twice.index_select(0, edges.left_apex) + twice.index_select(0, edges.right_apex)
    spare = edges.valence > edges.least_valence
    return gain.masked_fill(~(spare.index_select(0, edges.tail) & spare.index_select(0, edges.head) & edges.inner), -99)


def _candidates(surface: RemeshState) -> tuple[Tensor, Tensor]:
    """Return the edges worth flipping, and their ranks, lower for a larger gain."""
    edges, gain = surface.edges, _gain_in_valence(surface.edges)
    edge = (gain >= 0).nonzero()[:, 0]
    a, b, c, d = (surface.verts.index_select(0, vert) for vert in _quad(edges, edge))
    (left, old_left), (right, old_right) = normal_and_sine(a, b, c), normal_and_sine(b, a, d)
    (first, new_first), (second, new_second) = normal_and_sine(a, d, c), normal_and_sine(d, b, c)
    old, new = torch.minimum(old_left, old_right), torch.minimum(new_first, new_second)
    gain = gain.index_select(0, edge)
    worth = torch.where(gain > 0, new >= old.clamp_max(_SINE), new - old > _GAIN)
    for normal in (first, second):
        worth &= (dot(normal, left) > _LEAN) & (dot(normal, right) > _LEAN)
    which = worth.nonzero()[:, 0]
    edge, steps = edge.index_select(0, which), 15 - (gain.index_select(0, which) // 2).clamp_max(15)
    new_edge = ~edges.have(edges.left_apex.index_select(0, edge), edges.right_apex.index_select(0, edge))
    edge, steps = edge.masked_select(new_edge), steps.masked_select(new_edge)
    return edge, (steps << 52) | edges.scrambled.index_select(0, edge)


def _apart(edges: Edges, edge: Tensor, rank: Tensor) -> Tensor:
    """Choose edges whose pairs of faces have no common vertices, by ascending rank."""
    chosen, last = [], torch.iinfo(torch.int64).max
    for _ in range(_LAYERS):
        quad = torch.stack(_quad(edges, edge))
        best = rank.new_full((edges.num_verts,), last)
        best.scatter_reduce_(0, quad.view(-1), rank.repeat(4), "amin")
        wins = (best.index_select(0, quad.view(-1)).view_as(quad) == rank).all(0)
        chosen.append(edge.masked_select(wins))
        taken = torch.zeros_like(best, dtype=torch.bool)
        taken[quad[:, wins].reshape(-1)] = True
        free = ~taken.index_select(0, quad.view(-1)).view_as(quad).any(0)
        edge, rank = edge.masked_select(free), rank.masked_select(free)
    return torch.cat(chosen)
