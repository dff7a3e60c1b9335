"""Manifold tests, components, boundary loops and genus of a surface."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from meshfit.errors import MeshError
from meshfit.mesh.topology import NONE, HalfEdges, Indices
from meshfit.units import count_text


def _components(rows: Indices, columns: Indices, size: int) -> tuple[int, Indices]:
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(size, size))
    count, label = connected_components(graph, directed=False)
    return int(count), np.asarray(label, dtype=np.int64)


def num_components(topology: HalfEdges) -> int:
    """Return the number of components connected by edges; vertices that no face uses do not count."""
    count, _ = _components(topology.edges[:, 0], topology.edges[:, 1], topology.num_verts)
    return count - int((topology.valence == 0).sum())


def euler_number(topology: HalfEdges) -> int:
    """Return V - E + F over the vertices that faces use: 2 for a sphere, 0 for a torus, 1 for a disk."""
    return int((topology.valence > 0).sum()) - topology.num_edges + topology.num_faces


def describe_topology(topology: HalfEdges) -> str:
    """Describe the pieces, boundary loops and genus of an oriented manifold: `1 piece, closed, genus 0`."""
    pieces = num_components(topology)
    outer = topology.edges[topology.faces_per_edge == 1]
    loops = _components(outer[:, 0], outer[:, 1], topology.num_verts)[0] - (topology.num_verts - len(np.unique(outer)))
    genus = (2 * pieces - loops - euler_number(topology)) / 2
    border = count_text(loops, "boundary loop") if loops else "closed"
    return f"{count_text(pieces, 'piece')}, {border}, genus {genus:g}"


def is_watertight(topology: HalfEdges) -> bool:
    """Return whether every edge has exactly two faces that run through it in opposite directions."""
    return (
        bool((topology.faces_per_edge == 2).all()) and not len(misoriented_edges(topology)) and topology.num_faces > 0
    )


def nonmanifold_edges(topology: HalfEdges) -> Indices:
    """Return the edges with three faces or more."""
    return np.flatnonzero(topology.faces_per_edge > 2)


def misoriented_edges(topology: HalfEdges) -> Indices:
    """Return the edges whose two faces run through them in the same direction."""
    inner = np.flatnonzero(topology.faces_per_edge == 2)
    halfedge = topology.edge_halfedge[inner]
    return np.asarray(inner[topology.tail[halfedge] == topology.tail[topology.twin[halfedge]]])


def nonmanifold_verts(topology: HalfEdges) -> Indices:
    """Return the vertices whose faces form more than one fan, such as the tip that two cones share."""
    crossing = np.flatnonzero(topology.twin != NONE)
    across = topology.twin[crossing]
    # A half-edge represents the corner at its tail. Across an edge, that corner meets the neighbour's head corner.
    same_way = topology.tail[crossing] == topology.tail[across]
    corner = np.where(same_way, across, topology.following(across))
    count, fan = _components(crossing, corner, len(topology.tail))
    owner = np.empty(count, dtype=np.int64)
    owner[fan] = topology.tail
    return np.flatnonzero(np.bincount(owner, minlength=topology.num_verts) > 1)


def folded_faces(topology: HalfEdges) -> Indices:
    """Return the faces that share two consecutive edges with one other face and fold at the vertex between them."""
    inner = np.flatnonzero(topology.twin != NONE)
    after = topology.following(inner)
    both = topology.twin[after] != NONE
    inner, after = inner[both], after[both]
    twice = topology.face_of(topology.twin[inner]) == topology.face_of(topology.twin[after])
    return np.unique(topology.face_of(inner[twice]))


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

    Raises:
        MeshError: naming the first face, edge or vertex at fault.
    """
    require_faces(topology, purpose)
    for edges, fault in (
        (nonmanifold_edges(topology), "has {faces} faces; allowed: 1 or 2"),
        (misoriented_edges(topology), "has two faces of opposite orientation; make the face winding consistent"),
    ):
        if len(edges):
            a, b = topology.edges[edges[0]]
            reason = fault.format(faces=topology.faces_per_edge[edges[0]])
            raise MeshError(f"{purpose} needs a manifold mesh: edge ({a}, {b}) {reason} ({len(edges)} such edges)")
    folded = folded_faces(topology)
    if len(folded):
        raise MeshError(
            f"{purpose} needs a manifold mesh: face {folded[0]} shares more than one edge with the same neighbour, "
            f"so that a vertex has valence 2 ({len(folded)} such faces)"
        )
    verts = nonmanifold_verts(topology)
    if len(verts):
        raise MeshError(
            f"{purpose} needs a manifold mesh: vertex {verts[0]} joins separate fans of faces "
            f"({len(verts)} such vertices)"
        )
