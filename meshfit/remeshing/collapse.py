"""Edge collapses: short edges become points, many at once, where the collapse tests allow it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from meshfit.remeshing.connectivity import Edges, contained
from meshfit.remeshing.state import NEEDLE, RemeshState
from meshfit.remeshing.triangle_geometry import corners_of, dot, length_of, normal_and_sine, turned_over, unit

_PASSES = 24
# A pass that collapses fewer edges per vertex is the last of its round.
_WORTHWHILE = 0.003
_LAYERS = 3
_LARGEST_VALENCE = 9
# The boundary bends at a vertex where it turns by more than 50 degrees.
_BEND = math.cos(math.radians(50))
# Largest distance of a vertex from its collapsed edge, relative to the target length.
_LIFT = 0.25
_TURN = math.cos(math.radians(60))
_SINE = math.sin(math.radians(15))
# Edges shorter than this, relative to their target length, may leave longer edges, by as much as they are shorter.
_VERY_SHORT = 0.5


def collapse(surface: RemeshState, short: float, long: float, most: int | None = None) -> RemeshState:
    """Collapse the edges that are shorter than `short` times their target length.

    An edge becomes its midpoint, lifted to keep the volume; an edge from the inside to the boundary becomes its
    boundary end; one at a sharp bend of the boundary becomes the bend. Each pass collapses the shortest edges that have
    no shorter ones nearby. An edge stays where

    - the topology would change;
    - a vertex would have fewer than 4 edges (3 on the boundary) or more than 9;
    - a face would flip, or turn by more than 60 degrees, unless it turns towards its neighbour, as on thin parts;
    - an angle would fall below 15 degrees and below the smallest there;
    - an edge would become longer than `long` times its target length.

    Args:
        surface: the surface.
        short: length, relative to the target length, below which edges are collapsed.
        long: longest edge that may result, relative to the target length.
        most: largest number of collapses.
    """
    refused = surface.faces.new_empty(0)
    for _ in range(_PASSES):
        tried = _candidates(surface, refused, short)
        if not len(tried.edge) or most == 0:
            break
        chosen, moved = _lifted(surface, tried)
        sound = chosen.only(keeps_topology(surface, chosen) & keeps_shape(surface, chosen, moved, long))
        chosen = without_low_valences(surface.edges, sound).first(most)
        waiting = sound.edge[~contained(sound.edge, chosen.edge.sort().values)]
        surface, chosen, keys = *without_flips(surface, chosen), surface.edges.keys
        kept = torch.cat([chosen.edge, waiting]).sort().values
        bad = keys.index_select(0, tried.edge[~contained(tried.edge, kept)])
        refused = torch.cat([refused, bad]).sort().values
        most = None if most is None else most - len(chosen.edge)
        if len(chosen.edge) < _WORTHWHILE * len(surface.verts):
            break
    return surface.compact()


@dataclass(frozen=True, eq=False)
class Collapses:
    """Edges to collapse, of which no two have vertices of the same face.

    Attributes:
        edge: (C,) edges, in order of precedence.
        kept, gone: (C,) the end that stays, and the other.
        place: (C, 3) new position.
        length: (C,) target length there.
    """

    edge: Int64[Tensor, " C"]
    kept: Int64[Tensor, " C"]
    gone: Int64[Tensor, " C"]
    place: Float[Tensor, "C 3"]
    length: Float[Tensor, " C"]

    def only(self, mask: Tensor) -> "Collapses":
        """Return some of them."""
        which = mask.nonzero()[:, 0]
        return self._mapped(lambda values: values.index_select(0, which))

    def first(self, most: int | None) -> "Collapses":
        """Return the first ones."""
        return self._mapped(lambda values: values[:most])

    def _mapped(self, select: Callable[[Tensor], Tensor]) -> "Collapses":
        return Collapses(*(select(values) for values in (self.edge, self.kept, self.gone, self.place, self.length)))

    def moved(self, verts: Tensor) -> Tensor:
        """Return positions with both ends of each edge at its new position."""
        verts = verts.clone()
        verts[self.kept], verts[self.gone] = self.place, self.place
        return verts

    def owners(self, faces: Tensor, num_verts: int) -> tuple[Tensor, Tensor]:
        """Return the collapse that has vertices of each face, -1 for none, and their number."""
        owner = torch.full((num_verts,), -1, device=faces.device)
        number = torch.arange(len(self.edge), device=faces.device)
        owner[self.kept], owner[self.gone] = number, number
        a, b, c = owner.index_select(0, faces.reshape(-1)).view(-1, 3).unbind(1)
        return torch.maximum(torch.maximum(a, b), c), (a >= 0).long() + (b >= 0) + (c >= 0)


def without_flips(surface: RemeshState, chosen: Collapses) -> tuple[RemeshState, Collapses]:
    """Collapse edges, except near faces that would flip; return the collapses that were made."""
    while True:
        after, stays = _applied(surface, chosen)
        near = after.around_flipped(~surface.flipped[stays])
        fine = ~near.index_select(0, chosen.kept)
        if bool(fine.all()):
            return after, chosen
        chosen = chosen.only(fine)


def _applied(surface: RemeshState, chosen: Collapses) -> tuple[RemeshState, Tensor]:
    """Return the surface after some collapses, without renumbering its vertices, and which faces remain."""
    verts, faces, lengths = surface.verts.clone(), surface.faces, surface.lengths.clone()
    into = torch.arange(len(verts), device=faces.device)
    into[chosen.gone] = chosen.kept
    verts[chosen.kept], lengths[chosen.kept] = chosen.place, chosen.length
    a, b, c = (into.index_select(0, faces[:, k]) for k in range(3))
    stays = (a != b) & (b != c) & (c != a)
    faces = torch.stack([a, b, c], 1)[stays]
    on_sphere = None if surface.on_sphere is None else _collapsed_on_sphere(surface.on_sphere, faces, chosen)
    return RemeshState(verts, faces, lengths, on_sphere=on_sphere), stays


def _collapsed_on_sphere(on_sphere: Tensor, faces: Tensor, chosen: Collapses) -> Tensor:
    """Collapse edges on the sphere to their middle, or to an end if that turns fewer faces over."""
    ends = on_sphere.index_select(0, chosen.kept), on_sphere.index_select(0, chosen.gone)
    best, fewest = on_sphere, torch.full_like(chosen.kept, len(faces))
    for place in (unit(ends[0] + ends[1]), *ends):
        moved = on_sphere.clone()
        moved[chosen.kept] = place
        over = turned_over(moved, faces, NEEDLE).nonzero()[:, 0]
        count = torch.bincount(faces[over].view(-1), minlength=len(on_sphere)).index_select(0, chosen.kept)
        better = count < fewest
        best = best.index_copy(0, chosen.kept[better], place[better])
        fewest = torch.minimum(fewest, count)
    return best


def _lifted(surface: RemeshState, chosen: Collapses) -> tuple[Collapses, Tensor]:
    """Lift new positions to keep the volume; return the collapses and the positions after them.

    Moving a vertex changes the volume by its height over the plane of the summed area vectors around it (compare
    Lindstrom and Turk, Fast and memory efficient polygonal simplification, 1998).
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
    chosen = replace(chosen, place=chosen.place + unit(across) * height[:, None])
    return chosen, chosen.moved(surface.verts)


