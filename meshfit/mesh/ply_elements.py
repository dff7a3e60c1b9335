"""What a PLY file holds, text or binary, element by element: what the header announces, and nothing else."""

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
