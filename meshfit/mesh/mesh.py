"""Triangle meshes: an array of vertex positions and an array of faces."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import ArrayLike

from meshfit.errors import MeshError

Verts = Float64[np.ndarray, "V 3"]
Faces = Int64[np.ndarray, "F 3"]


@dataclass(frozen=True, eq=False, init=False)
class Mesh:
    """A triangle mesh. Both arrays are read-only copies.

    Attributes:
        verts: (V, 3) float64, positions.
        faces: (F, 3) int64, rows of vertex indices, counter-clockwise seen from outside.

    Raises:
        MeshError: an array of another shape.
    """

    verts: Verts
    faces: Faces

    def __init__(self, verts: ArrayLike, faces: ArrayLike) -> None:
        for name, values, dtype in (("verts", verts, np.float64), ("faces", faces, np.int64)):
            array = np.array(values, dtype=dtype)
            if array.size == 0:
                array = array.reshape(0, 3)
            if array.ndim != 2 or array.shape[1] != 3:
                raise MeshError(f"{name}: expected rows of three numbers, got an array of shape {array.shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def with_verts(self, verts: ArrayLike) -> "Mesh":
        """Return the same faces with other positions."""
        return Mesh(verts, self.faces)

    @property
    def num_verts(self) -> int:
        """V, the number of vertices."""
        return len(self.verts)

    @property
    def num_faces(self) -> int:
        """F, the number of faces."""
        return len(self.faces)
