"""OBJ files: vertices, faces and polylines. Texture coordinates, normals, groups and materials are ignored."""

import itertools
import re
import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.curves import Curves
from meshfit.mesh.io.text import Lines, parse_integers, parse_ints, parse_point, parse_point_rows, plain_text
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size, face_rows
from meshfit.units import count_text

_CONTINUED = re.compile(rb"^(?:v|fo?|l)(?=[ \t\\])(?:[^\n]*\\[ \t]*(?:\n|\Z))+[^\n]*", re.MULTILINE)
_LINE_END = re.compile(rb"\\[ \t]*(?:\n|\Z)")
_BLANKS_BEFORE = re.compile(rb"^[ \t]+", re.MULTILINE)
_KEYWORDS = {"face": (b"f", b"fo"), "line": (b"l",)}
_PASSED_OVER = re.compile(rb"^(?:call|curv2?|surf|bzp|bsp|cdc|cdp)(?=[ \t])", re.MULTILINE)
_AFTER_SLASH = re.compile(rb"/\S*")
_DIGITS = b"0123456789-+"
_BLANKS = bytes.maketrans(b"\v\f", b"  ")
_SLASH_TO_BLANK = bytes.maketrans(b"/", b" ")
_NEWLINE = ord("\n")
_BLANK_BYTES, _PASSED_OVER_BYTES = set(b" \t"), set(b"csb")
_AFTER_KEYWORD = np.frombuffer(b" \t\n\v", np.uint8)


def read_obj(content: bytes) -> PolygonSoup:
    """Read vertices and faces in file order.

    Raises:
        MeshError: naming the line at fault.

    Warns:
        MeshfitWarning: of free-form curves and surfaces and of calls of other files, which are passed over.
    """
    text = _element_text(content)
    soup = _read_at_once(text) or _read_one_by_one(text)
    _require_in_range(text, soup.corners, len(soup.verts), "face")
    return soup


