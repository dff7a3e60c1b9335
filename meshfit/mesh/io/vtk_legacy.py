"""Legacy VTK files (`.vtk`) of poly data and unstructured grids, text or binary."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.io.vtk_cells import Cells, surface
from meshfit.mesh.io.vtk_xml import read_vtk_xml
from meshfit.mesh.polygons import PolygonSoup

_TYPES = {
    "char": "i1", "signed_char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2", "int": "i4",
    "unsigned_int": "u4", "long": "i8", "unsigned_long": "u8", "float": "f4", "double": "f8", "vtkidtype": "i4",
    "vtktypeint64": "i8", "vtktypeuint64": "u8", "vtktypeint32": "i4",
}  # fmt: skip
_CELLS = {"VERTICES": "verts", "LINES": "lines", "POLYGONS": "polygons", "TRIANGLE_STRIPS": "strips"}
_LONGEST = 40


def read_vtk(content: bytes) -> PolygonSoup:
    """Read the polygons and triangle strips of a VTK file, legacy or XML; of one without them, points and normals.

    Raises:
        MeshError: a damaged file, another kind of data, or a volume mesh.

    Warns:
        MeshfitWarning: with the number of cells that are passed over.
    """
    if content.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<"):
        return read_vtk_xml(content)
    return _Reader(content).read()


class _Reader:
    """The content, and the place up to which it was read."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._place = 0
        head = self._line()
        self._line()
        form = self._line().strip().upper()
        if not head.lower().startswith("# vtk datafile") or form not in {"ASCII", "BINARY"}:
            raise MeshError("expected '# vtk DataFile', a title, and 'ASCII' or 'BINARY'")
        self._binary = form == "BINARY"
        self._verts: NDArray[np.float64] | None = None
        self._pieces = [Cells.of_type(np.empty(0, np.int64), np.empty(0, np.int64), "verts")]
        self._grid: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None
        version = head.split()[-1]
        self._with_offsets = version.partition(".")[0].isdigit() and int(version.partition(".")[0][:4]) >= 5

    def read(self) -> PolygonSoup:
        """Return the surface."""
        sections: dict[str, Callable[[list[str]], object]] = {
            "DATASET": _require_dataset,
            "POINTS": self._read_points,
            "CELLS": self._read_grid,
            "CELL_TYPES": self._read_types,
            "FIELD": self._field,
            "METADATA": self._skip_metadata,
        }
        sections |= dict.fromkeys(_CELLS, self._read_cells)
        words = self._next_words()
        while words and words[0].upper() not in {"POINT_DATA", "CELL_DATA"}:
            section = sections.get(words[0].upper())
            if section is None:
                raise MeshError(f"expected a section such as POINTS or POLYGONS, got {_shown(words[0])}")
            section(words)
            words = self._next_words()
        if self._verts is None:
            raise MeshError("no POINTS in it")
        if self._grid is not None:
            raise MeshError("CELLS without CELL_TYPES; cut short")
        soup = surface(self._verts, self._pieces)
        if len(soup.sizes) or not words or words[0].upper() != "POINT_DATA":
            return soup
        with suppress(MeshError):  # no other data of points matters
            return soup._replace(normals=self._normals(len(self._verts)))
        return soup

    def _normals(self, count: int) -> NDArray[np.float64] | None:
        """Return (V, 3) the normals among the data of points; None if there are none."""
        while (words := self._next_words()) and words[0].upper() != "CELL_DATA":
            arrays = self._data_of_points(words, count)
            found = next((values for name, values in arrays.items() if name.lower() == "normals"), None)
            if found is not None and found.size == 3 * count:
                return found.astype(np.float64).reshape(-1, 3)
        return None

    def _data_of_points(self, words: list[str], count: int) -> dict[str, NDArray[Any]]:
        """Read a section of the data of points; return its arrays by name, normals as `normals`."""
        match words[0].upper():
            case "FIELD":
                return self._field(words)
            case "METADATA":
                self._skip_metadata([])
            case "NORMALS" | "VECTORS":
                values = self._numbers(3 * count, _dtype(words, 2), words[0])
                return {words[0]: values}
            case "TENSORS":
                self._numbers(9 * count, _dtype(words, 2), words[0])
            case "SCALARS":
                place = self._place
                if (self._next_words() or [""])[0].upper() != "LOOKUP_TABLE":
                    self._place = place
                self._numbers((_count(words, 3) if len(words) > 3 else 1) * count, _dtype(words, 2), words[0])
            case "COLOR_SCALARS":
                self._numbers(_count(words, 2) * count, self._colours, words[0])
            case "LOOKUP_TABLE":
                self._numbers(4 * _count(words, 2), self._colours, words[0])
            case "TEXTURE_COORDINATES":
                self._numbers(_count(words, 2) * count, _dtype(words, 3), words[0])
            case other:
                raise MeshError(f"expected data of points, got {_shown(other)}")
        return {}

    @property
    def _colours(self) -> np.dtype[Any]:
        return np.dtype("u1" if self._binary else "f4")

    def _read_points(self, words: list[str]) -> None:
        numbers = self._numbers(3 * _count(words, 1), _dtype(words, 2), "POINTS")
        self._verts = numbers.astype(np.float64).reshape(-1, 3)

    def _read_cells(self, words: list[str]) -> None:
        self._pieces.append(Cells.of_type(*self._cells(words), _CELLS[words[0].upper()]))

    def _read_grid(self, words: list[str]) -> None:
        self._grid = self._cells(words)

    def _read_types(self, words: list[str]) -> None:
        types = self._numbers(_count(words, 1), np.dtype("i4"), "CELL_TYPES").astype(np.int64)
        if self._grid is None or len(types) != len(self._grid[1]):
            raise MeshError(f"{len(types)} cell types, but {0 if self._grid is None else len(self._grid[1])} cells")
        self._pieces.append(Cells(*self._grid, types))
        self._grid = None

    def _cells(self, words: list[str]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        keyword, count, total = words[0].upper(), _count(words, 1), _count(words, 2)
        if self._with_offsets:
            return self._cells_by_offsets(keyword, count, total)
        numbers = self._numbers(total, np.dtype("i4"), keyword).astype(np.int64)
        return _split(numbers, count, keyword)

    def _cells_by_offsets(self, keyword: str, count: int, total: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Read cells as version 5 has them: one offset more than cells, then all corners."""
        arrays = []
        for name, length in (("OFFSETS", count), ("CONNECTIVITY", total)):
            words = self._next_words()
            if not words or words[0].upper() != name:
                raise MeshError(f"{keyword}: expected {name}, got {_shown(words[0]) if words else 'the end'}")
            arrays.append(self._numbers(length, _dtype(words, 1), keyword).astype(np.int64))
        offsets, corners = arrays
        sizes = np.diff(offsets)
        if len(offsets) and (offsets[0] != 0 or offsets[-1] != total or (sizes < 0).any()):
            raise MeshError(f"{keyword}: expected offsets that rise from 0 to {total}")
        if not len(offsets) and total:
            raise MeshError(f"{keyword}: {total} corners without offsets")
        return corners, sizes

    def _field(self, words: list[str]) -> dict[str, NDArray[Any]]:
        """Return the arrays of a field by name, each with one row per element."""
        arrays = {}
        for _ in range(_count(words, 2)):
            array = self._next_words()
            if not array:
                raise MeshError("cut short within FIELD")
            if len(array) == 1 and array[0].upper() == "METADATA":
                self._skip_metadata([])
                array = self._next_words() or [""]
            kind = array[3].lower() if len(array) > 3 else ""
            if kind not in _TYPES:
                raise MeshError("FIELD: expected arrays of numbers, each with a name, two counts and a type")
            width, rows = _count(array, 1), _count(array, 2)
            values = self._numbers(width * rows, np.dtype(_TYPES[kind]), "FIELD")
            arrays[array[0]] = values.reshape(rows, width)
        return arrays

    def _skip_metadata(self, _: list[str]) -> None:
        while self._place < len(self._content) and self._line().strip():
            pass

    def _numbers(self, count: int, dtype: np.dtype[Any], where: str) -> NDArray[Any]:
        """Return the next numbers, in the byte order of the file or as text."""
        if self._binary:
            end = self._place + count * dtype.itemsize
            if end > len(self._content):
                available = (len(self._content) - self._place) // dtype.itemsize
                raise MeshError(f"{where}: cut short: announces {count} numbers, but {available} are left")
            values = np.frombuffer(self._content, dtype.newbyteorder(">"), count, self._place)
            self._place = end
            return values
        if count > len(self._content) - self._place:
            raise MeshError(f"{where}: cut short: announces {count} numbers, more than the file can hold")
        return self._text_numbers(count, dtype, where)

    def _text_numbers(self, count: int, dtype: np.dtype[Any], where: str) -> NDArray[Any]:
        words: list[bytes] = []
        while len(words) < count:
            # Most numbers with their blank are shorter than this, so that one or two pieces hold them all.
            end = self._content.find(b"\n", self._place + 12 * (count - len(words)))
            end = len(self._content) if end < 0 else end
            piece = self._content[self._place : end].split(None, count - len(words))
            rest = piece.pop() if len(piece) > count - len(words) else b""
            words += piece
            if end == len(self._content) and len(words) < count:
                raise MeshError(f"{where}: cut short: announces {count} numbers, but {len(words)} are left")
            self._place = end - len(rest)
        try:
            if dtype.kind == "f":
                return np.array(words, dtype=np.float64) if words else np.empty(0)
            return np.array([int(word) for word in words], dtype=np.int64)
        except (ValueError, OverflowError):
            raise MeshError(f"{where}: expected {count} numbers, got a word that is none") from None

    def _next_words(self) -> list[str]:
        """Return the words of the next line that has some; none at the end."""
        while self._place < len(self._content):
            if words := self._line().split():
                return words
        return []

    def _line(self) -> str:
        end = self._content.find(b"\n", self._place)
        end = len(self._content) if end < 0 else end
        line = self._content[self._place : end]
        self._place = end + 1
        return line[:1000].decode("ascii", "replace")


def _split(numbers: NDArray[np.int64], count: int, where: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners and the sizes of cells that each begin with their size."""
    if (
        0 < count <= len(numbers)
        and len(numbers) % count == 0
        and (numbers[:: len(numbers) // count] == len(numbers) // count - 1).all()
    ):
        width = len(numbers) // count
        return np.delete(numbers.reshape(-1, width), 0, axis=1).reshape(-1), np.full(count, width - 1)
    heads: list[int] = []
    place, values = 0, numbers.tolist()
    for _ in range(count):
        if place >= len(values) or values[place] < 0:
            raise MeshError(f"{where}: announces {count} cells, but its numbers hold {len(heads)}")
        heads.append(place)
        place += values[place] + 1
    if place != len(values):
        raise MeshError(f"{where}: announces {len(values)} numbers, but its cells take {place}")
    return np.delete(numbers, heads), numbers[heads]


def _require_dataset(words: list[str]) -> None:
    kind = words[1].upper() if len(words) > 1 else "nothing"
    if kind not in {"POLYDATA", "UNSTRUCTURED_GRID"}:
        raise MeshError(
            f"expected a data set POLYDATA or UNSTRUCTURED_GRID, got {_shown(kind)}; extract a surface from it, for "
            "example with ParaView's filter Extract Surface"
        )


def _count(words: list[str], place: int) -> int:
    word = words[place] if len(words) > place else "nothing"
    if not (word.isascii() and word.isdigit() and len(word) < 16):
        raise MeshError(f"{words[0][:_LONGEST]}: expected a number of elements, got {_shown(word)}")
    return int(word)


def _dtype(words: list[str], place: int) -> np.dtype[Any]:
    word = words[place] if len(words) > place else "nothing"
    if word.lower() not in _TYPES:
        raise MeshError(f"{words[0][:_LONGEST]}: expected a type such as float, got {_shown(word)}")
    return np.dtype(_TYPES[word.lower()])


def _shown(text: str) -> str:
    return repr(text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…")
