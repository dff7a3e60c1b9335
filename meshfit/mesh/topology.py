"""Who is next to whom in a triangle mesh, built once and then only read.

Half-edge 3f + k runs along face f from its corner k to its corner k + 1 (mod 3).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Int64

from meshfit.mesh.halfedges import NONE, HalfEdges, Indices, Mask
from meshfit.mesh.mesh import Faces, Mesh
from meshfit.mesh.polygons import PolygonMesh

__all__ = ["NONE", "Indices", "Mask", "Topology", "next_in_face", "previous_in_face"]


def next_in_face(halfedge: Indices) -> Indices:
    """The half-edge that follows in the same triangle."""
    return np.asarray(halfedge - halfedge % 3 + (halfedge + 1) % 3)


def previous_in_face(halfedge: Indices) -> Indices:
    """The half-edge that precedes in the same triangle."""
    return np.asarray(halfedge - halfedge % 3 + (halfedge + 2) % 3)


@dataclass(frozen=True, eq=False)
class Topology(HalfEdges):
    """The connectivity of a triangle mesh.

    Attributes:
        num_verts: V; verts that no face uses are allowed.
        faces: (F, 3) int64.
    """

    faces: Faces

    @classmethod
    def of(cls, mesh: Mesh) -> "Topology":
        """The topology of a mesh."""
        return cls(mesh.num_verts, mesh.faces)

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
        """(3F,) vertex opposite to each half-edge in its face."""
        return np.roll(self.faces, -2, axis=1).reshape(-1)

    def following(self, halfedge: Indices) -> Indices:
        """The half-edge that follows in the same face."""
        return next_in_face(halfedge)

    def preceding(self, halfedge: Indices) -> Indices:
        """The half-edge that precedes in the same face."""
        return previous_in_face(halfedge)

    def face_of(self, halfedge: Indices) -> Indices:
        """The face that each half-edge belongs to."""
        return np.asarray(halfedge // 3)

    @property
    def has_vert_twice(self) -> Mask:
        """(F,) which faces come by the same vertex twice."""
        return np.asarray((self.faces == np.roll(self.faces, 1, axis=1)).any(axis=1))

    def corners_of(self, face: int) -> list[int]:
        """The verts of one face, in its order."""
        return [int(vert) for vert in self.faces[face]]


@dataclass(frozen=True, eq=False)
class PolygonTopology(HalfEdges):
    """The connectivity of a mesh whose faces have any number of corners.

    Attributes:
        num_verts: V; verts that no face uses are allowed.
        corners: (C,) int64, the verts of all faces, one face after the other, each counter-clockwise.
        sizes: (F,) int64, the number of corners of each face.
    """

    corners: Int64[np.ndarray, " C"]
    sizes: Int64[np.ndarray, " F"]

    @classmethod
    def of(cls, mesh: "PolygonMesh | Topology") -> "PolygonTopology":
        """The topology of a mesh of polygons, or that of triangles as one of polygons."""
        if isinstance(mesh, Topology):
            return cls(mesh.num_verts, mesh.tail, np.full(mesh.num_faces, 3, dtype=np.int64))
        return cls(mesh.num_verts, mesh.corners, mesh.sizes)

    @property
    def num_faces(self) -> int:
        """F, the number of faces."""
        return len(self.sizes)

    @cached_property
    def starts(self) -> Indices:
        """(F,) the first half-edge of each face."""
        return np.asarray(np.cumsum(self.sizes) - self.sizes)

    @property
    def tail(self) -> Indices:
        """(C,) vertex at which each half-edge starts."""
        return self.corners

    @cached_property
    def head(self) -> Indices:
        """(C,) vertex at which each half-edge ends."""
        return np.asarray(self.corners[self._following])

    @cached_property
    def face(self) -> Indices:
        """(C,) the face that each half-edge belongs to."""
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

    def following(self, halfedge: Indices) -> Indices:
        """The half-edge that follows in the same face."""
        return np.asarray(self._following[halfedge])

    def preceding(self, halfedge: Indices) -> Indices:
        """The half-edge that precedes in the same face."""
        return np.asarray(self._preceding[halfedge])

    def face_of(self, halfedge: Indices) -> Indices:
        """The face that each half-edge belongs to."""
        return np.asarray(self.face[halfedge])

    @property
    def has_vert_twice(self) -> Mask:
        """(F,) which faces come by the same vertex twice."""
        order = np.lexsort((self.corners, self.face))
        vert, face = self.corners[order], self.face[order]
        twice = np.zeros(self.num_faces, dtype=bool)
        twice[face[1:][(vert[1:] == vert[:-1]) & (face[1:] == face[:-1])]] = True
        return twice

    def corners_of(self, face: int) -> list[int]:
        """The verts of one face, in its order."""
        start = int(self.starts[face])
        return [int(vert) for vert in self.corners[start : start + int(self.sizes[face])]]