def _candidates(surface: RemeshState, refused: Int64[Tensor, " R"], short: float) -> Collapses:
    """Return short edges that valences and the boundary allow to collapse, with no others nearby.

    Args:
        surface: the surface.
        refused: sorted keys of edges to leave out.
        short: length, relative to the target length, below which an edge is short.
    """
    edges, verts = surface.edges, surface.verts
    edge = (surface.ratio < short).nonzero()[:, 0]
    edge = edge[~contained(edges.keys.index_select(0, edge), refused)]
    firmness = boundary_firmness(surface)
    edge = edge[may_collapse(edges, edge, firmness)]
    ratio = surface.ratio.index_select(0, edge) / short
    edge = apart(edges, edge, ((ratio * 16).long().clamp(0, 16) << 52) | edges.scrambled.index_select(0, edge))
    tail, head = edges.tail.index_select(0, edge), edges.head.index_select(0, edge)
    at_tail, at_head = firmness.index_select(0, tail), firmness.index_select(0, head)
    kept, gone = torch.where(at_head > at_tail, head, tail), torch.where(at_head > at_tail, tail, head)
    share = (at_tail == at_head).to(verts.dtype)[:, None] / 2
    place = torch.lerp(verts.index_select(0, kept), verts.index_select(0, gone), share)
    return Collapses(edge, kept, gone, place, surface.target_lengths.index_select(0, edge))


