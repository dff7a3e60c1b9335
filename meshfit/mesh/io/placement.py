"""Meshes of a scene put where their transforms place them, into one polygon soup."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.memory import require_memory
from meshfit.mesh.io.attribute_union import united
from meshfit.mesh.polygons import PolygonSoup
from meshfit.units import count_text

Matrix = Float64[np.ndarray, "4 4"]

# How much of its meshes the scene of a small file may repeat.
_FREE_ELEMENTS = 2_000_000
_ELEMENTS_PER_BYTE = 100
_ELEMENTS_PER_PIECE = 50
# Memory that placing and cleaning take at least; measured 80 and more.
_LEAST_BYTES_PER_ELEMENT = 60
_UNCHECKED_ELEMENTS = 1_000_000


class PlacedMeshes:
    """The pieces of a scene; one that its transform mirrors is turned, so that its outside stays outside."""

    def __init__(self) -> None:
        self._pieces: list[PolygonSoup] = []
        self._elements, self._checked = 0, 0

    def place(self, piece: PolygonSoup, transform: Matrix, num_bytes: int) -> None:
        """Append a piece under a transform, of columns.

        Args:
            piece: with corners that are valid in it.
            transform: to the scene.
            num_bytes: of the data that was read so far.

        Raises:
            MeshError: the pieces are far more than a file of this size plausibly holds.
        """
        self.spend(elements_of(piece), num_bytes)
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
        """Count elements of a piece, and refuse too many for a file of this size, or for the memory that is there."""
        self._elements += _ELEMENTS_PER_PIECE + elements
        self._require_room(self._elements, num_bytes)

    def require_room(self, elements: int, num_bytes: int) -> None:
        """Refuse further elements that `spend` would refuse, before the first of them is placed."""
        self._require_room(self._elements + elements, num_bytes)

    def _require_room(self, elements: int, num_bytes: int) -> None:
        if elements > _FREE_ELEMENTS + _ELEMENTS_PER_BYTE * num_bytes:
            raise MeshError("its scene repeats the meshes far more often than a file of this size plausibly does")
        if elements > self._checked + _UNCHECKED_ELEMENTS:
            self._checked = elements
            size = f"its scene places {count_text(elements, 'vertex')}, corners and other values"
            require_memory(_LEAST_BYTES_PER_ELEMENT * elements, size, "place fewer copies of its meshes")

    def soup(self) -> PolygonSoup:
        """Return all pieces that have faces; those without any where none has."""
        pieces = self.pieces
        corners, start, first = np.empty(sum(len(piece.corners) for piece in pieces), dtype=np.int64), 0, 0
        for piece in pieces:
            np.add(piece.corners, first, out=corners[start : start + len(piece.corners)])
            start, first = start + len(piece.corners), first + len(piece.verts)
        return PolygonSoup(
            np.concatenate([np.empty((0, 3)), *(piece.verts for piece in pieces)]),
            corners,
            np.concatenate([np.empty(0, np.int64), *(piece.sizes for piece in pieces)]),
            united(pieces),
            None if any(piece.normals is None for piece in pieces) else _stacked(pieces),
        )

    @property
    def pieces(self) -> list[PolygonSoup]:
        """The pieces that have faces; those without any where none has."""
        return [piece for piece in self._pieces if len(piece.sizes)] or self._pieces


def elements_of(piece: PolygonSoup) -> int:
    """Return the number of vertices, corners and values of attributes of a piece."""
    return len(piece.verts) + len(piece.corners) + piece.attributes.num_values


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
