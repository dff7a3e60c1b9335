"""OFF files: the numbers of vertices and faces, then their coordinates and corners; without colours."""

import itertools
import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.io.text import (
    Lines,
    parse_float,
    parse_floats,
    parse_integers,
    parse_ints,
    parse_point,
    parse_point_rows,
    plain_text,
    quoted,
    split_lines,
)
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size, face_rows

_BLANK_LINES = re.compile(rb"\n[ \t\n]+")
# The counts may follow the keyword without a blank. The digit 4 or a lower-case n before capitals announces vertices of
# other dimensions than three; the other letters stand in any order, such as NCOFF.
_KEYWORD = re.compile(rb"\s*((?:ST|C|N|4|n)*)(OFF)(?![A-Za-z])|\s*((?:st|c|n|4)*)(off)(?![A-Za-z])")
_WORD = re.compile(rb"\S+")
_LARGEST_INDEX = 2**53  # float64 holds every integer up to here
_MARK = b" -1 "  # of a line of faces, in which no other negative number is allowed


class _Counts(NamedTuple):
    """The numbers in the header, and the place in the text after them."""

    verts: int
    faces: int
    end: int


def read_off(content: bytes) -> PolygonSoup:
    """Read vertices and faces in file order, one per line, or else word by word; of points, the normals too.

    Raises:
        MeshError: naming the line at fault.
    """
    text = plain_text(content)
    keyword_end, columns = _read_keyword(text)
    candidates = list(_read_counts(text, keyword_end))
    soup = _read_soup(text, candidates, columns)
    if len(soup.sizes) or b"N" not in text[:keyword_end].upper():
        return soup
    return soup._replace(normals=_normals(text, candidates, len(soup.verts)))


def _read_soup(text: bytes, candidates: list[_Counts], columns: int) -> PolygonSoup:
    if (soup := _read_at_once(text, candidates[0])) is not None:
        return soup
    errors = list[MeshError]()
    for counts in candidates:
        try:
            return _read_lines(text, counts)
        except MeshError as error:
            errors.append(error)
        try:
            return _read_words(text, counts, columns)
        except MeshError as error:
            errors.append(error)
    raise errors[0]


def _normals(text: bytes, candidates: list[_Counts], num_verts: int) -> NDArray[np.float64] | None:
    """Return (V, 3) the normals of points, which follow their positions; None if anything is unusual."""
    for counts in candidates:
        numbers = parse_floats(text[counts.end :])
        if numbers is not None and num_verts and len(numbers) % num_verts == 0 and len(numbers) >= 6 * num_verts:
            return numbers.reshape(num_verts, -1)[:, 3:6]
    return None


def write_off(mesh: Mesh | PolygonMesh) -> bytes:
    """Return the bytes of an OFF file; every coordinate is read back to the last bit."""
    verts = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in mesh.verts.tolist())
    faces = "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in face_rows(mesh))
    return f"OFF\n{mesh.num_verts} {mesh.num_faces} 0\n{verts}{faces}".encode()


def _read_keyword(text: bytes) -> tuple[int, int]:
    """Return where the keyword ends, which may be missing, and how many numbers a vertex has."""
    keyword = _KEYWORD.match(text)
    if not keyword:
        first = _WORD.search(text)
        if first and not first[0].isdigit():
            line = 1 + text.count(b"\n", 0, first.start())
            raise MeshError(f"line {line}: expected 'OFF', got {quoted([first[0]])}")
        return 0, 3
    letters, name = keyword[1] or keyword[3] or b"", keyword[0].strip()
    line = 1 + text.count(b"\n", 0, keyword.end())
    if b"4" in letters or (keyword[2] and b"n" in letters):
        raise MeshError(f"line {line}: expected 'OFF' in three dimensions, got {quoted([name])}")
    following = _WORD.search(text, keyword.end())
    if following and following[0].upper() == b"BINARY":
        raise MeshError(f"line {line}: expected 'OFF' as text, got 'OFF BINARY'")
    columns = {b"S": 2, b"C": 4, b"N": 3}  # texture coordinates, a colour, a normal
    return keyword.end(), 3 + sum(count for letter, count in columns.items() if letter in letters.upper())


def _read_counts(text: bytes, start: int) -> Iterator[_Counts]:
    """Yield the counts, and once more without that of edges, which may be missing where it would be alone on a line."""
    words = list(itertools.islice(_WORD.finditer(text, start), 4))
    line = 1 + text.count(b"\n", 0, words[0].start() if words else max(start - 1, 0))
    counts = parse_integers([word[0] for word in words[:2]], line)
    if len(counts) < 2 or min(counts) < 0:
        raise MeshError(f"line {line}: expected the numbers of vertices and faces")
    verts, faces = counts
    is_edges = len(words) > 2 and re.fullmatch(rb"[-+]?\d+", words[2][0])
    same_line = len(words) > 2 and b"\n" not in text[words[1].end() : words[2].start()]
    alone = len(words) == 3 or (len(words) > 3 and b"\n" in text[words[2].end() : words[3].start()])
    if same_line and not is_edges:
        raise MeshError(f"line {line}: expected the numbers of vertices, faces and edges, got {quoted([words[2][0]])}")
    if is_edges and (same_line or alone):
        yield _Counts(verts, faces, words[2].end())
    if not same_line:
        yield _Counts(verts, faces, words[1].end())


