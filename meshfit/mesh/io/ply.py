"""What a PLY file holds, text or binary, element by element: what the header announces, and nothing else."""

import itertools
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size, polygon_soup

_CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
_SIZED = {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}
_CODES |= _SIZED | {"float64": "d"}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """A property of an element: its name, and struct's codes of its numbers and, of a list, of their count."""

    name: str
    code: str
    count_code: str = ""


@dataclass(frozen=True)
class Element:
    """An element that the header announces: its name, how many rows it has, and of what."""

    name: str
    length: int
    properties: list[Property]


Rows = NDArray[Any] | list[dict[str, list[int] | list[float]]]
"""The rows of an element: a structured array where all are alike, else one by one."""


class _Text:
    """The numbers of a text body, in turn."""

    def __init__(self, body: bytes) -> None:
        self._words = iter(body.split())

    def take(self, code: str, count: int) -> list[int] | list[float]:
        """The next numbers, all of the kind of that code."""
        words = list(itertools.islice(self._words, count))
        if len(words) < count:
            raise EOFError
        return [float(word) for word in words] if code in "fd" else [int(word) for word in words]

    def rest(self) -> bytes:
        """What is left."""
        return b" ".join(self._words)


class _Binary:
    """The numbers of a binary body, in turn."""

    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order, self._at = body, order, 0

    def take(self, code: str, count: int) -> list[int] | list[float]:
        """The next numbers, all of the kind of that code."""
        shape = f"{self._order}{count}{code}"
        end = self._at + struct.calcsize(shape)
        if end > len(self._body):
            raise EOFError
        found = struct.unpack_from(shape, self._body, self._at)
        self._at = end
        return list(found)

    def take_alike(self, element: Element) -> NDArray[Any] | None:
        """All rows of an element at once, if they are alike: its lists as long in every row as in the first."""
        start = self._at
        first = _read_row(element, self)
        self._at = start
        shape = [field for one in element.properties for field in self._fields(one, len(first[one.name]))]
        table = np.dtype(shape)
        if start + table.itemsize * element.length > len(self._body):
            return None
        rows = np.frombuffer(self._body, table, element.length, start)
        if any(
            (rows[f"{one.name} count"] != len(first[one.name])).any() for one in element.properties if one.count_code
        ):
            return None
        self._at += table.itemsize * element.length
        return rows

    def _fields(self, one: Property, length: int) -> list[tuple[str, str, tuple[int, ...]]]:
        fields: list[tuple[str, str, tuple[int, ...]]] = [(one.name, self._order + one.code, (length,))]
        return [(f"{one.name} count", self._order + one.count_code, ()), *fields] if one.count_code else fields

    def rest(self) -> bytes:
        """What is left."""
        return self._body[self._at :].strip()


def elements_of(content: bytes) -> Iterator[tuple[Element, Rows]]:
    """Each element of a file with its rows; after the last one there must be nothing.

    Raises:
        ValueError: saying where the file is at fault.
    """
    head, end, body = content.partition(b"end_header")
    if not content.startswith(b"ply"):
        raise ValueError("it does not start with 'ply'")
    if not end:
        raise ValueError("its header has no 'end_header'")
    order, elements = _parse_header(head)
    line_end = b"\r\n" if body.startswith(b"\r\n") else body[:1]
    body = body[len(line_end) :]
    numbers = _Binary(body, order) if order else _Text(body)
    for element in elements:
        try:
            rows = _read_rows(element, numbers)
        except EOFError:
            raise ValueError(f"the file ends within '{element.name}', of which it announces {element.length}") from None
        yield element, rows
    if numbers.rest():
        raise ValueError("more data than its header announces")


def _parse_header(head: bytes) -> tuple[str, list[Element]]:
    order, elements = None, list[Element]()
    for line in head.decode("latin-1").splitlines():
        match line.split():
            case ["format", name, *_] if name in _FORMATS:
                order = _FORMATS[name]
            case ["element", name, length] if length.isdecimal():
                elements.append(Element(name, int(length), []))
            case ["property", "list", count, kind, name] if elements and count in _CODES and kind in _CODES:
                elements[-1].properties.append(Property(name, _CODES[kind], _CODES[count]))
            case ["property", kind, name] if elements and kind in _CODES:
                elements[-1].properties.append(Property(name, _CODES[kind]))
            case [] | ["ply" | "comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header has the line {line[:60]!r}")
    if order is None:
        raise ValueError("its header has no 'format' line")
    return order, elements


def _read_rows(element: Element, numbers: _Text | _Binary) -> Rows:
    if not element.properties or not element.length:
        return []
    table = numbers.take_alike(element) if isinstance(numbers, _Binary) else None
    return table if table is not None else [_read_row(element, numbers) for _ in range(element.length)]


def _read_row(element: Element, numbers: _Text | _Binary) -> dict[str, list[int] | list[float]]:
    row = {}
    for one in element.properties:
        count = int(numbers.take(one.count_code, 1)[0]) if one.count_code else 1
        if count < 0:
            raise ValueError(f"'{element.name}' has a list of {count} entries")
        row[one.name] = numbers.take(one.code, count)
    return row


