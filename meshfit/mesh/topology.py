"""Who is next to whom in a triangle mesh, built once and then only read.

Half-edge 3f + k runs along face f from its corner k to its corner k + 1 (mod 3).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from meshfit.mesh.halfedges import NONE, HalfEdges, Indices, Mask
from meshfit.mesh.mesh import Faces, Mesh

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
