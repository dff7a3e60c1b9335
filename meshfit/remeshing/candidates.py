"""Which short edges are to be collapsed at once: the best of each neighbourhood."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from meshfit.remeshing.connectivity import Edges, contained
from meshfit.remeshing.moving import Moving
from meshfit.remeshing.shapes import dot, unit

_LAYERS = 3
_LARGEST_VALENCE = 9
# A boundary that turns by more than 50 degrees at a vertex has a bend there.
_BEND = math.cos(math.radians(50))


@dataclass(frozen=True, eq=False)
class Collapses:
    """Edges that are to become points; no face has verts of two of them.

    Attributes:
        edge: (C,) their numbers, in the order of precedence.
        kept, gone: (C,) the end that stays, and the other.
        place: (C, 3) where it comes to lie.
        length: (C,) the edge length wanted there.
    """

    edge: Int64[Tensor, " C"]
    kept: Int64[Tensor, " C"]
    gone: Int64[Tensor, " C"]
    place: Float[Tensor, "C 3"]
    length: Float[Tensor, " C"]

    def only(self, mask: Tensor) -> "Collapses":
        """Some of them."""
        which = mask.nonzero()[:, 0]
        fields = (self.edge, self.kept, self.gone, self.place, self.length)
        return Collapses(*(field.index_select(0, which) for field in fields))

    def first(self, most: int | None) -> "Collapses":
        """So many of them at most."""
        fields = (self.edge, self.kept, self.gone, self.place, self.length)
        return Collapses(*(field[:most] for field in fields))

    def at(self, place: Tensor) -> "Collapses":
        """The same with other places."""
        return replace(self, place=place)

    def moved(self, verts: Tensor) -> Tensor:
        """Verts, of which both ends of each edge lie at its place."""
        verts = verts.clone()
        verts[self.kept], verts[self.gone] = self.place, self.place
        return verts

    def owners(self, faces: Tensor, num_verts: int) -> tuple[Tensor, Tensor]:
        """Of each face, the collapse that has some of its verts, -1 for none, and how many."""
        owner = torch.full((num_verts,), -1, device=faces.device)
        number = torch.arange(len(self.edge), device=faces.device)
        owner[self.kept], owner[self.gone] = number, number
        a, b, c = owner.index_select(0, faces.reshape(-1)).view(-1, 3).unbind(1)
        return torch.maximum(torch.maximum(a, b), c), (a >= 0).long() + (b >= 0) + (c >= 0)


def choose(surface: Moving, refused: Int64[Tensor, " R"], short: float) -> Collapses:
    """Short edges that may be drawn together as far as valence and boundary go, with no others near.

    Args:
        surface: whose edges.
        refused: keys of edges to leave alone, in rising order.
        short: below which share of the length wanted an edge is short.
    """
    edges, verts = surface.edges, surface.verts
    edge = (surface.ratio < short).nonzero()[:, 0]
    edge = edge[~contained(edges.keys.index_select(0, edge), refused)]
    firmness = _firmness(surface)
    edge = edge[_allowed(edges, edge, firmness)]
    edge = _apart(edges, edge, surface.ratio.index_select(0, edge) / short)
    tail, head = edges.tail.index_select(0, edge), edges.head.index_select(0, edge)
    at_tail, at_head = firmness.index_select(0, tail), firmness.index_select(0, head)
    kept, gone = torch.where(at_head > at_tail, head, tail), torch.where(at_head > at_tail, tail, head)
    share = (at_tail == at_head).to(verts.dtype)[:, None] / 2
    place = torch.lerp(verts.index_select(0, kept), verts.index_select(0, gone), share)
    return Collapses(edge, kept, gone, place, surface.wanted.index_select(0, edge))


def _firmness(surface: Moving) -> Tensor:
    """0 for inner verts, 1 on the boundary, 2 where it bends."""
    edges, verts = surface.edges, surface.verts
    tail, head = edges.tail.index_select(0, edges.outer), edges.head.index_select(0, edges.outer)
    side = unit(verts.index_select(0, head) - verts.index_select(0, tail))
    ahead, behind = torch.zeros_like(verts), torch.zeros_like(verts)
    ahead[tail], behind[head] = side, side
    return edges.on_boundary.long() + (edges.on_boundary & (dot(ahead, behind) < _BEND))


def _allowed(edges: Edges, edge: Tensor, firmness: Tensor) -> Tensor:
    inner, least = edges.inner.index_select(0, edge), edges.least_valence
    tail, head = edges.tail.index_select(0, edge), edges.head.index_select(0, edge)
    merged = edges.valence.index_select(0, tail) + edges.valence.index_select(0, head) - 3 - inner.long()
    needed = torch.minimum(least.index_select(0, tail), least.index_select(0, head))
    fits = (merged <= _LARGEST_VALENCE) & (merged >= needed)
    for apex in (edges.left_apex.index_select(0, edge), edges.right_apex.index_select(0, edge)):
        fits &= edges.valence.index_select(0, apex) > least.index_select(0, apex)
    softer = torch.minimum(firmness.index_select(0, tail), firmness.index_select(0, head))
    return fits & (softer <= 1 - inner.long())


def _apart(edges: Edges, edge: Tensor, ratio: Tensor) -> Tensor:
    """Edges the ends of which have no neighbours among the ends of others, the shortest first, in order of precedence.

    After the edges that come before all near them, those that come before all that are left near them are taken, and
    so on (Luby, A simple parallel algorithm for the maximal independent set problem, 1986).
    """
    rank, order = (((ratio * 16).long().clamp(0, 16) << 52) | edges.scrambled.index_select(0, edge)).sort()
    edge = edge.index_select(0, order)
    chosen, last = [], torch.iinfo(torch.int64).max
    for _ in range(_LAYERS):
        tail, head = edges.tail.index_select(0, edge), edges.head.index_select(0, edge)
        best = rank.new_full((edges.num_verts,), last)
        best.scatter_reduce_(0, tail, rank, "amin").scatter_reduce_(0, head, rank, "amin")
        near = _least_nearby(edges, best)
        wins = torch.minimum(near.index_select(0, tail), near.index_select(0, head)) == rank
        chosen.append(edge.masked_select(wins))
        taken = torch.full_like(best, last)
        taken[tail.masked_select(wins)] = 0
        taken[head.masked_select(wins)] = 0
        taken = _least_nearby(edges, taken)
        free = torch.minimum(taken.index_select(0, tail), taken.index_select(0, head)) > 0
        edge, rank = edge.masked_select(free), rank.masked_select(free)
    return torch.cat(chosen)


def _least_nearby(edges: Edges, values: Tensor) -> Tensor:
    """The least value at each vertex and its neighbours."""
    least = values.scatter_reduce(0, edges.tail, values.index_select(0, edges.head), "amin")
    return least.scatter_reduce_(0, edges.head, values.index_select(0, edges.tail), "amin")