_LARGEST_INDEX = 2**53


def read_ply(content: bytes) -> PolygonSoup:
    """Verts and faces of a PLY file, in its order; whatever else it holds is passed over.

    Raises:
        ValueError: saying where the file is at fault.
    """
    found = polygon_soup([], [])
    for element, rows in elements_of(content):
        if element.name == "vertex":
            found = found._replace(verts=_points(element, rows))
        elif element.name == "face":
            corners, sizes = _faces(element, rows)
            found = found._replace(corners=corners, sizes=sizes)
    return found


def read_ply_segments(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(V, 3) verts and (S, 2) the ends of the `edge` elements of a PLY file, in its order; faces are passed over.

    Raises:
        ValueError: saying where the file is at fault.
    """
    verts, ends = np.empty((0, 3)), np.empty((0, 2))
    for element, rows in elements_of(content):
        if element.name == "vertex":
            verts = _points(element, rows)
        elif element.name == "edge":
            ends = _columns(element, rows, ("vertex1", "vertex2"))
    if not (np.abs(ends) < _LARGEST_INDEX).all() or (ends % 1).any():
        raise ValueError("'edge' has ends that are not indices of verts")
    return verts, ends.astype(np.int64)


def read_ply_property(content: bytes, name: str) -> NDArray[np.float64]:
    """(N,) the values of a property of the verts of a PLY file, in its order.

    Raises:
        ValueError: it has no such property, one that is a list, or is at fault.
    """
    for element, rows in elements_of(content):
        if element.name == "vertex":
            found = next((one for one in element.properties if one.name == name), None)
            if found is None:
                there = ", ".join(one.name for one in element.properties)
                raise ValueError(f"its verts have no property '{name}'; they have {there}")
            if found.count_code:
                raise ValueError(f"the property '{name}' is a list; a number for each vertex is needed")
            if isinstance(rows, np.ndarray):
                return np.asarray(rows[name], dtype=np.float64).reshape(-1)
            return np.array([float(row[name][0]) for row in rows], dtype=np.float64)
    raise ValueError("it has no verts")


def write_ply(mesh: Mesh | PolygonMesh, normals: NDArray[np.float64] | None = None) -> bytes:
    """The bytes of a PLY file: binary, in double precision, with (V, 3) normals of its verts if given."""
    whole = PolygonMesh.of(mesh)
    points = mesh.verts if normals is None else np.concatenate([mesh.verts, normals], axis=1)
    names = ("x", "y", "z", "nx", "ny", "nz")[: points.shape[1]]
    declared = "".join(f"property double {name}\n" for name in names)
    kind, code = ("uchar", "u1") if whole.sizes.max(initial=0) < 256 else ("uint", "<u4")
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {mesh.num_verts}\n{declared}"
        f"element face {mesh.num_faces}\nproperty list {kind} int vertex_indices\nend_header\n"
    )
    return header.encode() + points.astype("<f8").tobytes() + _face_bytes(whole, np.dtype(code))


def _face_bytes(mesh: PolygonMesh, count: np.dtype[Any]) -> bytes:
    """Of each face how many corners it has, and which."""
    index = np.dtype("<i4")
    content = np.empty(mesh.num_faces * count.itemsize + len(mesh.corners) * index.itemsize, dtype=np.uint8)
    starts = np.arange(mesh.num_faces) * count.itemsize + mesh.starts * index.itemsize
    is_count = np.zeros(len(content), dtype=bool)
    is_count[(starts[:, None] + np.arange(count.itemsize)).reshape(-1)] = True
    content[is_count] = mesh.sizes.astype(count).view(np.uint8)
    content[~is_count] = mesh.corners.astype(index).view(np.uint8)
    return content.tobytes()


def _points(element: Element, rows: Rows) -> NDArray[np.float64]:
    return _columns(element, rows, "xyz")


def _columns(element: Element, rows: Rows, names: Iterable[str]) -> NDArray[np.float64]:
    """(N, K) the numbers of some properties, which float64 holds exactly whatever their kind."""
    found = [_property(element, name) for name in names]
    if isinstance(rows, np.ndarray):
        return np.concatenate([rows[name] for name in found], axis=1).astype(np.float64)
    return np.array([[float(row[name][0]) for name in found] for row in rows], np.float64).reshape(-1, len(found))


def _faces(element: Element, rows: Rows) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    name = _property(element, "vertex_indices", "vertex_index")
    if isinstance(rows, np.ndarray):
        corners = rows[name].astype(np.int64)
        return corners.reshape(-1), np.full(len(corners), checked_face_size(corners.shape[1]))
    sizes = np.array([checked_face_size(len(row[name])) for row in rows], dtype=np.int64)
    return np.array([int(corner) for row in rows for corner in row[name]], dtype=np.int64), sizes


def _property(element: Element, *names: str) -> str:
    found = [one.name for one in element.properties if one.name in names]
    if not found and element.length:
        raise ValueError(f"'{element.name}' has no property '{names[0]}'")
    return found[0] if found else names[0]
