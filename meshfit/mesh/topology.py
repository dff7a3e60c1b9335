"""Half-edge connectivity of triangle and polygon meshes, built once and then only read."""

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Int64
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from meshfit.mesh.mesh import Faces, Mesh
from meshfit.mesh.polygons import PolygonMesh

# Topologies of up to so many faces are kept as long as their meshes; they take some 200 bytes per face.
_MOST_KEPT = 1_000_000

NONE = -1
"""The index of what does not exist."""
Indices = Int64[np.ndarray, "_"]
Mask = Bool[np.ndarray, "_"]


@dataclass(frozen=True, eq=False)
class HalfEdges:
    """Connectivity that follows from C half-edges alone, whatever the sizes of faces: edges, twins, boundary, valence.

    A half-edge runs along one face from one corner to the next.

    Attributes:
        num_verts: V; vertices that no face uses are allowed.
    """

    num_verts: int

    @property
    @abstractmethod
    def num_faces(self) -> int:
        """F, the number of faces."""

    @property
    def num_edges(self) -> int:
        """E, the number of undirected edges."""
        return len(self.faces_per_edge)

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
        """Return the next half-edge in the same face."""

    @abstractmethod
    def preceding(self, halfedge: Indices) -> Indices:
        """Return the previous half-edge in the same face."""

    @abstractmethod
    def face_of(self, halfedge: Indices) -> Indices:
        """Return the face of each half-edge."""

    @property
    @abstractmethod
    def has_vert_twice(self) -> Mask:
        """(F,) which faces have a vertex twice."""

    @abstractmethod
    def corners_of(self, face: int) -> list[int]:
        """Return the vertices of one face, in its order."""

    @cached_property
    def directed_edges(self) -> csr_array:
        """(V, V) matrix with 1 + the half-edge from row to column; numbers of equal half-edges are added up."""
        # Half of the memory; sums that overflow are those of equal half-edges, which nobody reads.
        small = len(self.tail) < np.iinfo(np.int32).max
        numbers: NDArray[Any] = np.arange(1, len(self.tail) + 1, dtype=np.int32 if small else np.int64)
        return coo_array((numbers, (self.tail, self.head)), shape=(self.num_verts, self.num_verts)).tocsr()

    @cached_property
    def _opposite(self) -> Indices | None:
        """(C,) the half-edge in the opposite direction of each one, if each has exactly one; found without sorting."""
        forth = self.directed_edges
        back = forth.T.tocsr()
        if forth.nnz < len(self.tail) or not (
            np.array_equal(forth.indptr, back.indptr) and np.array_equal(forth.indices, back.indices)
        ):
            return None
        opposite = np.empty(len(self.tail), dtype=np.int64)
        opposite[forth.data - 1] = back.data - 1
        return opposite

    @property
    def is_watertight(self) -> bool:
        """Whether every edge has exactly two faces, which run through it in opposite directions."""
        return len(self.tail) > 0 and self._opposite is not None

    @cached_property
    def _by_edge(self) -> tuple[Indices, Indices]:
        """The half-edges in the order of their edges, and the place of the first one of each edge."""
        keys = np.minimum(self.tail, self.head) * self.num_verts + np.maximum(self.tail, self.head)
        order = stable_order(keys, int(self.num_verts**2).bit_length())
        keys = keys[order]
        return order, np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]])[: len(keys)])

    @cached_property
    def edges(self) -> Int64[np.ndarray, "E 2"]:
        """(E, 2) undirected edges, smaller vertex first, in lexicographic order."""
        tail, head = self.tail[self.edge_halfedge], self.head[self.edge_halfedge]
        return np.stack([np.minimum(tail, head), np.maximum(tail, head)], axis=1)

    @cached_property
    def edge_of(self) -> Indices:
        """(C,) edge of each half-edge."""
        edge = np.empty(len(self.tail), dtype=np.int64)
        edge[self._by_edge[0]] = np.repeat(np.arange(self.num_edges), self.faces_per_edge)
        return edge

    @cached_property
    def faces_per_edge(self) -> Indices:
        """(E,) number of faces at each edge: 2 inside, 1 on the boundary, more where the mesh is not manifold."""
        if self.is_watertight:
            return np.full(len(self.tail) // 2, 2)
        return np.diff(self._by_edge[1], append=len(self.tail))

    @cached_property
    def edge_halfedge(self) -> Indices:
        """(E,) first half-edge of each edge."""
        order, first = self._by_edge
        return np.asarray(order[first])

    @cached_property
    def twin(self) -> Indices:
        """(C,) half-edge on the other side of the edge; `NONE` on the boundary and at non-manifold edges."""
        if self._opposite is not None:
            return self._opposite
        order, first = self._by_edge
        first = first[self.faces_per_edge == 2]
        twin = np.full(len(self.tail), NONE, dtype=np.int64)
        twin[order[first]], twin[order[first + 1]] = order[first + 1], order[first]
        return twin

    @cached_property
    def misoriented_edges(self) -> Indices:
        """(M,) edges whose two faces run through them in the same direction."""
        if self.is_watertight:
            return np.empty(0, dtype=np.int64)
        order, first = self._by_edge
        inner = np.flatnonzero(self.faces_per_edge == 2)
        first = first[inner]
        return np.asarray(inner[self.tail[order[first]] == self.tail[order[first + 1]]])

    @cached_property
    def face_pairs(self) -> Int64[np.ndarray, "P 2"]:
        """(P, 2) half-edges of each pair of faces that share an edge; k faces at one edge make k(k-1)/2 pairs."""
        (order, starts), counts = self._by_edge, self.faces_per_edge
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
        """(E,) which edges have a single face."""
        return np.asarray(self.faces_per_edge == 1)

    @cached_property
    def boundary_verts(self) -> Mask:
        """(V,) which vertices lie on a boundary edge."""
        if len(self.tail) == self.num_verts and np.array_equal(self.tail, np.arange(self.num_verts)):
            return np.ones(self.num_verts, dtype=bool)  # separate faces, as in STL files
        on_boundary = np.zeros(self.num_verts, dtype=bool)
        if not self.is_watertight:
            on_boundary[self.edges[self.boundary_edges].reshape(-1)] = True
        return on_boundary

    @cached_property
    def boundary_neighbours(self) -> Int64[np.ndarray, "V 2"]:
        """(V, 2) previous and next vertex along the boundary, faces to the left; `NONE` off the boundary."""
        out = np.flatnonzero(self.boundary_edges[self.edge_of])
        neighbours = np.full((self.num_verts, 2), NONE, dtype=np.int64)
        neighbours[self.head[out], 0] = self.tail[out]
        neighbours[self.tail[out], 1] = self.head[out]
        return neighbours

    def next_around_tail(self, halfedge: Indices) -> Indices:
        """Return the next half-edge out of the same vertex, counter-clockwise; `NONE` across a boundary."""
        return np.asarray(self.twin[self.preceding(halfedge)])


def stable_order(keys: NDArray[np.integer], bits: int) -> Indices:
    """Return the stable order of keys from 0 to below 2^bits: by 16 bits at a time, which numpy sorts by radix."""
    order = np.argsort(keys.astype(np.uint16), kind="stable")
    for shift in range(16, bits, 16):
        order = order[np.argsort((keys[order] >> keys.dtype.type(shift)).astype(np.uint16), kind="stable")]
    return order


def next_in_face(halfedge: Indices) -> Indices:
    """Return the next half-edge in the same triangle."""
    return np.asarray(halfedge - halfedge % 3 + (halfedge + 1) % 3)


def previous_in_face(halfedge: Indices) -> Indices:
    """Return the previous half-edge in the same triangle."""
    return np.asarray(halfedge - halfedge % 3 + (halfedge + 2) % 3)


@dataclass(frozen=True, eq=False)
class Topology(HalfEdges):
    """Connectivity of a triangle mesh: half-edge 3f + k runs along face f from corner k to corner k + 1 (mod 3).

    Attributes:
        num_verts: V; vertices that no face uses are allowed.
        faces: (F, 3) int64.
    """

    faces: Faces

    @classmethod
    def of(cls, mesh: Mesh) -> "Topology":
        """Return the topology of a mesh, with all that it has computed before if the mesh is not very large."""
        topology = _topologies.get(mesh)
        if topology is None:
            topology = cls(mesh.num_verts, mesh.faces)
            if mesh.num_faces <= _MOST_KEPT:
                _topologies[mesh] = topology
        return topology

    @property
    def num_faces(self) -> int:
        """F, the number of faces."""
        return len(self.faces)

    @cached_property
    def tail(self) -> Indices:
        """(3F,) vertex at which each half-edge starts."""
        return self.faces.reshape(-1)

    @cached_property
    def head(self) -> Indices:
        """(3F,) vertex at which each half-edge ends."""
        return np.roll(self.faces, -1, axis=1).reshape(-1)

    @cached_property
    def apex(self) -> Indices:
        """(3F,) vertex opposite each half-edge in its face."""
        return np.roll(self.faces, -2, axis=1).reshape(-1)

    def following(self, halfedge: Indices) -> Indices:
        """Return the next half-edge in the same face."""
        return next_in_face(halfedge)

    def preceding(self, halfedge: Indices) -> Indices:
        """Return the previous half-edge in the same face."""
        return previous_in_face(halfedge)

    def face_of(self, halfedge: Indices) -> Indices:
        """Return the face of each half-edge."""
        return np.asarray(halfedge // 3)

    @property
    def has_vert_twice(self) -> Mask:
        """(F,) which faces have a vertex twice."""
        return np.asarray((self.faces == np.roll(self.faces, 1, axis=1)).any(axis=1))

    def corners_of(self, face: int) -> list[int]:
        """Return the vertices of one face, in its order."""
        return [int(vert) for vert in self.faces[face]]


_topologies = WeakKeyDictionary[Mesh, Topology]()


@dataclass(frozen=True, eq=False)
class PolygonTopology(HalfEdges):
    """Connectivity of a mesh whose faces have any number of corners.

    Attributes:
        num_verts: V; vertices that no face uses are allowed.
        corners: (C,) int64, the vertices of all faces, one face after another, each counter-clockwise.
        sizes: (F,) int64, the number of corners of each face.
    """

    corners: Int64[np.ndarray, " C"]
    sizes: Int64[np.ndarray, " F"]

    @classmethod
    def of(cls, mesh: "PolygonMesh | Topology") -> "PolygonTopology":
        """Return the topology of a polygon mesh, or that of triangles as one of polygons."""
        if isinstance(mesh, Topology):
            return cls(mesh.num_verts, mesh.tail, np.full(mesh.num_faces, 3, dtype=np.int64))
        return cls(mesh.num_verts, mesh.corners, mesh.sizes)

    @property
    def num_faces(self) -> int:
        """F, the number of faces."""
        return len(self.sizes)

    @cached_property
    def _has_triangles_only(self) -> bool:
        """Whether neighbours in a face follow from the number of a half-edge, as in a `Topology`."""
        return bool((self.sizes == 3).all())

    @cached_property
    def starts(self) -> Indices:
        """(F,) first half-edge of each face."""
        return np.asarray(np.cumsum(self.sizes) - self.sizes)

    @property
    def tail(self) -> Indices:
        """(C,) vertex at which each half-edge starts."""
        return self.corners

    @cached_property
    def head(self) -> Indices:
        """(C,) vertex at which each half-edge ends."""
        if self._has_triangles_only:
            return np.roll(self.corners.reshape(-1, 3), -1, axis=1).reshape(-1)
        return np.asarray(self.corners[self._following])

    @cached_property
    def face(self) -> Indices:
        """(C,) face of each half-edge."""
        return np.repeat(np.arange(self.num_faces), self.sizes)

    @cached_property
    def _following(self) -> Indices:
        following = np.arange(1, len(self.corners) + 1)
        following[self.starts + self.sizes - 1] = self.starts
        return following

    @cached_property
    def _preceding(self) -> Indices:
        preceding = np.arange(-1, len(self.corners) - 1)
        preceding[self.starts] = self.starts + self.sizes - 1
        return preceding

    @cached_property
    def lone_faces(self) -> Indices:
        """Faces of which all edges have the same face on their other side."""
        first, second = self.twin[self.starts], self.twin[self.starts + 1]
        shared = np.flatnonzero((first != NONE) & (second != NONE))
        faces = shared[self.face_of(first[shared]) == self.face_of(second[shared])]
        if not len(faces):
            return np.empty(0, dtype=np.int64)
        sizes = self.sizes[faces]
        starts = np.cumsum(sizes) - sizes
        across = self.twin[np.repeat(self.starts[faces] - starts, sizes) + np.arange(int(sizes.sum()))]
        same = (across != NONE) & (self.face_of(across) == np.repeat(self.face_of(first[faces]), sizes))
        alone: Mask = np.logical_and.reduceat(same, starts)
        return np.asarray(faces[alone])

    def following(self, halfedge: Indices) -> Indices:
        """Return the next half-edge in the same face."""
        return next_in_face(halfedge) if self._has_triangles_only else np.asarray(self._following[halfedge])

    def preceding(self, halfedge: Indices) -> Indices:
        """Return the previous half-edge in the same face."""
        return previous_in_face(halfedge) if self._has_triangles_only else np.asarray(self._preceding[halfedge])

    def face_of(self, halfedge: Indices) -> Indices:
        """Return the face of each half-edge."""
        return np.asarray(halfedge // 3 if self._has_triangles_only else self.face[halfedge])

    @property
    def has_vert_twice(self) -> Mask:
        """(F,) which faces have a vertex twice."""
        order = np.lexsort((self.corners, self.face))
        vert, face = self.corners[order], self.face[order]
        twice = np.zeros(self.num_faces, dtype=bool)
        twice[face[1:][(vert[1:] == vert[:-1]) & (face[1:] == face[:-1])]] = True
        return twice

    def corners_of(self, face: int) -> list[int]:
        """Return the vertices of one face, in its order."""
        start = int(self.starts[face])
        return [int(vert) for vert in self.corners[start : start + int(self.sizes[face])]]
