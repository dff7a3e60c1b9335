"""Splits of polygons: the finer connectivity, and the edge or corner that each new vertex belongs to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from meshfit.mesh.topology import NONE, Indices, PolygonTopology
from meshfit.subdivision.polygons.scheme import PolygonSplit

Faces = tuple[Indices, Indices]


@dataclass(frozen=True, eq=False)
class PolygonDivision:
    """The finer connectivity of one level. New vertices follow the kept old ones; places are counted from there.

    Attributes:
        finer: the finer connectivity.
        kept: (K,) old vertices that remain, in their order.
        inner: (N,) half-edges of interior edges in which new vertices are inserted.
        inner_place: for each vertex inserted in one edge, counted from the half-edge's tail, (N,) its place.
        border: (B,) boundary half-edges in which new vertices are inserted.
        border_place: the same for these.
        corner_place: (C,) for each corner, the place of the new vertex inside its face; `NONE` for none.
        moves_border: whether old boundary vertices move in this step.
    """

    finer: PolygonTopology
    kept: Indices
    inner: Indices
    inner_place: tuple[Indices, ...]
    border: Indices
    border_place: tuple[Indices, ...]
    corner_place: Indices
    moves_border: bool = True

    @property
    def num_new(self) -> int:
        """The number of inserted vertices."""
        return self.finer.num_verts - len(self.kept)


def divide_polygons(topology: PolygonTopology, split: PolygonSplit, step: int) -> PolygonDivision:
    """Divide every face.

    Args:
        topology: an oriented manifold.
        split: the kind of split.
        step: number of levels already applied to the control mesh; √2 halves boundary edges at every second one.
    """
    if split is PolygonSplit.QUADS:
        return _quads(topology)
    if split is PolygonSplit.SQRT2:
        return _sqrt2(topology, halve=step % 2 == 1)
    return _ternary(topology) if split is PolygonSplit.TERNARY else _dual(topology)


def polygon_parents(topology: PolygonTopology, split: PolygonSplit, step: int) -> Indices:
    """Return the (F',) old face that each finer one comes from, in the order of `divide_polygons`.

    A face over an old edge comes from the first of the two faces at it; a face in place of an old vertex, from the face
    at which it begins.
    """
    halfedge = np.arange(len(topology.corners))
    if split is PolygonSplit.QUADS:
        return topology.face
    if split is PolygonSplit.TERNARY:
        return np.concatenate([topology.face, topology.face, np.arange(topology.num_faces)])
    over_edges = topology.face[topology.twin > halfedge]
    if split is PolygonSplit.SQRT2:
        halved = step % 2 == 1
        outer = topology.face[topology.twin == NONE]
        return np.concatenate([over_edges, outer[: 0 if halved else None]])
    corners, sizes = _dual_verts(topology)
    return np.concatenate([np.arange(topology.num_faces), over_edges, topology.face[corners[np.cumsum(sizes) - sizes]]])


def _quads(topology: PolygonTopology) -> PolygonDivision:
    """The quad of a corner is (its vertex, the one in the next edge, that of the face, the one in the edge before)."""
    num_verts, num_edges = topology.num_verts, topology.num_edges
    halfedge = np.arange(len(topology.corners))
    middle, centre = topology.edge_of, num_edges + topology.face
    rows = [topology.corners, num_verts + middle, num_verts + centre, num_verts + middle[topology.preceding(halfedge)]]
    inner, border = np.flatnonzero(~topology.boundary_edges), np.flatnonzero(topology.boundary_edges)
    return PolygonDivision(
        _joined(num_verts + num_edges + topology.num_faces, [_uniform(rows)]),
        kept=np.arange(num_verts),
        inner=topology.edge_halfedge[inner],
        inner_place=(inner,),
        border=topology.edge_halfedge[border],
        border_place=(border,),
        corner_place=centre,
    )


def _sqrt2(topology: PolygonTopology, *, halve: bool) -> PolygonDivision:
    """An edge (a, b) between faces with the new vertices s and t becomes the quad (a, t, b, s).

    At an edge on the boundary only one of them exists, and the triangle (a, b, s) is left. In the next step, that has
    its new vertex in the edge itself instead of inside, so that two steps halve the boundary.
    """
    border = np.flatnonzero(topology.twin == NONE)
    halved = border if halve else border[:0]
    whole = np.ones(topology.num_faces, dtype=bool)
    whole[topology.face[halved]] = False
    place = np.cumsum(whole) - 1
    place[topology.face[halved]] = int(whole.sum()) + np.arange(len(halved))
    centre = topology.num_verts + place[topology.face]
    left = np.flatnonzero(topology.twin > np.arange(len(topology.corners)))
    quads = [topology.tail[left], centre[topology.twin[left]], topology.head[left], centre[left]]
    over = border[:0] if halve else border
    triangles = [topology.tail[over], topology.head[over], centre[over]]
    num_new = int(whole.sum()) + len(halved)
    return PolygonDivision(
        _joined(topology.num_verts + num_new, [_uniform(quads), _uniform(triangles)]),
        kept=np.arange(topology.num_verts),
        inner=border[:0],
        inner_place=(),
        border=halved,
        border_place=(place[topology.face[halved]],),
        corner_place=np.where(whole, place, NONE)[topology.face],
        moves_border=halve,
    )


def _ternary(topology: PolygonTopology) -> PolygonDivision:
    """Quads at the corners, then those at the edges, then what is left of each face in its middle."""
    num_verts, halfedge = topology.num_verts, np.arange(len(topology.corners))
    first = topology.edge_halfedge[topology.edge_of] == halfedge
    near, far = 2 * topology.edge_of + ~first, 2 * topology.edge_of + first
    inside = 2 * topology.num_edges + halfedge
    before, after = topology.preceding(halfedge), topology.following(halfedge)
    at_corners = [topology.corners, num_verts + near, num_verts + inside, num_verts + far[before]]
    at_edges = [num_verts + part for part in (near, far, inside[after], inside)]
    middle = (num_verts + inside, topology.sizes)
    inner, border = np.flatnonzero(~topology.boundary_edges), np.flatnonzero(topology.boundary_edges)
    num_fine = num_verts + 2 * topology.num_edges + len(halfedge)
    return PolygonDivision(
        _joined(num_fine, [_uniform(at_corners), _uniform(at_edges), middle]),
        kept=np.arange(num_verts),
        inner=topology.edge_halfedge[inner],
        inner_place=(2 * inner, 2 * inner + 1),
        border=topology.edge_halfedge[border],
        border_place=(2 * border, 2 * border + 1),
        corner_place=inside,
    )


def _dual(topology: PolygonTopology) -> PolygonDivision:
    """One face for each face, interior edge, and vertex of three faces or more.

    At an interior vertex of two faces, the faces of its two edges meet in the edge between its two new vertices.
    Corners at boundary edges have their new vertices on these edges, so that the sides of the faces make the boundary.
    """
    halfedge = np.arange(len(topology.corners))
    loose = np.flatnonzero(topology.valence == 0)
    left = np.flatnonzero(topology.twin > halfedge)
    right = topology.twin[left]
    edges = _uniform([topology.following(left), left, topology.following(right), right])
    parts = [(halfedge, topology.sizes), edges, _dual_verts(topology)]
    return PolygonDivision(
        _joined(len(loose) + len(halfedge), [(len(loose) + corners, sizes) for corners, sizes in parts]),
        kept=loose,
        inner=halfedge[:0],
        inner_place=(),
        border=halfedge[:0],
        border_place=(),
        corner_place=halfedge,
    )


def _dual_verts(topology: PolygonTopology) -> Faces:
    out = np.full(topology.num_verts, NONE, dtype=np.int64)
    halfedge = np.arange(len(topology.corners))
    out[topology.tail[::-1]] = halfedge[::-1]
    border = np.flatnonzero(topology.twin == NONE)
    out[topology.tail[border]] = border
    count = np.bincount(topology.tail, minlength=topology.num_verts)
    verts = np.flatnonzero(count >= 3)
    sizes, at = count[verts], out[verts]
    corners = np.empty(int(sizes.sum()), dtype=np.int64)
    starts = np.cumsum(sizes) - sizes
    for turn in range(int(sizes.max(initial=0))):
        going = turn < sizes
        corners[(starts + turn)[going]] = at[going]
        at = np.where(turn + 1 < sizes, topology.next_around_tail(at), at)
    return corners, sizes


def _uniform(columns: Sequence[Indices]) -> Faces:
    rows: Int64[np.ndarray, "N K"] = np.stack(columns, axis=1)
    return rows.reshape(-1), np.full(len(rows), rows.shape[1])


def _joined(num_verts: int, parts: Sequence[Faces]) -> PolygonTopology:
    corners, sizes = (np.concatenate(part) for part in zip(*parts, strict=True))
    return PolygonTopology(num_verts, corners, sizes)
