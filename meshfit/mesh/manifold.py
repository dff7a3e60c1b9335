"""Manifold tests, components, boundary loops, genus and Euler number of a surface."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int64
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from meshfit.errors import MeshError
from meshfit.mesh.topology import NONE, HalfEdges, Indices, Mask
from meshfit.units import count_text

_LONGEST_WALK = 256


def graph_components(rows: Indices, columns: Indices, size: int) -> tuple[int, Indices]:
    """Return the number of components of a graph, and (N,) that of each node; edges join `rows` to `columns`."""
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(size, size))
    count, label = connected_components(graph, directed=False)
    return int(count), np.asarray(label, dtype=np.int64)


def num_components(topology: HalfEdges) -> int:
    """Return the number of components connected by edges; vertices that no face uses do not count."""
    if topology.is_watertight:
        # Every way has a way back, so that strong components, which are found faster, are all there are.
        ways = topology.directed_edges
        graph = csr_array((np.ones(ways.nnz), ways.indices, ways.indptr), shape=ways.shape)
        count = int(connected_components(graph, connection="strong")[0])
    else:
        count, _ = graph_components(topology.edges[:, 0], topology.edges[:, 1], topology.num_verts)
    return count - int((np.bincount(topology.tail, minlength=topology.num_verts) == 0).sum())


def euler_number(topology: HalfEdges) -> int:
    """Return V - E + F over the vertices that faces use: 2 for a sphere, 0 for a torus, 1 for a disk."""
    return int((topology.valence > 0).sum()) - topology.num_edges + topology.num_faces


def describe_topology(topology: HalfEdges) -> str:
    """Describe a surface by its pieces: `1 piece, closed, genus 0`.

    Closed manifold pieces that can be oriented have a genus. Others are described by their boundary loops and their
    Euler number. Pieces of several kinds are counted by kind: `3 pieces: 2 closed, total genus 1; 1 open, ...`.
    """
    piece = _pieces(topology)
    total = int(piece.max(initial=-1)) + 1
    loops, euler = _boundary_loops(topology, piece, total), _euler_numbers(topology, piece, total)
    manifold, oriented = ~_nonmanifold_pieces(topology, piece, total), _orientable_pieces(topology, piece, total)
    kinds = {
        "closed": manifold & oriented & (loops == 0),
        "closed, not orientable": manifold & ~oriented & (loops == 0),
        "open": manifold & oriented & (loops > 0),
        "open, not orientable": manifold & ~oriented & (loops > 0),
        "not manifold": ~manifold,
    }
    parts = list[tuple[int, str]]()
    for kind, chosen in kinds.items():
        if count := int(chosen.sum()):
            border, number = int(loops[chosen].sum()), int(euler[chosen].sum())
            genus = f"{'genus' if count == 1 else 'total genus'} {count - number // 2}"
            words = [kind, count_text(border, "boundary loop") if border else ""]
            words.append(genus if kind == "closed" else f"Euler number {number}")
            parts.append((count, ", ".join(word for word in words if word)))
    pieces = count_text(total, "piece")
    if len(parts) == 1:
        return f"{pieces}, {parts[0][1]}"
    return f"{pieces}: {'; '.join(f'{count} {text}' for count, text in parts)}" if parts else "no faces"


class TopologyCounts(NamedTuple):
    """The numbers of pieces, of boundary loops and of handles of a surface; None for handles if it has one side."""

    pieces: int
    openings: int
    handles: int | None

    @classmethod
    def of(cls, topology: HalfEdges) -> "TopologyCounts":
        """Count them; the fans of a vertex that is not manifold count as separate."""
        piece = _pieces(topology)
        total = int(piece.max(initial=-1)) + 1
        openings = int(_boundary_loops(topology, piece, total).sum())
        sound = (
            not _nonmanifold_pieces(topology, piece, total).any() and _orientable_pieces(topology, piece, total).all()
        )
        return cls(total, openings, total - (euler_number(topology) + openings) // 2 if sound else None)


def _pieces(topology: HalfEdges) -> Indices:
    """Return (V,) the piece of each vertex, numbered from 0; `NONE` for vertices that no face uses."""
    _, label = graph_components(topology.edges[:, 0], topology.edges[:, 1], topology.num_verts)
    piece, used = np.full(topology.num_verts, NONE, dtype=np.int64), topology.valence > 0
    piece[used] = np.unique(label[used], return_inverse=True)[1]
    return piece


def _euler_numbers(topology: HalfEdges, piece: Indices, total: int) -> Indices:
    """Return (P,) the Euler number of each piece."""
    corner = np.arange(len(topology.tail))
    of_face = np.empty(topology.num_faces, dtype=np.int64)
    of_face[topology.face_of(corner)] = piece[topology.tail]
    counted = (piece[piece != NONE], piece[topology.edges[:, 0]], of_face)
    verts, edges, faces = (np.bincount(part, minlength=total) for part in counted)
    return np.asarray(verts - edges + faces)


def _boundary_loops(topology: HalfEdges, piece: Indices, total: int) -> Indices:
    """Return (P,) the number of boundary loops of each piece; loops that meet at a non-manifold vertex count each."""
    count, fan = vertex_fans(topology)
    border = np.flatnonzero(topology.boundary_edges[topology.edge_of])
    ends = fan[border], fan[topology.following(border)]
    _, loop = graph_components(*ends, count)
    _, first = np.unique(loop[ends[0]], return_index=True)
    return np.bincount(piece[topology.tail[border[first]]], minlength=total)


def _nonmanifold_pieces(topology: HalfEdges, piece: Indices, total: int) -> Mask:
    """Return (P,) which pieces have an edge with three faces or more, or a vertex of several fans."""
    bad = np.zeros(total, dtype=bool)
    bad[piece[topology.edges[nonmanifold_edges(topology), 0]]] = True
    bad[piece[nonmanifold_verts(topology)]] = True
    return bad


def _orientable_pieces(topology: HalfEdges, piece: Indices, total: int) -> Mask:
    """Return (P,) which pieces have faces that can be wound alike: whose two sides are not connected."""
    orientable = np.ones(total, dtype=bool)
    if not len(topology.misoriented_edges):
        return orientable
    here = np.flatnonzero(topology.twin > np.arange(len(topology.twin)))
    there, num_faces = topology.twin[here], topology.num_faces
    face, other = topology.face_of(here), topology.face_of(there)
    turned = num_faces * (topology.tail[here] == topology.tail[there])
    sides = np.concatenate([face, face + num_faces]), np.concatenate([other + turned, other + num_faces - turned])
    _, side = graph_components(*sides, 2 * num_faces)
    one_sided = (side[:num_faces] == side[num_faces:])[topology.face_of(np.arange(len(topology.tail)))]
    orientable[piece[topology.tail[one_sided]]] = False
    return orientable


def nonmanifold_edges(topology: HalfEdges) -> Indices:
    """Return the edges with three faces or more."""
    return np.flatnonzero(topology.faces_per_edge > 2)


def vertex_fans(topology: HalfEdges) -> tuple[int, Indices]:
    """Return the number of fans, and (C,) the fan of each corner: faces at one vertex, joined by edges at it."""
    # A half-edge represents the corner at its tail; the next one in the face, that at its head.
    here = np.flatnonzero(topology.twin > np.arange(len(topology.twin)))
    there = topology.twin[here]
    same_way = topology.tail[here] == topology.tail[there]
    after, after_there = topology.following(here), topology.following(there)
    of_tails, of_heads = np.where(same_way, there, after_there), np.where(same_way, after_there, there)
    return graph_components(np.concatenate([here, after]), np.concatenate([of_tails, of_heads]), len(topology.tail))


def nonmanifold_verts(topology: HalfEdges) -> Indices:
    """Return the vertices whose faces form more than one fan, such as the tip that two cones share."""
    if not len(topology.misoriented_edges):
        return _verts_not_walked_around(topology)
    count, fan = vertex_fans(topology)
    return _owners_of_several(fan, count, topology.tail, topology.num_verts)


def _owners_of_several(fan: Indices, count: int, tail: Indices, num_verts: int) -> Indices:
    """Return the vertices with more than one of the fans; the corners of `fan` are at the vertices `tail`."""
    owner = np.empty(count, dtype=np.int64)
    owner[fan] = tail
    return np.flatnonzero(np.bincount(owner, minlength=num_verts) > 1)


def _verts_not_walked_around(topology: HalfEdges) -> Indices:
    """Return the vertices of which a walk around them misses corners.

    Faster than `vertex_fans`, for consistent orientation; vertices of many faces take the fans of their own corners.
    """
    num_corners = np.bincount(topology.tail, minlength=topology.num_verts)
    start = np.full(topology.num_verts, NONE)
    start[topology.tail] = np.arange(len(topology.tail))
    first = np.flatnonzero(topology.twin == NONE)
    start[topology.tail[first]] = first
    verts = np.flatnonzero(num_corners)
    at, reached = start[verts], np.zeros(topology.num_verts, dtype=np.int64)
    for _ in range(_LONGEST_WALK):
        if not len(verts):
            break
        reached[verts] += 1
        at = topology.next_around_tail(at)
        inside = (at != NONE) & (at != start[verts])
        verts, at = verts[inside], at[inside]
    reached[verts] = num_corners[verts]
    return np.union1d(np.flatnonzero(reached < num_corners), _with_several_fans(topology, verts))


def _with_several_fans(topology: HalfEdges, verts: Indices) -> Indices:
    """Return which of some vertices have several fans of faces, for consistent orientation."""
    if not len(verts):
        return verts
    chosen = np.zeros(topology.num_verts, dtype=bool)
    chosen[verts] = True
    corners = np.flatnonzero(chosen[topology.tail])
    after = topology.next_around_tail(corners)
    joined = np.flatnonzero(after != NONE)
    count, fan = graph_components(joined, np.searchsorted(corners, after[joined]), len(corners))
    return _owners_of_several(fan, count, topology.tail[corners], topology.num_verts)


def duplicate_triangles(topology: HalfEdges) -> Int64[np.ndarray, "D 2"]:
    """Return (D, 2) pairs of triangles with the same three vertices, which share two edges or more."""
    inner = np.flatnonzero(topology.twin != NONE)
    after = topology.following(inner)
    both = topology.twin[after] != NONE
    first, second = (topology.twin[halfedge[both]] for halfedge in (inner, after))
    face, other = topology.face_of(inner[both]), topology.face_of(first)
    corners = np.bincount(topology.face_of(np.arange(len(topology.tail))), minlength=topology.num_faces)
    folded = (topology.face_of(second) == other) & (corners[face] == 3) & (corners[other] == 3)
    pairs = np.stack([face, other], axis=1)[folded & (face < other)]
    return np.unique(pairs, axis=0) if len(pairs) else pairs


def require_faces(topology: HalfEdges, purpose: str) -> None:
    """Refuse invalid faces.

    Raises:
        MeshError: a face has an index out of range, or the same vertex twice.
    """
    outside = np.zeros(topology.num_faces, dtype=bool)
    stray = np.flatnonzero((topology.tail < 0) | (topology.tail >= topology.num_verts))
    outside[topology.face_of(stray)] = True
    allowed = f"vertices are numbered 0 to {topology.num_verts - 1}"
    for bad, fault in ((outside, allowed), (topology.has_vert_twice, "it has a vertex twice")):
        if bad.any():
            face = int(np.flatnonzero(bad)[0])
            raise MeshError(f"{purpose} needs valid faces: face {face} is {topology.corners_of(face)}: {fault}")


def require_manifold(topology: HalfEdges, purpose: str) -> None:
    """Refuse a mesh that is not an oriented manifold, with or without boundary.

    Two faces may share several edges, so that an interior vertex has valence 2, unless both are triangles.

    Raises:
        MeshError: naming the first face, edge or vertex at fault.
    """
    require_faces(topology, purpose)
    for edges, fault in (
        (nonmanifold_edges(topology), "has {faces} faces; allowed: 1 or 2"),
        (topology.misoriented_edges, "has two faces of opposite orientation; make the face winding consistent"),
    ):
        if len(edges):
            a, b = topology.edges[edges[0]]
            reason = fault.format(faces=topology.faces_per_edge[edges[0]])
            count = count_text(len(edges), "such edge")
            raise MeshError(f"{purpose} needs a manifold mesh: edge ({a}, {b}) {reason} ({count})")
    pairs = duplicate_triangles(topology)
    if len(pairs):
        raise MeshError(
            f"{purpose} needs a manifold mesh: faces {pairs[0, 0]} and {pairs[0, 1]} are triangles with the same three "
            f"vertices; remove one of them ({count_text(len(pairs), 'such pair')})"
        )
    verts = nonmanifold_verts(topology)
    if len(verts):
        raise MeshError(
            f"{purpose} needs a manifold mesh: vertex {verts[0]} joins separate fans of faces "
            f"({count_text(len(verts), 'such vertex')})"
        )
