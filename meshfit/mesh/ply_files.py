"""PLY, text or binary, with polygons of any sizes; what the header announces has to be there, and nothing else."""

import itertools
import struct
from dataclasses import dataclass

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import Arrays, arrays, fan

_CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
_SIZED = {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}
_CODES |= _SIZED | {"float64": "d"}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Property:
    name: str
    code: str
    count_code: str = ""


@dataclass(frozen=True)
class _Element:
    name: str
    length: int
    properties: list[_Property]


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

    def rest(self) -> bytes:
        """What is left."""
        return self._body[self._at :].strip()


def read_ply(content: bytes) -> Arrays:
    """Verts and faces of a PLY file, in its order; whatever else it holds is passed over.

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
    verts: list[list[float]] = []
    faces: list[list[int]] = []
    for element in elements:
        try:
            for _ in range(element.length if element.properties else 0):
                row = _read_row(element, numbers)
                if element.name == "vertex":
                    verts.append([row[axis][0] for axis in "xyz"])
                elif element.name == "face":
                    faces += fan([int(corner) for corner in _corners(row)])
        except EOFError:
            raise ValueError(f"the file ends within '{element.name}', of which it announces {element.length}") from None
        except KeyError as error:
            raise ValueError(f"'{element.name}' has no property {error}") from None
    if numbers.rest():
        raise ValueError("more data than its header announces")
    return arrays(verts, faces)


def write_ply(mesh: Mesh) -> bytes:
    """The bytes of a PLY file: binary, in double precision."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {mesh.num_verts}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {mesh.num_faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(mesh.num_faces, dtype=[("count", "u1"), ("index", "<i4", 3)])
    rows["count"], rows["index"] = 3, mesh.faces
    return header.encode() + mesh.verts.astype("<f8").tobytes() + rows.tobytes()


def _parse_header(head: bytes) -> tuple[str, list[_Element]]:
    order, elements = None, list[_Element]()
    for line in head.decode("latin-1").splitlines():
        match line.split():
            case ["format", name, *_] if name in _FORMATS:
                order = _FORMATS[name]
            case ["element", name, length] if length.isdecimal():
                elements.append(_Element(name, int(length), []))
            case ["property", "list", count, kind, name] if elements and count in _CODES and kind in _CODES:
                elements[-1].properties.append(_Property(name, _CODES[kind], _CODES[count]))
            case ["property", kind, name] if elements and kind in _CODES:
                elements[-1].properties.append(_Property(name, _CODES[kind]))
            case [] | ["ply" | "comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header has the line {line[:60]!r}")
    if order is None:
        raise ValueError("its header has no 'format' line")
    return order, elements


def _read_row(element: _Element, numbers: _Text | _Binary) -> dict[str, list[float]]:
    row = {}
    for one in element.properties:
        count = int(numbers.take(one.count_code, 1)[0]) if one.count_code else 1
        if count < 0:
            raise ValueError(f"'{element.name}' has a list of {count} entries")
        row[one.name] = numbers.take(one.code, count)
    return row


def _corners(row: dict[str, list[float]]) -> list[int] | list[float]:
    return row["vertex_index"] if "vertex_index" in row else row["vertex_indices"]