def _read_at_once(text: bytes, counts: _Counts) -> PolygonSoup | None:
    """Read the numbers of all vertices and then of all faces, one per line; return None if anything is unusual."""
    # Each line of the body then begins with the byte that ends the previous one.
    body = _BLANK_LINES.sub(b"\n", text[counts.end :]).rstrip()
    starts = np.flatnonzero(np.frombuffer(body, np.uint8) == ord("\n"))
    if len(starts) != counts.verts + counts.faces or not body.startswith(b"\n"):
        return None
    first_face = int(starts[counts.verts]) if counts.faces else len(body)
    verts = parse_point_rows(body[:first_face], b"\n", counts.verts)
    faces = _face_rows_at_once(body[first_face:], counts.faces)
    return None if verts is None or faces is None else PolygonSoup(verts, *faces)


def _face_rows_at_once(lines: bytes, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the corners of all faces in a row, and (F,) their sizes."""
    text = lines.replace(b"\n", _MARK)
    numbers: NDArray[np.int64] | NDArray[np.float64] | None = parse_ints(text)
    if numbers is None:  # colours may be fractions
        numbers = parse_floats(text)
    if numbers is None or not (np.abs(numbers) < _LARGEST_INDEX).all():
        return None
    if not len(numbers):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    marks = np.flatnonzero(numbers == -1)
    lengths = np.diff(marks, append=len(numbers)) - 1
    if len(marks) != count or (lengths < 1).any():
        return None
    sizes = numbers[marks + 1]
    if not ((sizes >= 3) & (sizes < lengths) & (sizes % 1 == 0)).all():
        return None
    sizes = sizes.astype(np.int64)
    within = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    corners = numbers[np.repeat(marks + 2, sizes) + within]
    return (corners.astype(np.int64), sizes) if (corners % 1 == 0).all() and (corners >= 0).all() else None


def _read_lines(text: bytes, counts: _Counts) -> PolygonSoup:
    """Read one vertex or face per line, and ignore what else is on it."""
    before = text.count(b"\n", 0, counts.end)
    lines = ((before + number, words) for number, words in split_lines(text[counts.end :]))
    verts = [parse_point(words, number) for number, words in _take(lines, counts.verts, "vertices")]
    faces: list[list[int]] = []
    for number, words in _take(lines, counts.faces, "faces"):
        size = _parse_indices(words[:1], number)[0]
        if len(words) <= size:
            raise MeshError(f"line {number}: expected a face of {size} corners, got {len(words) - 1}")
        faces.append(_parse_indices(words[1 : checked_face_size(size, f"line {number}: ") + 1], number))
    for number, _ in lines:
        raise MeshError(f"line {number}: more lines than the header's {counts.verts} vertices and {counts.faces} faces")
    return PolygonSoup.of_rows(verts, faces)


def _parse_indices(words: list[bytes], number: int) -> list[int]:
    """Return the words of a line as integers, which may be written like `3.0`."""
    values = [parse_float(word) for word in words]
    if all(value is not None and value.is_integer() and abs(value) < _LARGEST_INDEX for value in values):
        return [int(value) for value in values if value is not None]
    return parse_integers(words, number)


def _take(lines: Lines, count: int, kind: str) -> Lines:
    for taken in range(count):
        line = next(lines, None)
        if line is None:
            raise MeshError(f"the file ends after {taken} of {count} {kind}")
        yield line


def _read_words(text: bytes, counts: _Counts, columns: int) -> PolygonSoup:
    """Read vertices and faces anywhere on lines; after a face, the rest of its line may be a colour."""
    before = text.count(b"\n", 0, counts.end)
    words = [(before + number, word) for number, line in split_lines(text[counts.end :]) for word in line]
    end = counts.verts * columns
    if end > len(words):
        raise MeshError(f"the file ends within the {counts.verts} vertices of its header")
    verts = [parse_point([word for _, word in words[at : at + 3]], words[at][0]) for at in range(0, end, columns)]
    try:
        faces = _faces_of_words(words[end:], counts.faces, colours=False)
    except MeshError:
        faces = _faces_of_words(words[end:], counts.faces, colours=True)
    return PolygonSoup.of_rows(verts, faces)


def _faces_of_words(words: list[tuple[int, bytes]], count: int, *, colours: bool) -> list[list[int]]:
    """Return the corners of faces that take all words; with colours, the rest of the line after each belongs to it."""
    faces, at = list[list[int]](), 0
    for _ in range(count):
        size = checked_face_size(_parse_indices([words[at][1]], words[at][0])[0]) if at < len(words) else 0
        end = at + 1 + size
        if not size or end > len(words):
            raise MeshError(f"the file ends after {len(faces)} of {count} faces")
        faces.append(_parse_indices([word for _, word in words[at + 1 : end]], words[at][0]))
        while colours and end < len(words) and words[end][0] == words[end - 1][0]:
            end += 1
        at = end
    if at < len(words):
        raise MeshError(f"line {words[at][0]}: more numbers than the header's {count} faces")
    return faces
