"""The triangle mesh: an array of vertex positions and an array of faces, and nothing else."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

Verts = Float64[np.ndarray, "V 3"]
Faces = Int64[np.ndarray, "F 3"]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh. Both arrays are made read-only.

    Attributes:
        verts: (V, 3) float64, positions.
        faces: (F, 3) int64, rows of vertex indices, counter-clockwise seen from outside.
    """

    verts: Verts
    faces: Faces

    def __post_init__(self) -> None:
        for name, dtype in (("verts", np.float64), ("faces", np.int64)):
            array = np.array(getattr(self, name), dtype=dtype).reshape(-1, 3)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def num_verts(self) -> int:
        """V, the number of vertices."""
        return len(self.verts)

    @property
    def num_faces(self) -> int:
        """F, the number of faces."""
        return len(self.faces)
