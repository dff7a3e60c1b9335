"""Weld coincident boundary edges, and split vertices and edges at which a surface is not manifold.

The surface is cut along all its edges and glued again along pairs of half-edges, after Guéziec, Taubin, Lazarus and
Horn 2001, Cutting and stitching: converting sets of polygons to manifold surfaces. Corners of faces that meet across a
glued edge are one vertex. So a weld makes no vertex at which two surfaces merely touch, and no edge of three faces.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from meshfit.mesh.manifold import duplicate_triangles, graph_components, nonmanifold_verts
from meshfit.mesh.mesh import Verts
from meshfit.mesh.topology import HalfEdges, Indices, Mask, PolygonTopology, stable_order

_HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)
# The faces at an edge of more than these all stay apart.
_MOST_FACES_PER_EDGE = 64
# Two faces at a smaller angle, in radians, lie on each other.
_FOLDED = 1e-4
# Half-edges that are compared at a time.
_BLOCK = 1 << 20

_Pairs = Int64[np.ndarray, "_ 2"]


class Stitched(NamedTuple):
    """The vertices of a surface after welding and splitting.

    Attributes:
        corners: (C,) the new vertex of each corner.
        origins: (V,) the first given vertex of each new one, ascending.
        num_split: number of given vertices that were split.
        is_manifold: whether the surface is manifold now for certain.
    """

    corners: Indices
    origins: Indices
    num_split: int = 0
    is_manifold: bool = False


def first_equal(rows: NDArray[Any]) -> Indices:
    """Return (N,) the first row equal to each row; 0.0 equals -0.0."""
    # Sorting by a hash is several times as fast as by columns.
    numbers = (rows + 0.0 if rows.dtype == np.float64 else rows.astype(np.int64)).view(np.uint64)
    hashes = np.zeros(len(rows), dtype=np.uint64)
    for column in numbers.T:
        hashes = (hashes ^ column) * _HASH_FACTOR
        hashes ^= hashes >> np.uint64(29)
    order = stable_order(hashes, 64)
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = _differ_from_previous(rows, order)
    by_hash = hashes[order]
    if (starts[1:] & (by_hash[1:] == by_hash[:-1])).any():  # different rows with one hash may alternate
        order = np.lexsort(rows.T)
        starts[1:] = _differ_from_previous(rows, order)
    first = np.empty(len(rows), dtype=np.int64)
    first[order] = order[np.flatnonzero(starts)][np.cumsum(starts) - 1]
    return first


def _differ_from_previous(rows: NDArray[Any], order: Indices) -> Mask:
    """Return (N - 1,) whether each row but the first differs from the one before it in an order."""
    differ = np.zeros(max(len(order) - 1, 0), dtype=bool)
    for column in rows.T:  # in turn, as there may be many millions
        ordered = column[order]
        differ |= ordered[1:] != ordered[:-1]
    return differ


def coincident(topology: HalfEdges, verts: Verts, distance: float = 0.0) -> Indices:
    """Return (V,) the first vertex at the place of each one, for boundary vertices and ends of edges without length.

    Args:
        topology: connectivity of the V vertices.
        verts: their positions.
        distance: up to which boundary vertices share a place, directly or through others.
    """
    seam = np.flatnonzero(topology.boundary_verts)
    place = np.arange(topology.num_verts)
    if distance > 0 and len(seam):
        near = cKDTree(verts[seam]).query_pairs(distance, output_type="ndarray")
        place[seam] = seam[_first_of_component(near[:, 0], near[:, 1], len(seam))]
    else:
        place[seam] = seam[first_equal(verts[seam])]
    tail, head = topology.tail, topology.head
    short = _flat_along_x(tail, head, verts)
    for coordinate in verts.T[1:].copy():
        short = short[coordinate[tail[short]] == coordinate[head[short]]]
    short = short[place[tail[short]] != place[head[short]]]
    if len(short):
        place = place[_first_of_component(place[tail[short]], place[head[short]], topology.num_verts)][place]
    return place


def _flat_along_x(tail: Indices, head: Indices, verts: Verts) -> Indices:
    """Return the half-edges whose ends have the same x, found in blocks, as they may be many millions."""
    x = verts[:, 0].copy()
    blocks = (slice(start, start + _BLOCK) for start in range(0, len(tail), _BLOCK))
    flat = [block.start + np.flatnonzero(x[tail[block]] == x[head[block]]) for block in blocks]
    return np.concatenate([np.empty(0, dtype=np.int64), *flat])


def nearly_coincident(topology: HalfEdges, verts: Verts) -> tuple[int, float]:
    """Return how many boundary vertices are nearly at the place of another one, and the largest such distance.

    Nearly means within 1e-4 of the bounding box's diagonal, and within a tenth of the shortest edge at the vertex.
    """
    seam = np.flatnonzero(topology.boundary_verts)
    seam = seam[first_equal(verts[seam]) == np.arange(len(seam))]
    if len(seam) < 2:
        return 0, 0.0
    ends = topology.edges
    lengths = np.linalg.norm(verts[ends[:, 0]] - verts[ends[:, 1]], axis=1)
    shortest = np.full(topology.num_verts, np.inf)
    for side in (0, 1):
        np.minimum.at(shortest, ends[:, side], lengths)
    reach = 1e-4 * float(np.linalg.norm(np.ptp(verts, axis=0)))
    distance = np.asarray(cKDTree(verts[seam]).query(verts[seam], k=2, distance_upper_bound=reach)[0])[:, 1]
    near = distance[distance < 0.1 * shortest[seam]]
    return len(near), float(near.max(initial=0.0))


def stitch(verts: Verts, given: PolygonTopology, welded: PolygonTopology, *, split: bool) -> Stitched:
    """Weld boundary edges whose ends coincide, and split non-manifold vertices and edges.

    Args:
        verts: (N, 3) positions.
        given: connectivity of the faces by given vertices.
        welded: connectivity of the same faces by places, from `coincident`.
        split: separate the fans of faces that meet in a given vertex, and the faces beyond the second at a given edge.
    """
    corners, sizes = given.corners, given.sizes
    on_each_other = (sizes[welded.lone_faces] == 3).any()
    if (welded.faces_per_edge <= 2).all() and not on_each_other and not len(nonmanifold_verts(welded)):
        used = np.zeros(len(verts), dtype=bool)
        used[welded.corners] = True
        return Stitched((np.cumsum(used) - 1)[welded.corners], np.flatnonzero(used), is_manifold=True)
    count = given.faces_per_edge[given.edge_of]
    kept = _pairs_within(np.flatnonzero(count == 2), given.edge_of)
    crowded = _matched(welded, verts, np.flatnonzero(count > 2), given.edge_of) if split else kept[:0]
    seams = _matched(welded, verts, np.flatnonzero(count == 1), welded.edge_of)
    pairs = np.concatenate([seams, crowded, kept])
    removable = np.arange(len(pairs)) < (len(pairs) if split else len(seams))
    tied = None if split else corners
    stitched = _glued(welded, corners, pairs, tied)
    allowed = np.zeros(len(corners), dtype=bool) if split else count > 2
    for attempt in range(6):
        conflict = _conflicts(stitched, sizes) & ~allowed
        if not conflict.any():
            break
        if attempt == 0:
            drop = _folded(welded, verts, pairs) & (np.arange(len(pairs)) < len(seams))
        elif attempt == 1:
            drop = conflict[pairs].any(axis=1)
        elif attempt < 4:
            at = np.zeros(len(stitched.origins), dtype=bool)
            at[stitched.corners[conflict]] = True
            drop = at[stitched.corners[pairs]].any(axis=1)
        else:  # all of a piece, as a weld is to make nothing worse
            piece = graph_components(welded.tail, welded.head, welded.num_verts)[1][welded.tail]
            drop = np.isin(piece[pairs[:, 0]], piece[conflict])
        drop &= removable
        pairs, removable, seams = pairs[~drop], removable[~drop], seams[~drop[: len(seams)]]
        stitched = _glued(welded, corners, pairs, tied)
    return stitched._replace(num_split=_num_split(corners, stitched.corners) if split else 0)


def _numbered(labels: Indices, corners: Indices) -> Stitched:
    """Number the vertices that corners with equal labels are, in the order of the given vertices."""
    _, first, label = np.unique(labels, return_index=True, return_inverse=True)
    origin = np.full(len(first), np.iinfo(np.int64).max)
    np.minimum.at(origin, label, corners)
    order = np.lexsort([first, origin])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return Stitched(rank[label], origin[order])


def _pairs_within(halfedges: Indices, group: Indices) -> _Pairs:
    """Return the half-edges of groups of two, by group."""
    return halfedges[np.argsort(group[halfedges], kind="stable")].reshape(-1, 2)


def _matched(topology: PolygonTopology, verts: Verts, halfedges: Indices, group: Indices) -> _Pairs:
    """Return the pairs of half-edges to glue, each within one group of equal edges.

    Two are a pair. Of more, those are paired that run in opposite directions and enclose the least solid angle on the
    inner side, as the faces of bodies that touch at an edge do; where there are more of one direction, those that meet
    most smoothly.
    """
    _, label, size = np.unique(group[halfedges], return_inverse=True, return_counts=True)
    pairs = [_pairs_within(halfedges[size[label] == 2], group)]
    crowded = (size[label] > 2) & (size[label] <= _MOST_FACES_PER_EDGE)
    members, label = halfedges[crowded], label[crowded]
    forward = topology.tail[members] < topology.head[members]
    first, second = _products(label, forward)
    if len(first):
        ahead, behind = members[first], members[second]
        wedge = _wedges(topology, verts, ahead, behind)
        balance = np.zeros(len(size), dtype=np.int64)
        np.add.at(balance, label, np.where(forward, 1, -1))
        cost = np.where(balance[label[first]] == 0, wedge, np.abs(wedge - np.pi))
        cost[~np.isfinite(cost) | (np.minimum(wedge, 2 * np.pi - wedge) < _FOLDED)] = 2 * np.pi
        pairs.append(_cheapest(ahead, behind, cost, len(topology.tail)))
    return np.concatenate(pairs)


def _products(label: Indices, forward: Mask) -> tuple[Indices, Indices]:
    """Return all combinations of a forward and a backward member with the same label."""
    ahead, behind = np.flatnonzero(forward), np.flatnonzero(~forward)
    behind = behind[np.argsort(label[behind], kind="stable")]
    starts = np.searchsorted(label[behind], label[ahead], side="left")
    counts = np.searchsorted(label[behind], label[ahead], side="right") - starts
    first = np.repeat(ahead, counts)
    step = np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    return first, behind[np.repeat(starts, counts) + step]


def _wedges(topology: PolygonTopology, verts: Verts, ahead: Indices, behind: Indices) -> Float64[np.ndarray, " P"]:
    """Return the inner angles from the face behind to the face ahead about their edge; NaN without area."""
    along = verts[topology.head[ahead]] - verts[topology.tail[ahead]]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    # Directions within each face, perpendicular to the edge.
    start = np.cross(_normals(topology, verts, behind), -along)
    end = np.cross(_normals(topology, verts, ahead), along)
    sine = np.einsum("nk,nk->n", np.cross(start, end), along)
    angle = np.arctan2(sine, (start * end).sum(axis=1)) % (2 * np.pi)
    return np.where(start.any(axis=1) & end.any(axis=1), angle, np.nan)


def _normals(topology: PolygonTopology, verts: Verts, halfedges: Indices) -> Float64[np.ndarray, "P 3"]:
    """Return the area vectors of the faces of half-edges, each divided by its largest coordinate; 0 without area."""
    faces, row = np.unique(topology.face_of(halfedges), return_inverse=True)
    sizes = topology.sizes[faces]
    starts = np.cumsum(sizes) - sizes
    places = np.repeat(topology.starts[faces] - starts, sizes) + np.arange(int(sizes.sum()))
    origin = np.repeat(verts[topology.tail[topology.starts[faces]]], sizes, axis=0)
    at, after = verts[topology.tail[places]] - origin, verts[topology.head[places]] - origin
    area = np.add.reduceat(np.cross(at, after), starts) if len(faces) else np.empty((0, 3))
    scale = np.abs(area).max(axis=1, keepdims=True)
    return np.asarray(np.divide(area, scale, out=np.zeros_like(area), where=scale > 0)[row])


def _cheapest(ahead: Indices, behind: Indices, cost: Float64[np.ndarray, " P"], count: int) -> _Pairs:
    """Choose disjoint pairs, the cheapest first."""
    order = np.argsort(cost, kind="stable")
    taken = np.zeros(count, dtype=bool)
    chosen = [np.empty((0, 2), dtype=np.int64)]
    while len(order):
        candidates = np.stack([ahead[order], behind[order]], axis=1)
        best = np.full(count, len(order))
        for side in (0, 1):
            np.minimum.at(best, candidates[:, side], np.arange(len(order)))
        mutual = (best[candidates] == np.arange(len(order))[:, None]).all(axis=1)
        chosen.append(candidates[mutual])
        taken[candidates[mutual].reshape(-1)] = True
        order = order[~taken[candidates].any(axis=1)]
    return np.concatenate(chosen)


def _glued(topology: PolygonTopology, corners: Indices, pairs: _Pairs, tied: Indices | None) -> Stitched:
    """Return the vertices that remain when the surface is cut along all edges and glued along these pairs.

    Args:
        topology: connectivity by places.
        corners: the given vertex of each corner.
        pairs: of half-edges.
        tied: numbers of which equal ones also make corners one vertex.
    """
    one, other = pairs[:, 0], pairs[:, 1]
    opposite = topology.tail[one] != topology.tail[other]
    start, end = topology.following(one), topology.following(other)
    rows = [one, start]
    columns = [np.where(opposite, end, other), np.where(opposite, other, end)]
    if tied is not None:
        _, first, label = np.unique(tied, return_index=True, return_inverse=True)
        rows.append(np.arange(len(tied)))
        columns.append(first[label])
    return _numbered(graph_components(np.concatenate(rows), np.concatenate(columns), len(corners))[1], corners)


def _conflicts(stitched: Stitched, sizes: Indices) -> Mask:
    """Return which half-edges lie at edges of three faces or more, or in triangles that lie on one another."""
    topology = PolygonTopology(len(stitched.origins), stitched.corners, sizes)
    conflict = topology.faces_per_edge[topology.edge_of] > 2
    folded = np.zeros(len(sizes), dtype=bool)
    folded[duplicate_triangles(topology)] = True
    return np.asarray(conflict | np.repeat(folded, sizes))


def _folded(topology: PolygonTopology, verts: Verts, pairs: _Pairs) -> Mask:
    """Return which pairs are of faces that lie on each other."""
    wedge = _wedges(topology, verts, pairs[:, 0], pairs[:, 1])
    return np.asarray(np.minimum(wedge, 2 * np.pi - wedge) < _FOLDED)


def _num_split(given: Indices, corners: Indices) -> int:
    """Return how many given vertices have become several."""
    first = np.empty(int(given.max(initial=-1)) + 1, dtype=np.int64)
    first[given] = corners
    return len(np.unique(given[corners != first[given]]))


def _first_of_component(rows: Indices, columns: Indices, size: int) -> Indices:
    """Return (N,) the first node of each node's component."""
    count, label = graph_components(rows, columns, size)
    first = np.full(count, size)
    np.minimum.at(first, label, np.arange(size))
    return np.asarray(first[label])