def boundary_firmness(surface: RemeshState) -> Tensor:
    """Return 0 for inner vertices, 1 on the boundary, 2 where it bends."""
    edges, verts = surface.edges, surface.verts
    tail, head = edges.tail.index_select(0, edges.outer), edges.head.index_select(0, edges.outer)
    side = unit(verts.index_select(0, head) - verts.index_select(0, tail))
    ahead, behind = torch.zeros_like(verts), torch.zeros_like(verts)
    ahead[tail], behind[head] = side, side
    return edges.on_boundary.long() + (edges.on_boundary & (dot(ahead, behind) < _BEND))


def may_collapse(edges: Edges, edge: Tensor, firmness: Tensor) -> Tensor:
    """Return which edges may collapse without breaking the limits of valence or changing the boundary."""
    inner, least = edges.inner.index_select(0, edge), edges.least_valence
    tail, head = edges.tail.index_select(0, edge), edges.head.index_select(0, edge)
    merged = edges.valence.index_select(0, tail) + edges.valence.index_select(0, head) - 3 - inner.long()
    least_merged = torch.minimum(least.index_select(0, tail), least.index_select(0, head))
    fits = (merged <= _LARGEST_VALENCE) & (merged >= least_merged)
    for apex in (edges.left_apex.index_select(0, edge), edges.right_apex.index_select(0, edge)):
        fits &= edges.valence.index_select(0, apex) > least.index_select(0, apex)
    softer = torch.minimum(firmness.index_select(0, tail), firmness.index_select(0, head))
    return fits & (softer <= 1 - inner.long())


def apart(edges: Edges, edge: Int64[Tensor, " N"], rank: Int64[Tensor, " N"]) -> Int64[Tensor, " C"]:
    """Choose edges whose ends have no neighbours among the ends of others, lowest rank first, in order of precedence.

    Each layer takes the edges that precede all others left nearby (Luby, A simple parallel algorithm for the maximal
    independent set problem, 1986).
    """
    rank, order = rank.sort()
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
    """Return the least value at each vertex and its neighbours."""
    least = values.scatter_reduce(0, edges.tail, values.index_select(0, edges.head), "amin")
    return least.scatter_reduce_(0, edges.head, values.index_select(0, edges.tail), "amin")


def keeps_topology(surface: RemeshState, chosen: Collapses) -> Bool[Tensor, " C"]:
    """Return which edges have ends whose only common neighbours are the opposite vertices of the edge's faces.

    With the limits of valence, this is the link condition (Dey, Edelsbrunner, Guha and Nekhayev, Topology preserving
    edge contraction, 1999).
    """
    edges = surface.edges
    owner = torch.full((edges.num_verts,), -1, device=edges.keys.device)
    owner[chosen.gone] = torch.arange(len(chosen.edge), device=owner.device)
    common = torch.zeros_like(chosen.edge)
    for vert, neighbour in ((edges.tail, edges.head), (edges.head, edges.tail)):
        collapse = owner.index_select(0, vert)
        which = (collapse >= 0).nonzero()[:, 0]
        collapse = collapse.index_select(0, which)
        both = edges.have(chosen.kept.index_select(0, collapse), neighbour.index_select(0, which))
        common.index_add_(0, collapse, both.long())
    return common == 1 + edges.inner.index_select(0, chosen.edge).long()


