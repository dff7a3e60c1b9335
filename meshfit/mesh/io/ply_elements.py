"""Elements of PLY files, text or binary: the header, and rows whose columns are converted when they are asked for."""

import re
import struct
import warnings
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.text import BYTE_ORDER_MARK, parse_float, parse_floats, quoted
from meshfit.units import count_text

_CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
_CODES |= {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"}
_CODES |= {"int64": "q", "uint64": "Q", "float32": "f", "float64": "d"}
_REAL = "fd"
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_FIRST_LINE = re.compile(rb"ply[ \t]*(\r\n|\n|\r)")
_LAST_LINE = re.compile(rb"[\r\n][ \t]*end_header[ \t]*(\r\n|\n|\r|$)")
_MOST_DIGITS = 15

_Offsets = NDArray[np.int64]


@dataclass(frozen=True)
class Property:
    """A property of an element, with the `struct` codes of its numbers and, for a list, of their count."""

    name: str
    code: str
    count_code: str = ""


@dataclass(frozen=True)
class Element:
    """An element of the header: its name, the announced number of rows, and its properties."""

    name: str
    length: int
    properties: list[Property] = field(default_factory=list)

    @property
    def integer_lists(self) -> list[str]:
        """The names of its lists of integers."""
        return [prop.name for prop in self.properties if prop.count_code and prop.code not in _REAL]


@runtime_checkable
class _Body(Protocol):
    """The numbers after a header. Offsets and widths count bytes in a binary body, words in a text."""

    size: int

    def width(self, code: str, /) -> int:
        """Return the width of a number of the kind of that code."""

    def count_at(self, offset: int, code: str, /) -> int:
        """Return the length of a list, which is at this offset."""

    def at(self, offsets: _Offsets, code: str, /) -> NDArray[Any]:
        """Return the numbers at these offsets."""

    def block(self, start: int, stride: int, rows: int, count: int, code: str, /) -> NDArray[Any]:
        """Return (rows, count) consecutive numbers, with a stride from row to row."""

    def rest(self, offset: int) -> bytes:
        """Return the content from an offset on; refuse a text that goes on there in the middle of a line."""


class _Column(NamedTuple):
    """A property, how many lists of the row are before it, and its offset from the end of the last of them."""

    prop: Property
    lists: int
    offset: int


class Rows:
    """The rows of an element in the body of a file. Columns are converted when they are asked for.

    Attributes:
        element: whose rows they are.
        uniform: whether the lists of all rows are as long as those of the first.
        end: offset of their end in the body.
    """

    def __init__(self, element: Element, body: _Body, start: int) -> None:
        self.element, self._body = element, body
        self._columns, self._after_lists = self._layout()
        length = element.length if element.properties else 0
        first = self._walk(start, min(length, 1))
        self._stride = int(first[0, -1]) + self._after_lists - start if length else 0
        self.uniform = self._is_uniform(first)
        self._ends = first if self.uniform else self._walk(start, length)
        self.end = start + length * self._stride if self.uniform else int(self._ends[-1, -1]) + self._after_lists

    def numbers(self, *names: str) -> NDArray[np.float64]:
        """Return (N, K) the values of some properties.

        Raises:
            MeshError: there is no such property, it is a list, or a value is not a number.
        """
        if not self.element.length:
            return np.empty((0, len(names)))
        columns = [self._column(name) for name in names]
        for column in columns:
            if column.prop.count_code:
                name = column.prop.name
                raise MeshError(f"expected one number per '{self.element.name}', got a list as property '{name}'")
        with np.errstate(invalid="ignore"):  # of signalling NaN
            return np.stack([self._values(column).astype(np.float64) for column in columns], axis=1)

    def column(self, name: str) -> NDArray[Any]:
        """Return (N,) the values of a property in its own type; those of a text that are out of its range, as float64.

        Raises:
            MeshError: a value is not a number.
        """
        column = self._column(name)
        dtype = np.dtype(column.prop.code)
        if not self.element.length:
            return np.empty(0, dtype)
        values = self._values(column)
        if values.dtype.kind == dtype.kind:
            with np.errstate(invalid="ignore", over="ignore"):
                return values.astype(dtype)
        limits = np.iinfo(dtype)
        with np.errstate(invalid="ignore"):  # of an infinite number
            fits = ((values >= limits.min) & (values <= limits.max) & (values % 1 == 0)).all()
        return values.astype(dtype) if fits else values.astype(np.float64)

    def lists(self, *names: str) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """Return the entries of all lists in a row, and (N,) their lengths, of the first of the names that is there.

        Raises:
            MeshError: there is no such property, it is not a list, or an entry is not a number.
        """
        if not self.element.length:
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        prop, lists, offset = self._column(*names)
        if not prop.count_code:
            raise MeshError(f"expected a list as property '{prop.name}' of '{self.element.name}', got one number")
        starts, width = self._ends[:, lists] + offset + self._body.width(prop.count_code), self._body.width(prop.code)
        sizes = (self._ends[:, lists + 1] - starts) // width
        if self.uniform:
            length = self.element.length
            entries = self._body.block(int(starts[0]), self._stride, length, int(sizes[0]), prop.code)
            return entries.reshape(-1), np.repeat(sizes, length)
        within = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        return self._body.at(np.repeat(starts, sizes) + within * width, prop.code), sizes

    @property
    def widths(self) -> NDArray[np.int64]:
        """(N,) the width of each row in the body; (0,) of an element without properties."""
        if self.uniform:
            return np.full(self.element.length if self._stride else 0, self._stride)
        return np.asarray(np.diff(self._ends[:, 0], append=self.end))

    def further(self) -> int:
        """Return how many more rows, without empty lists, fill the rest of the body exactly; 0 if none do."""
        at, count = self.end, 0
        while at < self._body.size:
            try:
                ends = self._walk(at, 1)[0]
            except MeshError:
                return 0
            if len(ends) > 1 and ends[-1] + self._after_lists - at == self._least:
                return 0
            at, count = int(ends[-1]) + self._after_lists, count + 1
        return count

    @property
    def _least(self) -> int:
        """The width of a row whose lists are empty."""
        return sum(self._body.width(prop.count_code or prop.code) for prop in self.element.properties)

    def _layout(self) -> tuple[list[_Column], int]:
        columns, lists, offset = [], 0, 0
        for prop in self.element.properties:
            columns.append(_Column(prop, lists, offset))
            offset += self._body.width(prop.code)
            if prop.count_code:
                lists, offset = lists + 1, 0
        return columns, offset

    def _walk(self, start: int, count: int) -> _Offsets:
        """Return (count, L + 1) the start of each row, and the end of each of its L lists."""
        body, element = self._body, self.element
        lists = [(offset, prop) for prop, _, offset in self._columns if prop.count_code]
        widths = [(offset, p.count_code, body.width(p.count_code), body.width(p.code)) for offset, p in lists]
        cut_short = MeshError(f"the file ends within '{element.name}', of which it announces {element.length}")
        if start + count * self._least > body.size:
            raise cut_short
        ends, at = list[int](), start
        for _ in range(count):
            ends.append(at)
            for offset, code, count_width, width in widths:
                at += offset
                if at + count_width > body.size:
                    raise cut_short
                length = body.count_at(at, code)
                if length < 0:
                    raise MeshError(f"'{element.name}' has a list of {length} entries")
                at += count_width + length * width
                ends.append(at)
            at += self._after_lists
            if at > body.size:
                raise cut_short
        return np.array(ends, dtype=np.int64).reshape(count, len(widths) + 1)

    def _is_uniform(self, first: _Offsets) -> bool:
        """Return whether the lists of all rows are as long as those of the first."""
        if not len(first):
            return True
        if int(first[0, 0]) + self._stride * self.element.length > self._body.size:
            return False
        for prop, lists, offset in self._columns:
            if prop.count_code:
                start = int(first[0, lists]) + offset
                try:
                    counts = self._body.block(start, self._stride, self.element.length, 1, prop.count_code)
                except MeshError:  # a word that is not a number, which may lie in no list if the lists differ
                    return False
                if not (counts == counts[0]).all():
                    return False
        return True

    def _values(self, column: _Column) -> NDArray[Any]:
        starts = self._ends[:, column.lists] + column.offset
        if self.uniform:
            return self._body.block(int(starts[0]), self._stride, self.element.length, 1, column.prop.code).reshape(-1)
        return self._body.at(starts, column.prop.code)

    def _column(self, *names: str) -> _Column:
        """Return the first of these properties that is there."""
        present = [column for name in names for column in self._columns if column.prop.name == name]
        if not present:
            others = ", ".join(prop.name for prop in self.element.properties) or "none"
            raise MeshError(f"'{self.element.name}' has no property '{names[0]}'; it has {others}")
        if len(present) > 1 and present[0].prop.name == present[1].prop.name:
            raise MeshError(f"'{self.element.name}' has two properties '{present[0].prop.name}'")
        return present[0]


class Ply(NamedTuple):
    """The content of a PLY file: the rows of each element by its name, and the words of each comment."""

    rows: dict[str, Rows]
    comments: list[list[str]]


def read_elements(content: bytes) -> Ply:
    """Find the rows of each element.

    Raises:
        MeshError: the file is damaged, or holds other than its header announces.

    Warns:
        MeshfitWarning: of bytes after the last row.
    """
    content = content.removeprefix(BYTE_ORDER_MARK)
    first, last = _header(content)
    # A file whose lines end in CR may have a binary body that begins with the byte of LF.
    end = last.start(1) + (1 if first[1] == b"\r" else len(last[1]))
    byte_order, elements, comments = _parse_header(content[first.end() : last.start()])
    body = _BinaryBody(content, byte_order) if byte_order else _text_body(content, end)
    rows, at = dict[str, Rows](), end if byte_order else 0
    try:
        for element in elements:
            rows[element.name] = Rows(element, body, at)
            at = rows[element.name].end
        _check_rest(body, at, rows)
    except MeshError:
        if isinstance(body, _TextBody):
            body.require_rows_on_lines(elements, most_lines=2.0)
        raise
    if isinstance(body, _TextBody) and not all(row.uniform for row in rows.values()):
        words_of_lines = body.words_of_lines()
        words_of_rows = np.concatenate([row.widths for row in rows.values()])
        if len(words_of_lines) == len(words_of_rows) and (words_of_lines != words_of_rows).any():
            body.require_rows_on_lines(elements, most_lines=1.0)
    return Ply(rows, comments)


def read_comments(content: bytes) -> list[list[str]]:
    """Return the words of each comment in the header.

    Raises:
        MeshError: the header is damaged.
    """
    content = content.removeprefix(BYTE_ORDER_MARK)
    first, last = _header(content)
    return _parse_header(content[first.end() : last.start()])[2]


def _header(content: bytes) -> tuple[re.Match[bytes], re.Match[bytes]]:
    """Return the first and the last line of the header."""
    first, last = _FIRST_LINE.match(content), _LAST_LINE.search(content)
    if not first:
        raise MeshError("it does not start with 'ply'")
    if not last:
        raise MeshError("its header has no 'end_header'")
    return first, last


def _check_rest(body: _Body, at: int, rows: dict[str, Rows]) -> None:
    rest = body.rest(at)
    if not rest.strip(b" \t\r\n\0\x1a"):
        return
    filled = [row for row in rows.values() if row.element.length and row.element.properties]
    if filled and (further := filled[-1].further()):
        name, length = filled[-1].element.name, filled[-1].element.length
        raise MeshError(f"its header announces {length} of '{name}', but the file has {length + further}")
    warnings.warn(f"passed over {count_text(len(rest), 'byte')} after its last element", MeshfitWarning, stacklevel=2)


def _parse_header(head: bytes) -> tuple[str, list[Element], list[list[str]]]:
    """Return the byte order, empty for text, the elements, and the words of the comments."""
    byte_order, elements, comments = None, list[Element](), list[list[str]]()
    for line in _decoded(head).replace("\r", "\n").split("\n"):
        match line.split():
            case []:
                pass
            case ["comment" | "obj_info", *words]:
                comments.append(words)
            case ["format", name, *_] if byte_order is None:
                if name not in _BYTE_ORDERS:
                    raise MeshError(f"unknown format {name[:40]!r}; allowed: {', '.join(_BYTE_ORDERS)}")
                byte_order = _BYTE_ORDERS[name]
            case ["element", name, length] if length.isdecimal() and len(length) <= _MOST_DIGITS:
                if any(element.name == name for element in elements):
                    raise MeshError(f"its header has two elements '{name[:40]}'")
                elements.append(Element(name, int(length)))
            case ["property", *words] if elements and (prop := _parse_property(words)):
                elements[-1].properties.append(prop)
            case _:
                raise MeshError(f"unexpected line in its header: {line[:60]!r}")
    if byte_order is None:
        raise MeshError("its header has no 'format' line")
    return byte_order, elements, comments


def _decoded(head: bytes) -> str:
    try:
        return head.decode()
    except UnicodeDecodeError:
        return head.decode("latin-1")


def _parse_property(words: list[str]) -> Property | None:
    match words:
        case ["list", count, kind, name] if count in _CODES and kind in _CODES:
            if _CODES[count] in _REAL:
                raise MeshError(f"the length of list '{name[:40]}' is of type {count}; allowed: integer types")
            return Property(name, _CODES[kind], _CODES[count])
        case [kind, name] if kind in _CODES:
            return Property(name, _CODES[kind])
    return None


class _BinaryBody:
    def __init__(self, content: bytes, byte_order: str) -> None:
        self._content, self._byte_order, self.size = content, byte_order, len(content)
        self._codes = {code: struct.Struct(byte_order + code) for code in _CODES.values()}

    def width(self, code: str) -> int:
        return self._codes[code].size

    def count_at(self, offset: int, code: str) -> int:
        return int(self._codes[code].unpack_from(self._content, offset)[0])

    def at(self, offsets: _Offsets, code: str) -> NDArray[Any]:
        places = offsets[:, None] + np.arange(self.width(code))
        found: NDArray[Any] = np.frombuffer(self._content, np.uint8)[places].view(self._byte_order + code)
        return found.reshape(-1)

    def block(self, start: int, stride: int, rows: int, count: int, code: str) -> NDArray[Any]:
        kind = np.dtype(self._byte_order + code)
        return np.ndarray((rows, count), kind, self._content, start, (stride, kind.itemsize))

    def rest(self, offset: int) -> bytes:
        return self._content[offset:]


class _TextBody:
    """A text whose words are numbers, all of them."""

    def __init__(self, text: bytes, lines_before: int, numbers: NDArray[Any]) -> None:
        self._text, self._lines_before, self._numbers, self.size = text, lines_before, numbers, len(numbers)

    def width(self, code: str) -> int:
        return 1 if code else 0

    def count_at(self, offset: int, _code: str) -> int:
        length = self._number(offset)
        if not length.is_integer():
            raise MeshError(f"line {self.line(offset)}: expected the length of a list, got {length:g}")
        return int(length)

    def at(self, offsets: _Offsets, _code: str) -> NDArray[Any]:
        return self._numbers[offsets]

    def block(self, start: int, stride: int, rows: int, count: int, _code: str) -> NDArray[Any]:
        size = self._numbers.itemsize
        return np.ndarray((rows, count), np.float64, self._numbers.data, start * size, (stride * size, size))

    def _number(self, offset: int) -> float:
        return float(self._numbers[offset])

    def rest(self, offset: int) -> bytes:
        rest = self._from(offset) if offset < self.size else b""
        before = self._text[: len(self._text) - len(rest)].rstrip(b" \t")
        if rest and before and not before.endswith((b"\n", b"\r")):
            raise MeshError(f"line {self.line(offset)}: more numbers than the header announces")
        return rest

    def line(self, offset: int) -> int:
        """Return the number of the line on which a word is."""
        before = self._text[: len(self._text) - len(self._from(offset))]
        return self._lines_before + len((before + b".").splitlines())

    def words_of_lines(self) -> NDArray[np.int64]:
        """Return the number of words on each line that is not empty."""
        codes = np.frombuffer(b" " + self._text, np.uint8)
        is_blank = np.isin(codes, np.frombuffer(b" \t\n\r\v\f", np.uint8))
        is_start = is_blank[:-1] & ~is_blank[1:]
        line = np.cumsum((codes == ord("\n")) | (codes == ord("\r")))[1:][is_start]
        counts = np.bincount(line)
        return counts[counts > 0]

    def require_rows_on_lines(self, elements: list[Element], most_lines: float) -> None:
        """Refuse a text of one row per line that was misread word by word, naming the first line that does not fit.

        Args:
            elements: of the header.
            most_lines: how many lines a row may take on average, at most, and how many rows a line.
        """
        lines = [(number, line.split()) for number, line in enumerate(self._text.splitlines(), self._lines_before + 1)]
        lines = [(number, words) for number, words in lines if words]
        total = sum(element.length for element in elements if element.properties)
        if not total / most_lines <= len(lines) <= total * most_lines:
            return
        rows = (element for element in elements if element.properties for _ in range(element.length))
        for element, (number, words) in zip(rows, lines, strict=False):
            expected = _words_of_row(element, words)
            if expected is not None and expected != len(words):
                raise MeshError(f"line {number}: expected {expected} numbers of '{element.name}', got {len(words)}")

    def _from(self, offset: int) -> bytes:
        """Return the text from a word on."""
        pieces = self._text.split(None, offset)
        return pieces[offset] if len(pieces) > offset else b""


def _words_of_row(element: Element, words: list[bytes]) -> int | None:
    """Return how many of these words a row of an element takes, or None if the length of a list cannot be told."""
    at = 0
    for prop in element.properties:
        if prop.count_code:
            length = parse_float(words[at]) if at < len(words) else None
            if length is None or not length.is_integer() or length < 0:
                return None
            at += int(length)
        at += 1
    return at


class _WordBody(_TextBody):
    """A text of which some words are not numbers; only those that are asked for have to be."""

    def _number(self, offset: int) -> float:
        return float(self.at(np.array([offset]), "")[0])

    def at(self, offsets: _Offsets, _code: str) -> NDArray[Any]:
        numbers = [parse_float(word) for word in self._numbers[offsets].reshape(-1).tolist()]
        if None in numbers:
            bad = int(offsets.reshape(-1)[numbers.index(None)])
            raise MeshError(f"line {self.line(bad)}: expected a number, got {quoted([self._numbers[bad]])}")
        return np.array(numbers, dtype=np.float64).reshape(offsets.shape)

    def block(self, start: int, stride: int, rows: int, count: int, _code: str) -> NDArray[Any]:
        return self.at(start + np.arange(rows)[:, None] * stride + np.arange(count), _code)


def _text_body(content: bytes, start: int) -> _TextBody:
    text, lines_before = content[start:], len(content[:start].splitlines())
    numbers = parse_floats(text)
    if numbers is not None:
        return _TextBody(text, lines_before, numbers)
    return _WordBody(text, lines_before, np.array(text.split(), dtype=np.object_))
