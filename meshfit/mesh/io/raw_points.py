"""The points of a file before they are checked."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64


class RawPoints(NamedTuple):
    """Points in file order.

    Attributes:
        verts: (N, 3) positions.
        normals: (N, 3) of any length, 0 or not finite where one is not known; None if the file has none.
        sensor: position that the points were seen from; None if the file does not tell.
    """

    verts: Float64[np.ndarray, "N 3"]
    normals: Float64[np.ndarray, "N 3"] | None = None
    sensor: tuple[float, float, float] | None = None
