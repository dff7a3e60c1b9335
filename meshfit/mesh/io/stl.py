"""STL files, text or binary: triangles with three vertices of their own each. Normals and attributes are ignored."""

import re
import warnings
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.text import BYTE_ORDER_MARK, parse_floats, parse_point, quoted
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup
from meshfit.units import count_text

_HEADER_SIZE = 84
_FACET = np.dtype([("normal", "<f4", 3), ("verts", "<f4", (3, 3)), ("attributes", "<u2")])
_UNKNOWN_COUNTS = (0, 2**32 - 1)  # written by programs that do not know the number when they begin
_KEYWORD = re.compile(rb"\b(?:solid|facet|vertex)\b", re.IGNORECASE)
_SOLID_LINE = re.compile(rb"(?:end[ \t]*)?solid(?:[ \t].*)?", re.IGNORECASE | re.DOTALL)
_END = re.compile(rb"\bend[ \t]+(?=solid\b|facet\b|loop\b)", re.IGNORECASE)
_FACET_AFTER_NAME = re.compile(rb"\bfacet[ \t]+normal[ \t]+[-+.\d].*", re.IGNORECASE)
_KEYWORDS = {b"solid", b"facet", b"outer", b"loop", b"vertex", b"endloop", b"endfacet", b"endsolid"}
_FACET_LINES = (b"facet ", b"outer loop", b"vertex ", b"vertex ", b"vertex ", b"endloop", b"endfacet")
_WHOLE_LINES = (1, 5, 6)  # of those
_FOURTH_LETTERS = np.frombuffer(b"iIsS \t", np.uint8)  # of 'solid', 'endsolid' and 'end solid'
_LOWER_CASE = 0x20  # the bit of a letter
_MOST_BLANKS = 64  # before a keyword, in a regular text


def read_stl(content: bytes) -> PolygonSoup:
    """Read the triangles of an STL file, text or binary, of all solids.

    Raises:
        MeshError: the file is damaged; the message names the facet, or both of two numbers that differ.

    Warns:
        MeshfitWarning: of bytes after the last facet of a binary file, or of a placeholder for their number.
    """
    verts = _text_verts(content) if _is_text(content) else _binary_verts(content)
    return PolygonSoup.of_triangles(verts, np.arange(len(verts), dtype=np.int64).reshape(-1, 3))


def write_stl(mesh: Mesh | PolygonMesh) -> bytes:
    """Return the bytes of a binary STL file, with the unit normal of each triangle."""
    triangles = PolygonMesh.of(mesh).triangulated()
    facets = np.zeros(triangles.num_faces, dtype=_FACET)
    facets["verts"] = triangles.verts[triangles.faces]
    a, b, c = facets["verts"].astype(np.float64).transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return b"meshfit".ljust(_HEADER_SIZE - 4) + len(facets).to_bytes(4, "little") + facets.tobytes()


def _is_text(content: bytes) -> bool:
    """Return whether a file is text. A binary one may begin with 'solid' too, but is never without a zero byte."""
    if len(content) == _HEADER_SIZE + _FACET.itemsize * _announced(content):
        return False
    could_be_text = len(content) >= _HEADER_SIZE or _KEYWORD.search(content) is not None
    return could_be_text and b"\0" not in content.rstrip(b"\0")


def _announced(content: bytes) -> int:
    """Return the number of facets in the header of a binary file."""
    return int.from_bytes(content[_HEADER_SIZE - 4 : _HEADER_SIZE], "little")


def _binary_verts(content: bytes) -> NDArray[np.float64]:
    """Return (3F, 3) the vertices of all facets."""
    if len(content) < _HEADER_SIZE:
        raise MeshError(
            f"it has {len(content)} bytes, but a binary file begins with {_HEADER_SIZE}, a text with 'solid'"
        )
    announced = _announced(content)
    present, further = divmod(len(content) - _HEADER_SIZE, _FACET.itemsize)
    if announced in _UNKNOWN_COUNTS and present and not further:
        _warn(f"its header announces {count_text(announced, 'facet')}; read the {present:,} that are there")
        announced = present
    if announced > present or (announced < present and (announced == 0 or not further)):
        raise MeshError(f"its header announces {count_text(announced, 'facet')}, but the file has {present:,}")
    extra = len(content) - _HEADER_SIZE - announced * _FACET.itemsize
    if extra:
        _warn(f"passed over {count_text(extra, 'byte')} after the last of {count_text(announced, 'facet')}")
    facets = np.frombuffer(content, _FACET, announced, _HEADER_SIZE)
    with np.errstate(invalid="ignore"):  # of signalling NaN
        return facets["verts"].reshape(-1, 3).astype(np.float64)


def _text_verts(content: bytes) -> NDArray[np.float64]:
    """Return (3F, 3) the vertices of all facets."""
    content = content.removeprefix(BYTE_ORDER_MARK).rstrip(b"\0")
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    verts = _regular_text_verts(content)
    return _TextFacets(content).verts if verts is None else verts


