"""Meshes of a scene put where their transforms place them, into one polygon soup."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.polygons import Corners, PolygonSoup, Sizes

Matrix = Float64[np.ndarray, "4 4"]

# How much of its meshes the scene of a small file may repeat.
_FREE_ELEMENTS = 2_000_000
_ELEMENTS_PER_BYTE = 100
_ELEMENTS_PER_PIECE = 50


class PlacedMeshes:
    """The pieces of a scene; one that its transform mirrors is turned, so that its outside stays outside."""

    def __init__(self) -> None:
        self._pieces: list[PolygonSoup] = []
        self._elements = 0

    def place(self, piece: PolygonSoup, transform: Matrix, num_bytes: int) -> None:
        """Append a piece under a transform, of columns.

        Args:
            piece: with corners that are valid in it.
            transform: to the scene.
            num_bytes: of the data that was read so far.

        Raises:
            MeshError: the pieces are far more than a file of this size plausibly holds.
        """
        self.spend(len(piece.verts) + len(piece.corners), num_bytes)
        with np.errstate(all="ignore"):  # coordinates that overflow are refused later, with their vertex
            verts = piece.verts @ transform[:3, :3].T + transform[:3, 3]
            mirrored = bool(np.linalg.det(transform[:3, :3]) < 0)
        self.append(PolygonSoup(verts, piece.corners, piece.sizes), mirrored=mirrored)

    def append(self, piece: PolygonSoup, *, mirrored: bool) -> None:
        """Append a piece as it is, turned if it is mirrored."""
        corners = reversed_corners(piece.corners, piece.sizes) if mirrored else piece.corners
        self._pieces.append(PolygonSoup(piece.verts, corners, piece.sizes))

    def spend(self, elements: int, num_bytes: int) -> None:
        """Count elements of a piece, and refuse too many for a file of this size."""
        self._elements += _ELEMENTS_PER_PIECE + elements
        if self._elements > _FREE_ELEMENTS + _ELEMENTS_PER_BYTE * num_bytes:
            raise MeshError("its scene repeats the meshes far more often than a file of this size plausibly does")

    def soup(self) -> PolygonSoup:
        """Return all pieces that have faces; those without any where none has."""
        pieces = [piece for piece in self._pieces if len(piece.sizes)] or self._pieces
        starts = np.cumsum([0, *(len(piece.verts) for piece in pieces)])
        corners = [piece.corners + start for piece, start in zip(pieces, starts, strict=False)]
        return PolygonSoup(
            np.concatenate([np.empty((0, 3)), *(piece.verts for piece in pieces)]),
            np.concatenate([np.empty(0, np.int64), *corners]),
            np.concatenate([np.empty(0, np.int64), *(piece.sizes for piece in pieces)]),
        )


def reversed_corners(corners: Corners, sizes: Sizes) -> NDArray[np.int64]:
    """Return the corners of each polygon in reverse order."""
    ends = np.cumsum(sizes)
    mirror = np.repeat(2 * ends - sizes - 1, sizes)
    return np.asarray(corners[mirror - np.arange(len(corners))])
