"""What follows from half-edges alone, whatever the sizes of faces: edges, twins, boundary and one-rings.

A half-edge runs along one face from one of its corners to the next. `NONE` stands for what does not exist.
"""

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Int64

NONE = -1
Indices = Int64[np.ndarray, "_"]
Mask = Bool[np.ndarray, "_"]


@dataclass(frozen=True, eq=False)
class HalfEdges:
    """The connectivity of a surface, as its C half-edges tell it.

    Attributes:
        num_verts: V; verts that no face uses are allowed.
    """

    num_verts: int

    @property
    @abstractmethod
    def num_faces(self) -> int:
        """F, the number of faces."""

    @property
    @abstractmethod
    def tail(self) -> Indices:
        """(C,) vertex at which each half-edge starts."""

    @property
    @abstractmethod
    def head(self) -> Indices:
        """(C,) vertex at which each half-edge ends."""

    @abstractmethod
    def following(self, halfedge: Indices) -> Indices:
        """The half-edge that follows in the same face."""

    @abstractmethod
    def preceding(self, halfedge: Indices) -> Indices:
        """The half-edge that precedes in the same face."""

    @abstractmethod
    def face_of(self, halfedge: Indices) -> Indices:
        """The face that each half-edge belongs to."""

    @property
    @abstractmethod
    def has_vert_twice(self) -> Mask:
        """(F,) which faces come by the same vertex twice."""

    @abstractmethod
    def corners_of(self, face: int) -> list[int]:
        """The verts of one face, in its order."""

    @cached_property
    def _edge_keys(self) -> tuple[Indices, Indices, Indices]:
        keys = np.minimum(self.tail, self.head) * self.num_verts + np.maximum(self.tail, self.head)
        order = np.argsort(keys, kind="stable")
        ordered = keys[order]
        first = np.ones(len(keys), dtype=bool)
        first[1:] = ordered[1:] != ordered[:-1]
        edge = np.empty(len(keys), dtype=np.int64)
        edge[order] = np.cumsum(first) - 1
        return ordered[first], edge, order

    @cached_property
    def edges(self) -> Int64[np.ndarray, "E 2"]:
        """(E, 2) the undirected edges, smaller vertex first, in lexicographic order."""
        keys = self._edge_keys[0]
        return np.stack([keys // self.num_verts, keys % self.num_verts], axis=1) if len(keys) else np.empty((0, 2), int)

    @property
    def edge_of(self) -> Indices:
        """(C,) the edge that each half-edge lies on."""
        return self._edge_keys[1]

    @cached_property
    def faces_per_edge(self) -> Indices:
        """(E,) number of faces at each edge: 2 inside, 1 on the boundary, more where the mesh is not manifold."""
        return np.bincount(self.edge_of, minlength=len(self.edges))

    @cached_property
    def edge_halfedge(self) -> Indices:
        """(E,) the first half-edge of each edge."""
        order, counts = self._edge_keys[2], self.faces_per_edge
        return np.asarray(order[np.cumsum(counts) - counts])

    @cached_property
    def twin(self) -> Indices:
        """(C,) the half-edge on the other side of the edge; `NONE` on the boundary and at non-manifold edges."""
        order, counts = self._edge_keys[2], self.faces_per_edge
        first = (np.cumsum(counts) - counts)[counts == 2]
        twin = np.full(len(self.tail), NONE, dtype=np.int64)
        twin[order[first]], twin[order[first + 1]] = order[first + 1], order[first]
        return twin

    @cached_property
    def face_pairs(self) -> Int64[np.ndarray, "P 2"]:
        """(P, 2) half-edges of every two faces that share an edge; k faces at one edge make k(k-1)/2 pairs."""
        order, counts = self._edge_keys[2], self.faces_per_edge
        starts = np.cumsum(counts) - counts
        pairs = [
            order[np.stack([starts[counts == k] + i, starts[counts == k] + j], axis=1)]
            for k in np.unique(counts)
            for i in range(k)
            for j in range(i + 1, k)
        ]
        return np.concatenate(pairs) if pairs else np.empty((0, 2), dtype=np.int64)

    @cached_property
    def valence(self) -> Indices:
        """(V,) number of edges at each vertex."""
        return np.bincount(self.edges.reshape(-1), minlength=self.num_verts)

    @cached_property
    def boundary_edges(self) -> Mask:
        """(E,) which edges have one face only."""
        return np.asarray(self.faces_per_edge == 1)

    @cached_property
    def boundary_verts(self) -> Mask:
        """(V,) which vertices lie on a boundary edge."""
        on_boundary = np.zeros(self.num_verts, dtype=bool)
        on_boundary[self.edges[self.boundary_edges].reshape(-1)] = True
        return on_boundary

    @cached_property
    def boundary_neighbours(self) -> Int64[np.ndarray, "V 2"]:
        """(V, 2) the vertex before and the one after along the boundary, faces to the left; `NONE` off the boundary."""
        out = np.flatnonzero(self.boundary_edges[self.edge_of])
        neighbours = np.full((self.num_verts, 2), NONE, dtype=np.int64)
        neighbours[self.head[out], 0] = self.tail[out]
        neighbours[self.tail[out], 1] = self.head[out]
        return neighbours

    def next_around_tail(self, halfedge: Indices) -> Indices:
        """The next half-edge out of the same vertex, counter-clockwise; `NONE` where the boundary comes between."""
        return np.asarray(self.twin[self.preceding(halfedge)])

    @property
    def num_edges(self) -> int:
        """E, the number of undirected edges."""
        return len(self.edges)
