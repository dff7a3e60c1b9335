"""Which short edges are to be collapsed at once: the best of each neighbourhood."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from meshfit.remeshing.connectivity import Edges, contained
from meshfit.remeshing.state import NEEDLE, RemeshState
from meshfit.remeshing.triangle_geometry import corners_of, dot, length_of, normal_and_sine, turned_over, unit

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


def choose(surface: RemeshState, refused: Int64[Tensor, " R"], short: float) -> Collapses:
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


def _firmness(surface: RemeshState) -> Tensor:
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


_TURN = math.cos(math.radians(60))
_SINE = math.sin(math.radians(15))
# Edges shorter than this share of what is wanted may leave longer ones behind, by as much as they are shorter.
_VERY_SHORT = 0.5


def linked(surface: RemeshState, chosen: Collapses) -> Bool[Tensor, " C"]:
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


def shapely(surface: RemeshState, chosen: Collapses, moved: Tensor, long: float) -> Bool[Tensor, " C"]:
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


def _too_long(surface: RemeshState, chosen: Collapses, moved: Tensor, rows: Tensor, long: float) -> Tensor:
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


def _normals_beyond(surface: RemeshState, chosen: Collapses, which: Tensor) -> Tensor:
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


_PASSES = 24
# A pass that changes a smaller share of the verts is the last one; there is another round.
_WORTHWHILE = 0.003
# How far from its edge a vertex may be put, as a share of the length wanted.
_LIFT = 0.25


def collapse(surface: RemeshState, short: float, long: float, most: int | None = None) -> RemeshState:
    """Draw together the edges that are shorter than `short` times the length wanted.

    An edge becomes its midpoint, lifted so that the volume below the faces stays. An edge between the inside and the
    boundary becomes its end on the boundary, and one at a sharp bend of the boundary becomes the bend. In each pass,
    the shortest edges go ahead that have no others near them. An edge is left alone where the topology would change,
    where a vertex would keep fewer than 4 edges (3 on the boundary) or get more than 9, where a face would turn by
    more than 60 degrees (but for one that turns towards its neighbour, as at a rim that is thinner than the mesh is
    fine) or flip, where an angle would fall below 15 degrees and below the smallest there, and where an edge would
    become longer than `long` times the length wanted.

    Args:
        surface: what to coarsen.
        short: below which share of the length wanted an edge is short.
        long: the longest edge that may come of it, as a share of the length wanted.
        most: how many edges to collapse at most.
    """
    refused = surface.faces.new_empty(0)
    for _ in range(_PASSES):
        tried = choose(surface, refused, short)
        if not len(tried.edge) or most == 0:
            break
        chosen, moved = _lifted(surface, tried)
        sound = chosen.only(linked(surface, chosen) & shapely(surface, chosen, moved, long))
        chosen = in_turn(surface.edges, sound).first(most)
        waiting = sound.edge[~contained(sound.edge, chosen.edge.sort().values)]
        surface, chosen, keys = *_without_flips(surface, chosen), surface.edges.keys
        kept = torch.cat([chosen.edge, waiting]).sort().values
        bad = keys.index_select(0, tried.edge[~contained(tried.edge, kept)])
        refused = torch.cat([refused, bad]).sort().values
        most = None if most is None else most - len(chosen.edge)
        if len(chosen.edge) < _WORTHWHILE * len(surface.verts):
            break
    return surface.compact()


def _without_flips(surface: RemeshState, chosen: Collapses) -> tuple[RemeshState, Collapses]:
    """The surface after some collapses, less those near faces that would flip by them, and the ones that are left."""
    while True:
        after, stays = _applied(surface, chosen)
        near = after.around_flipped(~surface.flipped[stays])
        fine = ~near.index_select(0, chosen.kept)
        if bool(fine.all()):
            return after, chosen
        chosen = chosen.only(fine)


def _applied(surface: RemeshState, chosen: Collapses) -> tuple[RemeshState, Tensor]:
    """The surface after some collapses, and which faces are left. The verts that are gone keep their numbers."""
    verts, faces, lengths = surface.verts.clone(), surface.faces, surface.lengths.clone()
    into = torch.arange(len(verts), device=faces.device)
    into[chosen.gone] = chosen.kept
    verts[chosen.kept], lengths[chosen.kept] = chosen.place, chosen.length
    a, b, c = (into.index_select(0, faces[:, k]) for k in range(3))
    stays = (a != b) & (b != c) & (c != a)
    faces = torch.stack([a, b, c], 1)[stays]
    on_sphere = None if surface.on_sphere is None else _drawn_together(surface.on_sphere, faces, chosen)
    return RemeshState(verts, faces, lengths, on_sphere=on_sphere), stays


def _drawn_together(on_sphere: Tensor, faces: Tensor, chosen: Collapses) -> Tensor:
    """Where verts are on the sphere after collapses: at the middle, or at an end if that turns over fewer faces."""
    ends = on_sphere.index_select(0, chosen.kept), on_sphere.index_select(0, chosen.gone)
    best, fewest = on_sphere, torch.full_like(chosen.kept, len(faces))
    for place in (unit(ends[0] + ends[1]), *ends):
        tried = on_sphere.clone()
        tried[chosen.kept] = place
        over = turned_over(tried, faces, NEEDLE).nonzero()[:, 0]
        count = torch.bincount(faces[over].view(-1), minlength=len(on_sphere)).index_select(0, chosen.kept)
        better = count < fewest
        best = best.index_copy(0, chosen.kept[better], place[better])
        fewest = torch.minimum(fewest, count)
    return best


def _lifted(surface: RemeshState, chosen: Collapses) -> tuple[Collapses, Tensor]:
    """The collapses with places that keep the volume, and the verts, both ends of each edge moved there.

    Moving a vertex changes the volume by its height over the sum of the area vectors around it (compare Lindstrom and
    Turk, Fast and memory efficient polygonal simplification, 1998).
    """
    owner, shared = chosen.owners(surface.faces, len(surface.verts))
    near = (shared > 0).nonzero()[:, 0]
    owner, stays = owner.index_select(0, near), shared.index_select(0, near) == 1
    rows, place = surface.faces.index_select(0, near), chosen.place.index_select(0, owner)
    a, b, c = (corner - place for corner in corners_of(surface.verts, rows))
    volume = torch.zeros_like(chosen.length).index_add_(0, owner, dot(torch.linalg.cross(a, b), c))
    moved = chosen.moved(surface.verts)
    a, b, c = (corner - place for corner in corners_of(moved, rows))
    across = torch.linalg.cross(b - a, c - a) * stays[:, None]
    across = torch.zeros_like(chosen.place).index_add_(0, owner, across)
    most = _LIFT * chosen.length
    height = volume / length_of(across).clamp_min(torch.finfo(place.dtype).tiny)
    height = torch.maximum(torch.minimum(height, most), -most)
    height = height.masked_fill(surface.edges.on_boundary.index_select(0, chosen.kept), 0)
    chosen = chosen.at(chosen.place + unit(across) * height[:, None])
    return chosen, chosen.moved(surface.verts)
