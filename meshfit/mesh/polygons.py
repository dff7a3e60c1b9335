"""From the polygons of a file to triangles."""

import itertools

import numpy as np
from numpy.typing import NDArray

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


def fan(corners: list[int], where: str = "") -> list[list[int]]:
    """The triangles of a polygon, all from its first corner; `where` goes in front of what is said of a faulty one.

    Raises:
        ValueError: fewer than three corners.
    """
    if len(corners) < 3:
        raise ValueError(f"{where}a face of {len(corners)} corners, 3 or more are needed")
    return [[corners[0], *pair] for pair in itertools.pairwise(corners[1:])]


def arrays(verts: list[list[float]], faces: list[list[int]]) -> Arrays:
    """(V, 3) and (F, 3) arrays of these rows, of which there may be none."""
    return np.array(verts, np.float64).reshape(-1, 3), np.array(faces, np.int64).reshape(-1, 3)
