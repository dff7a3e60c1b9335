"""PLY files, text or binary: vertices, faces, edges and vertex properties. Other elements are ignored."""

import itertools
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.curves import Chains, Curves
from meshfit.mesh.io.text import quoted
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size

_CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
_CODES |= {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"}
_CODES |= {"float32": "f", "float64": "d"}
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LARGEST_INDEX = 2**53  # float64 holds every integer up to here

_Row = dict[str, list[int] | list[float]]
_Rows = NDArray[Any] | list[_Row]
"""The rows of an element: a structured array where all have the same shape, else one dictionary each."""


def read_ply(content: bytes) -> PolygonSoup:
    """Read vertices and faces in file order.

    Raises:
        MeshError: the file is damaged; the message names the place.
    """
    soup = PolygonSoup.of_rows([], [])
    for element, rows in _read_elements(content):
        if element.name == "vertex":
            soup = soup._replace(verts=_columns(element, rows, "xyz"))
        elif element.name == "face":
            corners, sizes = _faces(element, rows)
            soup = soup._replace(corners=corners, sizes=sizes)
    return soup


def read_ply_segments(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read (V, 3) vertices and (S, 2) the ends of all `edge` elements, in file order.

    Raises:
        MeshError: the file is damaged; the message names the place.
    """
    verts, ends = np.empty((0, 3)), np.empty((0, 2))
    for element, rows in _read_elements(content):
        if element.name == "vertex":
            verts = _columns(element, rows, "xyz")
        elif element.name == "edge":
            ends = _columns(element, rows, ("vertex1", "vertex2"))
    if not (np.abs(ends) < _LARGEST_INDEX).all() or (ends % 1).any():
        raise MeshError("'edge' has ends that are not vertex indices")
    return verts, ends.astype(np.int64)


def read_ply_property(content: bytes, name: str) -> NDArray[np.float64]:
    """Read (N,) the values of a vertex property, in file order.

    Raises:
        MeshError: there is no such property, it is a list, or the file is damaged.
    """
    for element, rows in _read_elements(content):
        if element.name == "vertex":
            names = [prop.name for prop in element.properties]
            if name not in names:
                raise MeshError(f"its vertices have no property '{name}'; they have {', '.join(names)}")
            if element.properties[names.index(name)].count_code:
                raise MeshError(f"expected one number per vertex, got a list as property '{name}'")
            return _columns(element, rows, [name]).reshape(-1)
    raise MeshError("it has no vertices")


def write_ply(mesh: Mesh | PolygonMesh, normals: NDArray[np.float64] | None = None) -> bytes:
    """Return the bytes of a binary PLY file in double precision, with (V, 3) vertex normals if given."""
    polygons = PolygonMesh.of(mesh)
    points = mesh.verts if normals is None else np.concatenate([mesh.verts, normals], axis=1)
    kind, code = ("uchar", "u1") if polygons.sizes.max(initial=0) < 256 else ("uint", "<u4")
    faces = f"element face {mesh.num_faces}\nproperty list {kind} int vertex_indices\n"
    return _write_points(points, faces) + _face_bytes(polygons, np.dtype(code))


def write_ply_curves(curves: Curves) -> bytes:
    """Return the bytes of a binary PLY file in double precision, with one `edge` element per segment."""
    chains = Chains.of(curves)
    edges = f"element edge {curves.num_segments}\nproperty int vertex1\nproperty int vertex2\n"
    return _write_points(curves.verts, edges) + np.stack([chains.tail, chains.head], axis=1).astype("<i4").tobytes()


def _write_points(points: NDArray[np.float64], other_elements: str) -> bytes:
    """Return the header and the rows of the vertices: x, y, z and perhaps a normal."""
    properties = "".join(f"property double {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz")[: points.shape[1]])
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{properties}{other_elements}end_header\n"
    )
    return header.encode() + points.astype("<f8").tobytes()


def _face_bytes(mesh: PolygonMesh, count: np.dtype[Any]) -> bytes:
    """Return the rows of the faces: the number of corners, then the corners."""
    index = np.dtype("<i4")
    content = np.empty(mesh.num_faces * count.itemsize + len(mesh.corners) * index.itemsize, dtype=np.uint8)
    starts = np.arange(mesh.num_faces) * count.itemsize + mesh.starts * index.itemsize
    is_count = np.zeros(len(content), dtype=bool)
    is_count[(starts[:, None] + np.arange(count.itemsize)).reshape(-1)] = True
    content[is_count] = mesh.sizes.astype(count).view(np.uint8)
    content[~is_count] = mesh.corners.astype(index).view(np.uint8)
    return content.tobytes()


@dataclass(frozen=True)
class _Property:
    """A property of an element, with the `struct` codes of its numbers and, for a list, of their count."""

    name: str
    code: str
    count_code: str = ""


@dataclass(frozen=True)
class _Element:
    """An element that the header announces: its name, its number of rows, and the properties of each row."""

    name: str
    length: int
    properties: list[_Property]


class _TextBody:
    """Reader of the numbers of a text body, one after another."""

    def __init__(self, body: bytes) -> None:
        self._words = iter(body.split())

    def take(self, code: str, count: int) -> list[int] | list[float]:
        """Return the next numbers, all of the kind of that code."""
        words = list(itertools.islice(self._words, count))
        if len(words) < count:
            raise EOFError
        try:
            return [float(word) for word in words] if code in "fd" else [int(word) for word in words]
        except ValueError:
            expected = "numbers" if code in "fd" else "integers"
            raise MeshError(f"expected {expected}, got {quoted(words)}") from None

    def take_rows(self, element: _Element) -> _Rows:
        """Return all rows of an element."""
        return [_read_row(element, self) for _ in range(element.length)]

    def rest(self) -> bytes:
        """Return the remaining content."""
        return b" ".join(self._words)


class _BinaryBody:
    """Reader of the numbers of a binary body, one after another."""

    def __init__(self, body: bytes, byte_order: str) -> None:
        self._body, self._byte_order, self._position = body, byte_order, 0

    def take(self, code: str, count: int) -> list[int] | list[float]:
        """Return the next numbers, all of the kind of that code."""
        shape = f"{self._byte_order}{count}{code}"
        end = self._position + struct.calcsize(shape)
        if end > len(self._body):
            raise EOFError
        numbers = struct.unpack_from(shape, self._body, self._position)
        self._position = end
        return list(numbers)

    def take_rows(self, element: _Element) -> _Rows:
        """Return all rows of an element: at once if its lists are as long in every row as in the first."""
        start = self._position
        first = _read_row(element, self)
        self._position = start
        dtype = np.dtype([field for prop in element.properties for field in self._fields(prop, len(first[prop.name]))])
        if start + dtype.itemsize * element.length <= len(self._body):
            rows = np.frombuffer(self._body, dtype, element.length, start)
            lists = [prop.name for prop in element.properties if prop.count_code]
            if all((rows[f"{name} count"] == len(first[name])).all() for name in lists):
                self._position += dtype.itemsize * element.length
                return rows
        return [_read_row(element, self) for _ in range(element.length)]

    def _fields(self, prop: _Property, length: int) -> list[tuple[str, str, tuple[int, ...]]]:
        fields: list[tuple[str, str, tuple[int, ...]]] = [(prop.name, self._byte_order + prop.code, (length,))]
        return [(f"{prop.name} count", self._byte_order + prop.count_code, ()), *fields] if prop.count_code else fields

    def rest(self) -> bytes:
        """Return the remaining content."""
        return self._body[self._position :].strip()


def _read_elements(content: bytes) -> Iterator[tuple[_Element, _Rows]]:
    """Yield each element of a file with its rows; refuse anything after the last one."""
    head, end, body = content.partition(b"end_header")
    if not content.startswith(b"ply"):
        raise MeshError("it does not start with 'ply'")
    if not end:
        raise MeshError("its header has no 'end_header'")
    byte_order, elements = _parse_header(head)
    line_end = b"\r\n" if body.startswith(b"\r\n") else body[:1]
    body = body[len(line_end) :]
    numbers = _BinaryBody(body, byte_order) if byte_order else _TextBody(body)
    for element in elements:
        try:
            rows = numbers.take_rows(element) if element.properties and element.length else []
        except EOFError:
            raise MeshError(f"the file ends within '{element.name}', of which it announces {element.length}") from None
        yield element, rows
    if numbers.rest():
        raise MeshError("more data than its header announces")


def _parse_header(head: bytes) -> tuple[str, list[_Element]]:
    byte_order, elements = None, list[_Element]()
    for line in head.decode("latin-1").splitlines():
        match line.split():
            case ["format", name, *_] if name in _BYTE_ORDERS:
                byte_order = _BYTE_ORDERS[name]
            case ["element", name, length] if length.isdecimal():
                elements.append(_Element(name, int(length), []))
            case ["property", "list", count, kind, name] if elements and count in _CODES and kind in _CODES:
                elements[-1].properties.append(_Property(name, _CODES[kind], _CODES[count]))
            case ["property", kind, name] if elements and kind in _CODES:
                elements[-1].properties.append(_Property(name, _CODES[kind]))
            case [] | ["ply" | "comment" | "obj_info", *_]:
                pass
            case _:
                raise MeshError(f"unexpected line in its header: {line[:60]!r}")
    if byte_order is None:
        raise MeshError("its header has no 'format' line")
    return byte_order, elements


def _read_row(element: _Element, numbers: _TextBody | _BinaryBody) -> _Row:
    row = {}
    for prop in element.properties:
        count = int(numbers.take(prop.count_code, 1)[0]) if prop.count_code else 1
        if count < 0:
            raise MeshError(f"'{element.name}' has a list of {count} entries")
        row[prop.name] = numbers.take(prop.code, count)
    return row


def _columns(element: _Element, rows: _Rows, names: Iterable[str]) -> NDArray[np.float64]:
    """Return (N, K) the values of some properties; float64 holds every kind of number exactly."""
    columns = [_property_name(element, name) for name in names]
    if isinstance(rows, np.ndarray):
        return np.concatenate([rows[name] for name in columns], axis=1).astype(np.float64)
    return np.array([[float(row[name][0]) for name in columns] for row in rows], np.float64).reshape(-1, len(columns))


def _faces(element: _Element, rows: _Rows) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners of all faces in a row, and the size of each face."""
    name = _property_name(element, "vertex_indices", "vertex_index")
    if isinstance(rows, np.ndarray):
        corners = rows[name].astype(np.int64)
        return corners.reshape(-1), np.full(len(corners), checked_face_size(corners.shape[1]))
    sizes = np.array([checked_face_size(len(row[name])) for row in rows], dtype=np.int64)
    return np.array([int(corner) for row in rows for corner in row[name]], dtype=np.int64), sizes


def _property_name(element: _Element, *names: str) -> str:
    """Return the first of these names that the element has."""
    present = [prop.name for prop in element.properties if prop.name in names]
    if not present and element.length:
        raise MeshError(f"'{element.name}' has no property '{names[0]}'")
    return present[0] if present else names[0]