def keeps_shape(
    surface: RemeshState, chosen: Collapses, moved: Tensor, long: float, sine: float = _SINE
) -> Bool[Tensor, " C"]:
    """Return which collapses turn no face too far, and leave no slivers or long edges.

    Args:
        surface: the surface before them.
        chosen: the collapses.
        moved: (V, 3) positions after them.
        long: longest edge allowed, relative to the target length.
        sine: sine below which angles may not fall, unless they were smaller before.
    """
    owner, shared = chosen.owners(surface.faces, len(moved))
    near = (shared > 0).nonzero()[:, 0]
    owner, rows = owner.index_select(0, near), surface.faces.index_select(0, near)
    stays = shared.index_select(0, near) == 1
    before, sine_before = normal_and_sine(*corners_of(surface.verts, rows))
    after, sine_after = normal_and_sine(*corners_of(moved, rows))
    least = torch.full_like(chosen.length, sine).scatter_reduce_(0, owner, sine_before, "amin")
    bad = sine_after < least.index_select(0, owner)
    if long < torch.inf:
        bad |= _too_long(surface, chosen, moved, rows, long)
    turned = (stays & (dot(before, after) < _TURN)).nonzero()[:, 0]
    beyond = _normals_beyond(surface, chosen, near.index_select(0, turned))
    cosine, cosine_before = (dot(normals.index_select(0, turned), beyond) for normals in (after, before))
    bad[turned] |= (cosine < _TURN) | (cosine < cosine_before)
    fine = torch.ones_like(chosen.edge, dtype=torch.bool)
    fine[owner.masked_select(bad & stays)] = False
    return fine


def _too_long(surface: RemeshState, chosen: Collapses, moved: Tensor, rows: Tensor, long: float) -> Tensor:
    """Return which of some faces get an edge that is too long."""
    targets = surface.lengths.clone()
    targets[chosen.kept], targets[chosen.gone] = chosen.length, chosen.length
    # Longest edge, relative to the target length, at vertices that move; 0 elsewhere.
    share = torch.zeros_like(targets)
    spare = (_VERY_SHORT - surface.ratio.index_select(0, chosen.edge)).clamp_min(0)
    share[chosen.kept], share[chosen.gone] = long + spare, long + spare
    bad = torch.zeros_like(rows[:, 0], dtype=torch.bool)
    for k in range(3):
        p, q = rows[:, k], rows[:, (k + 1) % 3]
        limit = torch.maximum(share.index_select(0, p), share.index_select(0, q))
        side = length_of(moved.index_select(0, p) - moved.index_select(0, q))
        bad |= (limit > 0) & (side > limit * (targets.index_select(0, p) + targets.index_select(0, q)) / 2)
    return bad


def _normals_beyond(surface: RemeshState, chosen: Collapses, which: Tensor) -> Tensor:
    """Return the normals of the neighbours opposite the one corner of each face that moves; 0 on the boundary."""
    edges = surface.edges
    moves = torch.zeros(edges.num_verts, dtype=torch.int32, device=which.device)
    moves[chosen.kept], moves[chosen.gone] = 1, 1
    corner = moves.index_select(0, surface.faces.index_select(0, which).reshape(-1)).view(-1, 3).argmax(1)
    side = edges.of_side.index_select(0, which).gather(1, ((corner + 1) % 3)[:, None])[:, 0]
    left, right = edges.left.index_select(0, side) // 3, edges.right.index_select(0, side)
    beyond = torch.where(left == which, right.clamp_min(0) // 3, left)
    return surface.normals.index_select(0, beyond).masked_fill((right < 0)[:, None], 0)


def without_low_valences(edges: Edges, chosen: Collapses) -> Collapses:
    """Leave out collapses that together take too many edges from a vertex; a later pass may make them."""
    apexes = [apex.index_select(0, chosen.edge) for apex in (edges.left_apex, edges.right_apex)]
    number = torch.arange(len(chosen.edge), device=chosen.edge.device)
    lost = sum((torch.bincount(apex, minlength=edges.num_verts) for apex in apexes), torch.zeros_like(edges.valence))
    free = edges.valence - lost >= edges.least_valence
    first = torch.full_like(lost, len(number))
    for apex in apexes:
        first.scatter_reduce_(0, apex, number, "amin")
    left, right = (free.index_select(0, apex) | (first.index_select(0, apex) == number) for apex in apexes)
    return chosen.only(left & right)
