"""Polygon meshes: faces of three or more corners, stored one after another in a flat array."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Int64
from numpy.typing import ArrayLike, NDArray

from meshfit.errors import MeshError
from meshfit.mesh.attributes import NO_ATTRIBUTES, Attributes
from meshfit.mesh.mesh import Mesh, Verts, box_text, frozen
from meshfit.mesh.showable import Showable
from meshfit.mesh.triangulation import triangle_corners, triangulate
from meshfit.units import count_text

Corners = Int64[np.ndarray, " C"]
Sizes = Int64[np.ndarray, " F"]
_LARGEST = np.iinfo(np.int64).max


class PolygonSoup(NamedTuple):
    """The raw, unchecked content of a file: (V, 3) positions, (C,) corners of all faces, (F,) sizes, attributes.

    Readers of some formats add (V, 3) normals of points, where the file has no faces.
    """

    verts: NDArray[np.floating]
    corners: NDArray[np.int64]
    sizes: NDArray[np.int64]
    attributes: Attributes = NO_ATTRIBUTES
    normals: NDArray[np.floating] | None = None

    @classmethod
    def of_triangles(cls, verts: NDArray[np.floating], faces: NDArray[np.int64]) -> "PolygonSoup":
        """Return (F, 3) triangles as polygons."""
        return cls(verts, faces.reshape(-1), np.full(len(faces), 3, dtype=np.int64))

    @classmethod
    def of_rows(cls, verts: Sequence[Sequence[int | float]], faces: Sequence[Sequence[int]]) -> "PolygonSoup":
        """Return lists of coordinates and of corners as arrays; both may be empty."""
        corners = np.array([corner for face in faces for corner in face], dtype=np.int64)
        return cls(np.array(verts, np.float64).reshape(-1, 3), corners, np.array([len(f) for f in faces], np.int64))


@dataclass(frozen=True, eq=False, init=False)
class PolygonMesh(Showable):
    """A mesh whose faces have any number of corners. All arrays are read-only.

    Attributes:
        verts: (V, 3) float64, positions.
        corners: (C,) int64, vertex indices of all faces, one face after another, each counter-clockwise from outside.
        sizes: (F,) int64, the number of corners of each face.
        attributes: as of a `Mesh`.

    Example:
        >>> import meshfit
        >>> house = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0]]
        >>> mesh = meshfit.PolygonMesh(house, corners=[0, 1, 2, 3, 3, 2, 4], sizes=[4, 3])
        >>> mesh
        PolygonMesh(5 verts, 2 faces of 3 to 4 corners, box 1 × 2 × 0)
        >>> mesh.triangulated()
        Mesh(5 verts, 3 faces, box 1 × 2 × 0)

    Raises:
        MeshError: arrays of other shapes, a face of fewer than three corners, or sizes that do not add up.
    """

    verts: Verts
    corners: Corners
    sizes: Sizes
    attributes: Attributes

    def __init__(
        self, verts: ArrayLike, corners: ArrayLike, sizes: ArrayLike, attributes: Attributes = NO_ATTRIBUTES
    ) -> None:
        points = Mesh(verts, []).verts
        flat, counts = frozen(corners, np.int64), frozen(sizes, np.int64)
        if flat.ndim != 1 or counts.ndim != 1 or counts.sum() != len(flat):
            raise MeshError(f"{flat.size} corners do not match the sizes of {counts.size} faces")
        if (counts < 3).any():
            face = int(np.flatnonzero(counts < 3)[0])
            raise MeshError(f"face {face}: expected 3 or more corners, got {counts[face]}")
        for name, array in (("verts", points), ("corners", flat), ("sizes", counts)):
            object.__setattr__(self, name, array)
        attributes.require_sizes(len(points), len(counts), len(flat))
        object.__setattr__(self, "attributes", attributes)

    def __repr__(self) -> str:
        """Return the numbers of vertices and faces, the sizes of faces, and the size of the bounding box."""
        low, high = int(self.sizes.min(initial=_LARGEST)), int(self.sizes.max(initial=0))
        noun = {(3, 3): "triangle", (4, 4): "quad"}.get((low, high), "face")
        sizes = "" if noun != "face" or not high else f" of {low}{f' to {high}' if high > low else ''} corners"
        counts = f"{count_text(self.num_verts, 'vert')}, {count_text(self.num_faces, noun)}{sizes}"
        return f"PolygonMesh({counts}{box_text(self.verts)})"

    @classmethod
    def of(cls, mesh: "Mesh | PolygonMesh") -> "PolygonMesh":
        """Return the mesh as a polygon mesh."""
        if isinstance(mesh, PolygonMesh):
            return mesh
        return cls(mesh.verts, mesh.faces.reshape(-1), np.full(mesh.num_faces, 3), mesh.attributes)

    @property
    def num_verts(self) -> int:
        """V, the number of vertices."""
        return len(self.verts)

    @property
    def num_faces(self) -> int:
        """F, the number of faces."""
        return len(self.sizes)

    @cached_property
    def starts(self) -> Sizes:
        """(F,) index of the first corner of each face."""
        return np.asarray(np.cumsum(self.sizes) - self.sizes)

    def with_verts(self, verts: ArrayLike) -> "PolygonMesh":
        """Return the same faces and attributes with other positions."""
        return PolygonMesh(verts, self.corners, self.sizes, self.attributes)

    def with_attributes(self, attributes: Attributes) -> "PolygonMesh":
        """Return the same shape with other attributes."""
        return PolygonMesh(self.verts, self.corners, self.sizes, attributes)

    def triangulated(self) -> Mesh:
        """Split each polygon into triangles as `triangulate` does: n corners give n - 2 consecutive triangles.

        Raises:
            MeshError: a vertex index out of range.
        """
        if not self.attributes:
            return Mesh(self.verts, triangulate(self.verts, self.corners, self.sizes))
        corners = triangle_corners(self.verts, self.corners, self.sizes)
        of_triangle = np.repeat(np.arange(self.num_faces), self.sizes - 2)
        attributes = self.attributes.selected(np.arange(self.num_verts), of_triangle, corners.reshape(-1))
        return Mesh(self.verts, self.corners[corners], attributes)


def face_rows(mesh: Mesh | PolygonMesh) -> list[list[int]]:
    """Return the corners of each face as a list."""
    mesh = PolygonMesh.of(mesh)
    corners, ends = mesh.corners.tolist(), (mesh.starts + mesh.sizes).tolist()
    return [corners[start:end] for start, end in zip(mesh.starts.tolist(), ends, strict=True)]


def checked_face_size(count: int, where: str = "") -> int:
    """Return the number of corners of a face in a file, if it is allowed; `where` begins the message otherwise.

    Raises:
        MeshError: fewer than three corners.
    """
    if count < 3:
        raise MeshError(f"{where}expected a face of 3 or more corners, got {count}")
    return count
