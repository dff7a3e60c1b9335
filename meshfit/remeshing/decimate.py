"""Decimation by quadrics: edges collapse where that changes the surface least, so that vertices stay where it bends."""

import math

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from meshfit.remeshing.collapse import (
    Collapses,
    apart,
    boundary_firmness,
    keeps_shape,
    keeps_topology,
    may_collapse,
    without_flips,
    without_low_valences,
)
from meshfit.remeshing.connectivity import contained
from meshfit.remeshing.self_intersections import intersecting_faces
from meshfit.remeshing.state import RemeshState
from meshfit.remeshing.triangle_geometry import corners_of, dot, length_of, unit

_PASSES = 120
# Share of the edges, the cheapest, that a pass chooses from, beyond those that have to go.
_CHEAPEST = 0.05
# Weight of squared distances from the old vertices, relative to those from the planes of the old faces. It places
# vertices evenly where the surface is flat.
_POINT = 1e-4
# Weight of squared distances from the planes through boundary edges.
_BOUNDARY = 1.0
_SINE = math.sin(math.radians(8))


@torch.no_grad()
def decimate(
    verts: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"], num_verts: int, *, without_crossings: bool = False
) -> tuple[Float[Tensor, "W 3"], Int64[Tensor, "G 3"]]:
    """Reduce a surface to a number of vertices, by collapses in the order of their quadric error.

    The quadric of a vertex sums the squared distances from the planes of the faces that were merged into it (Garland
    and Heckbert, Surface simplification using quadric error metrics, 1997). Edges become the point of least error. Each
    pass collapses the cheapest edges that have no cheaper ones nearby; topology, boundary, valences and angles are
    protected as in `collapse`, with angles down to 8 degrees. On the CPU the result is bit-identical every time.

    Args:
        verts: (V, 3) positions, float64 or float32.
        faces: (F, 3) int64, an oriented manifold, closed or with boundary.
        num_verts: number of vertices to reach; more are left where no further collapse is sound.
        without_crossings: refuse collapses after which faces would intersect others; this takes twice the time.

    Returns:
        Vertices and faces, without unused vertices.
    """
    surface = RemeshState(verts, faces, torch.ones_like(verts[:, 0])).compact()
    quadrics, left = _quadrics(surface), len(surface.verts) - num_verts
    refused = faces.new_empty(0)
    for _ in range(_PASSES):
        if left <= 0:
            break
        chosen, tried = _candidates(surface, quadrics, refused, left)
        if not len(tried):
            break
        moved = chosen.moved(surface.verts)
        sound = chosen.only(keeps_topology(surface, chosen) & keeps_shape(surface, chosen, moved, math.inf, _SINE))
        chosen = without_low_valences(surface.edges, sound).first(left)
        waiting = sound.edge[~contained(sound.edge, chosen.edge.sort().values)]
        keys, collapsed = surface.edges.keys, without_flips if not without_crossings else _without_crossings
        surface, chosen = collapsed(surface, chosen)
        kept = torch.cat([chosen.edge, waiting]).sort().values
        bad = keys.index_select(0, tried[~contained(tried, kept)])
        # Later collapses nearby may make a refused one sound, so that only those of the last pass are left out.
        refused = bad.sort().values if len(chosen.edge) else torch.cat([refused, bad]).sort().values
        quadrics[chosen.kept] += quadrics[chosen.gone]
        left -= len(chosen.edge)
    surface = surface.compact()
    return surface.verts, surface.faces


def _without_crossings(surface: RemeshState, chosen: Collapses) -> tuple[RemeshState, Collapses]:
    """Collapse edges, except where faces would flip or intersect others; return the collapses that were made."""
    while True:
        after, chosen = without_flips(surface, chosen)
        moved = torch.zeros_like(after.lengths, dtype=torch.bool)
        moved[chosen.kept] = True
        crossing = intersecting_faces(after.verts, after.faces, among=moved[after.faces].any(1))
        moved[:] = False
        moved[after.faces[crossing].view(-1)] = True
        fine = ~moved.index_select(0, chosen.kept)
        if bool(fine.all()):
            return after, chosen
        chosen = chosen.only(fine)


