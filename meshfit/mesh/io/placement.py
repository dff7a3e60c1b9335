"""Meshes of a scene put where their transforms place them, into one polygon soup."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.io.attribute_union import united
from meshfit.mesh.polygons import PolygonSoup

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
        self.spend(len(piece.verts) + len(piece.corners) + piece.attributes.num_values, num_bytes)
        with np.errstate(all="ignore"):  # coordinates that overflow are refused later, with their vertex
            verts = piece.verts @ transform[:3, :3].T + transform[:3, 3]
            mirrored = bool(np.linalg.det(transform[:3, :3]) < 0)
        normals = piece.normals
        if normals is not None:
            turn = np.linalg.pinv(transform[:3, :3]) if np.isfinite(transform).all() else np.zeros((3, 3))
            normals = normals.astype(np.float64) @ turn
        self.append(piece._replace(verts=verts, normals=normals), mirrored=mirrored)

    def append(self, piece: PolygonSoup, *, mirrored: bool) -> None:
        """Append a piece as it is, turned if it is mirrored."""
        self._pieces.append(_reversed(piece) if mirrored else piece)

    def spend(self, elements: int, num_bytes: int) -> None:
        """Count elements of a piece, and refuse too many for a file of this size."""
        self._elements += _ELEMENTS_PER_PIECE + elements
        if self._elements > _FREE_ELEMENTS + _ELEMENTS_PER_BYTE * num_bytes:
            raise MeshError("its scene repeats the meshes far more often than a file of this size plausibly does")

    def soup(self) -> PolygonSoup:
        """Return all pieces that have faces; those without any where none has."""
        pieces = self.pieces
        starts = np.cumsum([0, *(len(piece.verts) for piece in pieces)])
        corners = [piece.corners + start for piece, start in zip(pieces, starts, strict=False)]
        return PolygonSoup(
            np.concatenate([np.empty((0, 3)), *(piece.verts for piece in pieces)]),
            np.concatenate([np.empty(0, np.int64), *corners]),
            np.concatenate([np.empty(0, np.int64), *(piece.sizes for piece in pieces)]),
            united(pieces),
            None if any(piece.normals is None for piece in pieces) else _stacked(pieces),
        )

    @property
    def pieces(self) -> list[PolygonSoup]:
        """The pieces that have faces; those without any where none has."""
        return [piece for piece in self._pieces if len(piece.sizes)] or self._pieces


def _stacked(pieces: list[PolygonSoup]) -> NDArray[np.floating] | None:
    """Return the normals of all pieces, unless there are none."""
    normals = [piece.normals for piece in pieces if piece.normals is not None]
    return np.concatenate(normals) if normals else None


def _reversed(piece: PolygonSoup) -> PolygonSoup:
    """Return a piece with the corners of each polygon in reverse order."""
    ends = np.cumsum(piece.sizes)
    order = np.repeat(2 * ends - piece.sizes - 1, piece.sizes) - np.arange(len(piece.corners))
    given = piece.attributes
    corner = {name: values[order] for name, values in given.corner.items()}
    return piece._replace(corners=piece.corners[order], attributes=replace(given, corner=corner) if corner else given)
