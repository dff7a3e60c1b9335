"""Collapses: short edges become points, many at a time, wherever the surface stays a sound one."""

import torch
from torch import Tensor

from meshfit.remeshing.candidates import Collapses, choose
from meshfit.remeshing.connectivity import contained
from meshfit.remeshing.moving import NEEDLE, Moving
from meshfit.remeshing.shapes import corners_of, dot, length_of, turned_over, unit
from meshfit.remeshing.soundness import in_turn, linked, shapely

_PASSES = 24
# A pass that changes a smaller share of the verts is the last one; there is another round.
_WORTHWHILE = 0.003
# How far from its edge a vertex may be put, as a share of the length wanted.
_LIFT = 0.25


def collapse(surface: Moving, short: float, long: float, most: int | None = None) -> Moving:
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


def _without_flips(surface: Moving, chosen: Collapses) -> tuple[Moving, Collapses]:
    """The surface after some collapses, less those near faces that would flip by them, and the ones that are left."""
    while True:
        after, stays = _applied(surface, chosen)
        near = after.around_flipped(~surface.flipped[stays])
        fine = ~near.index_select(0, chosen.kept)
        if bool(fine.all()):
            return after, chosen
        chosen = chosen.only(fine)


def _applied(surface: Moving, chosen: Collapses) -> tuple[Moving, Tensor]:
    """The surface after some collapses, and which faces are left. The verts that are gone keep their numbers."""
    verts, faces, lengths = surface.verts.clone(), surface.faces, surface.lengths.clone()
    into = torch.arange(len(verts), device=faces.device)
    into[chosen.gone] = chosen.kept
    verts[chosen.kept], lengths[chosen.kept] = chosen.place, chosen.length
    a, b, c = (into.index_select(0, faces[:, k]) for k in range(3))
    stays = (a != b) & (b != c) & (c != a)
    faces = torch.stack([a, b, c], 1)[stays]
    on_sphere = None if surface.on_sphere is None else _drawn_together(surface.on_sphere, faces, chosen)
    return Moving(verts, faces, lengths, on_sphere=on_sphere), stays


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


def _lifted(surface: Moving, chosen: Collapses) -> tuple[Collapses, Tensor]:
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