def _quadrics(surface: RemeshState) -> Float[Tensor, "V 10"]:
    """Return the quadric of each vertex, in float64: x · A x + 2 b · x + c, as the upper half of A, then b, then c."""
    verts, faces, edges = surface.verts.double(), surface.faces, surface.edges
    a, b, c = corners_of(verts, faces)
    across = torch.linalg.cross(b - a, c - a)
    area, normal = length_of(across), unit(across)
    per_face = _plane(normal, a) * area[:, None]
    total = per_face.new_zeros(len(verts), 10)
    share = area.new_zeros(len(verts))
    for k in range(3):
        total.index_add_(0, faces[:, k], per_face)
        share.index_add_(0, faces[:, k], area)
    total += _point(verts) * (_POINT * share)[:, None]
    side = edges.left.index_select(0, edges.outer)
    tail, head = edges.tail.index_select(0, edges.outer), edges.head.index_select(0, edges.outer)
    along = verts.index_select(0, head) - verts.index_select(0, tail)
    outward = unit(torch.linalg.cross(along, normal.index_select(0, side // 3)))
    per_edge = _plane(outward, verts.index_select(0, tail)) * (_BOUNDARY * dot(along, along))[:, None]
    return total.index_add_(0, tail, per_edge).index_add_(0, head, per_edge)


def _plane(normal: Tensor, at: Tensor) -> Tensor:
    """Return the quadrics of planes through points."""
    height = -dot(normal, at)[:, None]
    x, y, z = normal.T
    upper = torch.stack([x * x, x * y, x * z, y * y, y * z, z * z], 1)
    return torch.cat([upper, normal * height, height.square()], 1)


def _point(at: Tensor) -> Tensor:
    """Return the quadrics of squared distances from points."""
    upper = at.new_tensor([1, 0, 0, 1, 0, 1]).expand(len(at), 6)
    return torch.cat([upper, -at, dot(at, at)[:, None]], 1)


def _least(quadrics: Float[Tensor, "N 10"]) -> Float[Tensor, "N 3"]:
    """Return the point of least error of each quadric, by Cramer's rule for its symmetric matrix."""
    xx, xy, xz, yy, yz, zz, bx, by, bz = quadrics[:, :9].unbind(1)
    p, q, r = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    s, t, u = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = xx * p + xy * q + xz * r
    solved = torch.stack([p * bx + q * by + r * bz, q * bx + s * by + t * bz, r * bx + t * by + u * bz], 1)
    return -solved / determinant[:, None]


def _error(quadrics: Float[Tensor, "N 10"], at: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
    """Return the value of each quadric at a point."""
    xx, xy, xz, yy, yz, zz, bx, by, bz, c = quadrics.unbind(1)
    x, y, z = at.unbind(1)
    half = bx * x + by * y + bz * z + xy * x * y + xz * x * z + yz * y * z
    return xx * x * x + yy * y * y + zz * z * z + 2 * half + c


def _candidates(
    surface: RemeshState, quadrics: Tensor, refused: Int64[Tensor, " R"], left: int
) -> tuple[Collapses, Int64[Tensor, " T"]]:
    """Return cheap edges that may collapse, with no others nearby, cheapest first, and their numbers.

    Args:
        surface: the surface.
        quadrics: (V, 10) the quadric of each vertex.
        refused: sorted keys of edges to leave out.
        left: number of vertices that have to go.
    """
    edges, verts = surface.edges, surface.verts
    firmness = boundary_firmness(surface)
    edge = torch.arange(len(edges.keys), device=edges.keys.device)
    edge = edge[~contained(edges.keys, refused)]
    edge = edge[may_collapse(edges, edge, firmness)]
    tail, head = edges.tail.index_select(0, edge), edges.head.index_select(0, edge)
    summed = quadrics.index_select(0, tail) + quadrics.index_select(0, head)
    place = _placed(surface, firmness, tail, head, _least(summed))
    error = _error(summed, place)
    most = min(len(edge), left + int(_CHEAPEST * len(edge)))
    order = error.argsort(stable=True)[:most]
    rank = torch.empty_like(edge)
    rank[order] = torch.arange(len(order), device=edge.device)
    number = edges.keys.new_full((len(edges.keys),), -1)
    number[edge] = torch.arange(len(edge), device=edge.device)
    chosen = apart(edges, edge.index_select(0, order), rank.index_select(0, order))
    which = number.index_select(0, chosen)
    tail, head = tail.index_select(0, which), head.index_select(0, which)
    swap = firmness.index_select(0, head) > firmness.index_select(0, tail)
    kept, gone = torch.where(swap, head, tail), torch.where(swap, tail, head)
    place = place.index_select(0, which).to(verts)
    return Collapses(chosen, kept, gone, place, torch.ones_like(place[:, 0])), chosen


def _placed(surface: RemeshState, firmness: Tensor, tail: Tensor, head: Tensor, best: Tensor) -> Tensor:
    """Return the firmer end of edges on which the boundary limits the place, and the best point of others.

    The best point counts only near the edge; otherwise the middle does.
    """
    verts = surface.verts.double()
    start, end = verts.index_select(0, tail), verts.index_select(0, head)
    at_tail, at_head = firmness.index_select(0, tail), firmness.index_select(0, head)
    middle = (start + end) / 2
    near: Bool[Tensor, " N"] = length_of(best - middle) <= 2 * length_of(end - start)
    place = torch.where(near[:, None], best, middle)
    place = torch.where((at_tail > at_head)[:, None], start, place)
    return torch.where((at_head > at_tail)[:, None], end, place)