def read_obj_segments(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read (V, 3) vertices and (S, 2) the segments of all `l` elements, in file order.

    Raises:
        MeshError: naming the line at fault.

    Warns:
        MeshfitWarning: of free-form curves and surfaces and of calls of other files, which are passed over.
    """
    verts: list[list[float]] = []
    segments: list[tuple[int, int]] = []
    text = _element_text(content)
    for number, words in _numbered_lines(text):
        if words[0] == b"v":
            verts.append(parse_point(words[1:], number))
        elif words[0] in _KEYWORDS["line"]:
            corners = _corners(words[1:], number, "line", len(verts))
            if len(corners) < 2:
                raise MeshError(f"line {number}: expected a line of 2 or more vertices, got {len(corners)}")
            segments += itertools.pairwise(corners)
    ends = np.array(segments, np.int64).reshape(-1, 2)
    _require_in_range(text, ends, len(verts), "line")
    return np.array(verts, np.float64).reshape(-1, 3), ends


def write_obj(mesh: Mesh | PolygonMesh, normals: NDArray[np.float64] | None = None) -> bytes:
    """Return the bytes of an OBJ file, with (V, 3) vertex normals if given; numbers are read back to the last bit."""
    corner = str if normals is None else "{0}//{0}".format
    directions = "" if normals is None else _coordinates("vn", normals)
    faces = "".join(f"f {' '.join([corner(vert + 1) for vert in face])}\n" for face in face_rows(mesh))
    return f"{_coordinates('v', mesh.verts)}{directions}{faces}".encode()


def write_obj_curves(curves: Curves) -> bytes:
    """Return the bytes of an OBJ file with one `l` element per chain; a closed one ends at its first vertex."""
    starts = np.cumsum(curves.sizes)[:-1]
    chains = [chain.tolist() for chain in np.split(curves.corners + 1, starts)] if len(curves.sizes) else []
    lines = "".join(
        f"l {' '.join(map(str, [*chain, *chain[: int(closed)]]))}\n"
        for chain, closed in zip(chains, curves.closed, strict=True)
    )
    return f"{_coordinates('v', curves.verts)}{lines}".encode()


def _coordinates(keyword: str, rows: NDArray[np.float64]) -> str:
    return "".join(f"{keyword} {x!r} {y!r} {z!r}\n" for x, y, z in rows.tolist())


def _element_text(content: bytes) -> bytes:
    """Return a file without comments and blanks before keywords, its lines joined where one goes on in the next.

    A backslash joins lines of the elements that are read only: it may also end the path of a material.
    A joined line has a vertical tab for each line end that it lost, so that lines can be counted.
    """
    text = plain_text(content)
    if b"\v" in text or b"\f" in text:
        text = text.translate(_BLANKS)
    first = _first_bytes(text)
    if first & _BLANK_BYTES:
        text = _BLANKS_BEFORE.sub(b"", text)
        first = _first_bytes(text)
    if b"\\" in text:
        text = _CONTINUED.sub(lambda lines: _LINE_END.sub(b" \v", lines[0]), text)
    if first & _PASSED_OVER_BYTES and (passed_over := {word.decode() for word in _PASSED_OVER.findall(text)}):
        names = ", ".join(sorted(passed_over))
        warnings.warn(f"passed over free-form geometry and other files: {names}", MeshfitWarning, stacklevel=3)
    return text


def _first_bytes(text: bytes) -> set[int]:
    """Return the first byte of all lines."""
    codes, starts = _line_starts(text)
    return set(np.flatnonzero(np.bincount(codes[starts[:-1]])).tolist())


def _line_starts(text: bytes) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return the bytes of a text, which some blanks follow, and where each line starts and the last ends."""
    codes = np.frombuffer(text + b"\n  ", np.uint8)
    return codes, np.concatenate([[0], np.flatnonzero(codes == _NEWLINE) + 1])


def _numbered_lines(text: bytes) -> Lines:
    """Yield the number and the words of each line of a text that is not empty."""
    number = 1
    for line in text.split(b"\n"):
        if words := line.split():
            yield number, words
        number += 1 + line.count(b"\v")


def _corners(words: Sequence[bytes], number: int, kind: str, num_verts: int) -> list[int]:
    """Return vertex indices from 0 on, for an element that follows `num_verts` vertices."""
    corners = parse_integers([word.partition(b"/")[0] for word in words], number, words)
    if 0 in corners:
        raise MeshError(f"line {number}: a {kind} with vertex 0; OBJ counts from 1, or from -1 backwards")
    return [corner - 1 if corner > 0 else num_verts + corner for corner in corners]


def _read_one_by_one(text: bytes) -> PolygonSoup:
    verts: list[list[float]] = []
    faces: list[list[int]] = []
    for number, words in _numbered_lines(text):
        if words[0] == b"v":
            verts.append(parse_point(words[1:], number))
        elif words[0] in _KEYWORDS["face"]:
            corners = _corners(words[1:], number, "face", len(verts))
            checked_face_size(len(corners), f"line {number}: ")
            faces.append(corners)
    return PolygonSoup.of_rows(verts, faces)


def _require_in_range(text: bytes, corners: NDArray[np.int64], num_verts: int, kind: str) -> None:
    """Refuse the first line with a vertex that the file lacks; a file without any vertices is refused elsewhere."""
    if not num_verts or ((corners >= 0) & (corners < num_verts)).all():
        return
    before = 0
    for number, words in _numbered_lines(text):
        before += words[0] == b"v"
        if words[0] in _KEYWORDS[kind]:
            for word, corner in zip(words[1:], _corners(words[1:], number, kind, before), strict=True):
                if not 0 <= corner < num_verts:
                    index = word.partition(b"/")[0].decode()
                    found = (
                        f"{count_text(before, 'vertex')} before it" if corner < 0 else count_text(num_verts, "vertex")
                    )
                    raise MeshError(f"line {number}: a {kind} with vertex {index}, but the file has {found}")


def _read_at_once(text: bytes) -> PolygonSoup | None:
    """Read the numbers of all vertices and then of all faces of a text; return None if anything is unusual."""
    codes, starts = _line_starts(text)
    first, second, third = (codes[starts[:-1] + place] for place in range(3))
    is_vert = (first == ord("v")) & np.isin(second, _AFTER_KEYWORD)
    is_old_face = (first == ord("f")) & (second == ord("o")) & np.isin(third, _AFTER_KEYWORD)
    is_face = (first == ord("f")) & np.isin(second, _AFTER_KEYWORD) | is_old_face
    verts = parse_point_rows(_joined(text, starts, is_vert), b"v", int(is_vert.sum()))
    face_lines = _joined(text, starts, is_face)
    faces = _face_corners(face_lines.replace(b"fo", b"f") if is_old_face.any() else face_lines, int(is_face.sum()))
    if verts is None or faces is None:
        return None
    corners, sizes = faces
    backwards = corners < 0
    if backwards.any():
        verts_before = np.repeat(np.cumsum(is_vert)[is_face], sizes)
        corners = np.where(backwards, verts_before + corners, corners - 1)
    else:
        corners = corners - 1
    return PolygonSoup(verts, corners, sizes)


def _joined(text: bytes, starts: NDArray[np.int64], chosen: NDArray[np.bool_]) -> bytes:
    """Return the chosen lines, which begin at these places."""
    changes = np.flatnonzero(np.diff(chosen, prepend=False, append=False))
    ends = starts[changes].tolist()
    return b"".join([text[start:end] for start, end in zip(ends[::2], ends[1::2], strict=True)])


def _face_corners(lines: bytes, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the vertices of all faces, from 1 on, and (F,) their sizes, with 0 in place of each keyword."""
    per_corner = 1
    if b"/" in lines:
        if any(blank in lines for blank in (b" /", b"\t/", b"\v/")):
            return None
        per_corner = _numbers_per_corner(lines)
        lines = lines.translate(_SLASH_TO_BLANK) if per_corner > 1 else _AFTER_SLASH.sub(b"", lines)
    numbers = parse_ints(lines.replace(b"f", b" 0 "))
    if numbers is None:
        return None
    is_keyword = numbers == 0
    keywords = np.flatnonzero(is_keyword)
    sizes, further = np.divmod(np.diff(keywords, append=len(numbers)) - 1, per_corner)
    if len(keywords) != count or (sizes < 3).any() or further.any():
        return None
    return numbers[~is_keyword][::per_corner], sizes


def _numbers_per_corner(lines: bytes) -> int:
    """Return how many numbers each corner has, if all are written alike and after one blank each, else 1."""
    skeleton = lines.translate(None, _DIGITS)
    corners, slashes = skeleton.count(b" "), skeleton.count(b"/")
    if slashes == corners == skeleton.count(b" /"):
        per_corner = 2
    elif slashes == 2 * corners == 2 * skeleton.count(b" //"):
        per_corner = 2 if lines.count(b"//") == corners else 3
    else:
        return 1
    if b"\t" in lines or b"\v" in lines:
        return 1
    blanks = lines.count(b"/ ") + lines.count(b"/\n") + lines.count(b"//") * (per_corner == 3)
    return 1 if blanks else per_corner