def _regular_text_verts(text: bytes) -> NDArray[np.float64] | None:
    """Read a text that has the usual seven lines for each facet; return None for others."""
    codes, starts, ends = _keyword_lines(text)
    is_solid = np.zeros(len(starts), dtype=bool)
    for place in np.flatnonzero(np.isin(codes[starts + 3], _FOURTH_LETTERS)).tolist():
        line = text[starts[place] : ends[place]]
        is_solid[place] = _SOLID_LINE.fullmatch(line) and not _FACET_AFTER_NAME.search(line)
    lines_before = np.append(np.cumsum(~is_solid)[is_solid], np.count_nonzero(~is_solid))
    if (lines_before % len(_FACET_LINES)).any():
        return None
    starts, ends = starts[~is_solid], ends[~is_solid]
    starts, ends = (places.reshape(-1, len(_FACET_LINES)) for places in (starts, ends))
    for place, word in enumerate(_FACET_LINES):
        if place in _WHOLE_LINES and (ends[:, place] - starts[:, place] != len(word)).any():
            return None
        if not all((codes[starts[:, place] + at] | _LOWER_CASE == letter).all() for at, letter in enumerate(word)):
            return None
    first, after = starts[:, 2].tolist(), (ends[:, 4] + 1).tolist()
    lines = b"".join([text[start:end] for start, end in zip(first, after, strict=True)])
    numbers = parse_floats(lines.lower().replace(b"vertex", b" nan "))
    if numbers is None or len(numbers) != 12 * len(starts):
        return None
    verts = numbers.reshape(-1, 4)
    return verts[:, 1:].copy() if np.isnan(verts[:, 0]).all() and np.isfinite(verts[:, 1:]).all() else None


def _keyword_lines(text: bytes) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]]:
    """Return the bytes of a text, and where the first word of each line that is not empty starts and the line ends."""
    codes = np.frombuffer(text + b"\n        ", np.uint8)
    ends = np.flatnonzero(codes == ord("\n"))
    starts = np.concatenate([[0], ends[:-1] + 1])
    for _ in range(_MOST_BLANKS):
        before, after = (
            (codes[places] == ord(" ")) | (codes[places] == ord("\t"))
            for places in (starts, np.maximum(ends - 1, starts))
        )
        if not (before.any() or after.any()):
            break
        starts, ends = starts + before, ends - after
    return codes, starts[starts < ends], ends[starts < ends]


class _TextFacets:
    """Reader of a text word by word, which knows the number and the line of each facet."""

    def __init__(self, content: bytes) -> None:
        self._rows: list[list[float]] = []
        self._facet = self._line = 0  # of the last facet: its number, and the line on which it begins
        self._open = self._loop_ended = False
        words = _Words(content)
        while words.left:
            self._take(words)
        if self._open and not self._loop_ended:
            raise self._cut_short()
        self._end_facet()
        self.verts = np.array(self._rows, dtype=np.float64).reshape(-1, 3)

    @property
    def _name(self) -> str:
        return f"facet {self._facet}, which begins on line {self._line}"

    def _cut_short(self) -> MeshError:
        place = f"inside {self._name}" if self._open else f"after facet {self._facet}"
        return MeshError(f"the file is cut short {place}")

    def _take(self, words: "_Words") -> None:
        line, word = words.take()
        match word:
            case b"facet":
                self._end_facet()
                self._facet, self._line, self._open, self._loop_ended = self._facet + 1, line, True, False
                words.skip_normal()
            case b"vertex":
                self._take_vertex(line, words)
            case b"endloop":
                self._require_three()
                self._loop_ended = True
            case b"endfacet" | b"solid" | b"endsolid":
                self._end_facet()
            case b"outer" | b"loop":
                pass
            case _ if self._facet and not words.left:
                raise self._cut_short()
            case _:
                raise MeshError(f"line {line}: expected a facet, a loop or a vertex, got {quoted([word])}")

    def _take_vertex(self, line: int, words: "_Words") -> None:
        if not self._open:
            raise MeshError(f"line {line}: a vertex outside of a facet")
        numbers = words.take_numbers()
        if len(numbers) < 3 and not words.left:
            raise self._cut_short()
        self._rows.append(parse_point(numbers, line))

    def _end_facet(self) -> None:
        if self._open:
            self._require_three()
        self._open = False

    def _require_three(self) -> None:
        count = len(self._rows) - 3 * (self._facet - 1)
        if count != 3:
            raise MeshError(f"expected a loop of 3 vertices, got {count} in {self._name}")


class _Words:
    """The words of a text with their lines; of the lines that begin and end solids, without the names."""

    def __init__(self, content: bytes) -> None:
        self._words = [word for line in enumerate(content.splitlines(), 1) for word in _words_of_line(*line)]
        self._at = 0

    @property
    def left(self) -> bool:
        """Whether there are more words."""
        return self._at < len(self._words)

    def take(self) -> tuple[int, bytes]:
        """Return the next word and its line."""
        self._at += 1
        return self._words[self._at - 1]

    def skip_normal(self) -> None:
        """Pass over the normal of a facet, whatever it is."""
        while self.left and self._words[self._at][1] not in _KEYWORDS:
            self._at += 1

    def take_numbers(self) -> list[bytes]:
        """Return the next three words, or fewer at the end of the file or before a keyword."""
        words = [word for _, word in self._words[self._at : self._at + 3]]
        count = next((place for place, word in enumerate(words) if word in _KEYWORDS), len(words))
        self._at += count
        return words[:count]


def _words_of_line(number: int, line: bytes) -> Iterator[tuple[int, bytes]]:
    words = _END.sub(b"end", line).split()
    while words:
        word = words.pop(0)
        keyword = word.lower()
        yield number, keyword if keyword in _KEYWORDS else word
        if keyword in (b"solid", b"endsolid"):
            facet = _FACET_AFTER_NAME.search(b" ".join(words))
            words = facet[0].split() if facet else []


def _warn(text: str) -> None:
    warnings.warn(text, MeshfitWarning, stacklevel=4)
