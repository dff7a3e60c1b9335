"""Triangle meshes: an array of vertex positions and an array of faces."""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import ArrayLike, NDArray

from meshfit.errors import MeshError
from meshfit.mesh.attributes import NO_ATTRIBUTES, Attributes
from meshfit.mesh.showable import Showable
from meshfit.units import count_text

Verts = Float64[np.ndarray, "V 3"]
Faces = Int64[np.ndarray, "F 3"]


@dataclass(frozen=True, eq=False, init=False)
class Mesh(Showable):
    """A triangle mesh. Both arrays are read-only.

    Attributes:
        verts: (V, 3) float64, positions.
        faces: (F, 3) int64, rows of vertex indices, counter-clockwise seen from outside.
        attributes: texture coordinates, colours, materials and the like; most meshes have none.

    Example:
        >>> import meshfit
        >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
        >>> mesh = meshfit.Mesh(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
        >>> mesh
        Mesh(4 verts, 4 faces, box 1 × 1 × 1)
        >>> mesh.with_verts(25.4 * mesh.verts)
        Mesh(4 verts, 4 faces, box 25.4 × 25.4 × 25.4)

    Raises:
        MeshError: an array of another shape.
    """

    verts: Verts
    faces: Faces
    attributes: Attributes

    def __init__(self, verts: ArrayLike, faces: ArrayLike, attributes: Attributes = NO_ATTRIBUTES) -> None:
        for name, values, dtype in (("verts", verts, np.float64), ("faces", faces, np.int64)):
            array = frozen(values, dtype)
            if array.size == 0:
                array = array.reshape(0, 3)
            if array.ndim != 2 or array.shape[1] != 3:
                raise MeshError(f"{name}: expected rows of three numbers, got an array of shape {array.shape}")
            object.__setattr__(self, name, array)
        attributes.require_sizes(len(self.verts), len(self.faces), 3 * len(self.faces))
        object.__setattr__(self, "attributes", attributes)

    def with_verts(self, verts: ArrayLike) -> "Mesh":
        """Return the same faces and attributes with other positions."""
        return Mesh(verts, self.faces, self.attributes)

    def with_attributes(self, attributes: Attributes) -> "Mesh":
        """Return the same shape with other attributes."""
        return Mesh(self.verts, self.faces, attributes)

    def __repr__(self) -> str:
        """Return the numbers of vertices and faces, and the size of the bounding box."""
        counts = f"{count_text(self.num_verts, 'vert')}, {count_text(self.num_faces, 'face')}"
        return f"Mesh({counts}{box_text(self.verts)})"

    @property
    def num_verts(self) -> int:
        """V, the number of vertices."""
        return len(self.verts)

    @property
    def num_faces(self) -> int:
        """F, the number of faces."""
        return len(self.faces)


class SameContent:
    """A mesh that equals every mesh of the same shape, as the key of a cache."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.digest = hashlib.sha256(mesh.verts.tobytes() + b"faces" + mesh.faces.tobytes()).digest()

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SameContent) and self.digest == other.digest


def frozen(values: ArrayLike, dtype: type[np.generic]) -> NDArray[Any]:
    """Return values as a read-only array of their own: a copy, except of a whole array that is read-only already."""
    if isinstance(values, np.ndarray) and values.dtype == dtype and _is_whole_and_frozen(values):
        return values
    array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


def _is_whole_and_frozen(array: NDArray[Any]) -> bool:
    owner = array if array.base is None else array.base
    if not isinstance(owner, np.ndarray) or array.flags.writeable or owner.flags.writeable:
        return False
    return owner.flags.owndata and owner.size == array.size and array.flags.c_contiguous


def freeze(array: NDArray[Any]) -> None:
    """Make an array read-only for good, with the array that it is a view of."""
    array.setflags(write=False)
    if isinstance(array.base, np.ndarray):
        array.base.setflags(write=False)


def box_text(verts: Verts) -> str:
    """Return `, box 1.56 × 1.53 × 1.2`, the size of the bounding box, for the end of a repr; empty without vertices."""
    if not len(verts):
        return ""
    return f", box {' × '.join(f'{length:.4g}' for length in verts.max(axis=0) - verts.min(axis=0))}"
