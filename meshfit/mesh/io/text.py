"""OBJ and OFF, the two formats that are text: every line is accounted for, and a double comes back to the last bit."""

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size, face_rows, polygon_soup

_Lines = Iterator[tuple[int, list[bytes]]]
_PASSED_OVER = (b"#", b"vn ", b"vt ", b"g ", b"o ", b"s ", b"usemtl ", b"mtllib ")
_AFTER_SLASH = re.compile(rb"/\S*")
_MARK = b"\xef\xbb\xbf"


def read_obj(content: bytes) -> PolygonSoup:
    """Verts and faces of an OBJ file, in its order; texture coordinates, normals, groups and materials are passed over.

    Raises:
        ValueError: naming the line at fault.
    """
    if (plain := _plain_obj(content)) is not None:
        return plain
    verts: list[list[float]] = []
    faces: list[list[int]] = []
    for number, words in _lines(content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")):
        if words[0] == b"v":
            verts.append(_point(words[1:], number))
        elif words[0] == b"f":
            corners = _corners(words[1:], number, "face", len(verts))
            checked_face_size(len(corners), f"line {number}: ")
            faces.append(corners)
    return polygon_soup(verts, faces)


def read_obj_segments(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(V, 3) verts and (S, 2) the segments of all `l` elements of an OBJ file, in its order; faces are passed over.

    Raises:
        ValueError: naming the line at fault.
    """
    verts: list[list[float]] = []
    segments: list[tuple[int, int]] = []
    for number, words in _lines(content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")):
        if words[0] == b"v":
            verts.append(_point(words[1:], number))
        elif words[0] == b"l":
            corners = _corners(words[1:], number, "line", len(verts))
            if len(corners) < 2:
                raise ValueError(f"line {number}: a line of {len(corners)} verts, 2 or more are needed")
            segments += itertools.pairwise(corners)
    return np.array(verts, np.float64).reshape(-1, 3), np.array(segments, np.int64).reshape(-1, 2)


def _corners(words: Sequence[bytes], number: int, what: str, num_verts: int) -> list[int]:
    """Vertex indices from 0 on, of an element that follows so many verts."""
    corners = _integers([word.partition(b"/")[0] for word in words], number)
    if 0 in corners:
        raise ValueError(f"line {number}: a {what} with vertex 0; OBJ counts from 1, or from -1 backwards")
    return [corner - 1 if corner > 0 else num_verts + corner for corner in corners]


def read_off(content: bytes) -> PolygonSoup:
    """Verts and faces of an OFF file, in its order; colours and normals are passed over.

    Raises:
        ValueError: naming the line at fault.
    """
    lines = _lines(content)
    number, words = next(lines, (1, [b""]))
    if not words[0].endswith(b"OFF") or b"BINARY" in words or words[0].strip(b"STCNOF"):
        raise ValueError(f"line {number}: 'OFF' is needed, in text and three dimensions")
    number, words = (number, words[1:]) if words[1:] else next(lines, (number, []))
    counts = _integers(words, number)
    if len(counts) < 2 or min(counts) < 0:
        raise ValueError(f"line {number}: the numbers of verts and faces are needed")
    verts = [_point(words, number) for number, words in _take(lines, counts[0], "verts")]
    faces: list[list[int]] = []
    for number, words in _take(lines, counts[1], "faces"):
        size = _integers(words[:1], number)[0]
        if len(words) <= size:
            raise ValueError(f"line {number}: a face of {size} corners, of which {len(words) - 1} are there")
        faces.append(_integers(words[1 : checked_face_size(size, f"line {number}: ") + 1], number))
    for number, _ in lines:
        raise ValueError(f"line {number}: more lines than the {counts[0]} verts and {counts[1]} faces announced")
    return polygon_soup(verts, faces)


def _plain_obj(content: bytes) -> PolygonSoup | None:
    """The same, all at once, where verts and faces are plain `v x y z` and `f a b c …`, slashes or not; else None."""
    lines = content.split(b"\n")
    verts = [line[2:] for line in lines if line.startswith(b"v ")]
    faces = [line[2:] for line in lines if line.startswith(b"f ")]
    if len(verts) + len(faces) + sum(line.startswith(_PASSED_OVER) or not line for line in lines) != len(lines):
        return None
    points, corners = _numbers(verts, np.float64), _numbers(faces, np.int64)
    if points is None or corners is None:
        return None
    if not ((points[1] == 3).all() and (corners[1] >= 3).all() and (corners[0] > 0).all()):
        return None
    return PolygonSoup(points[0].reshape(-1, 3), corners[0] - 1, corners[1])


def _numbers(lines: list[bytes], dtype: type[np.generic]) -> tuple[NDArray[Any], NDArray[np.int64]] | None:
    """The numbers of all lines, one line after the other, and how many each line has; or None."""
    words = np.array(_AFTER_SLASH.sub(b"", b" ; ".join([*lines, b""])).split(), dtype=bytes)
    ends = np.flatnonzero(words == b";")
    if len(ends) != len(lines):  # a line has a separator of its own
        return None
    try:
        return np.delete(words, ends).astype(dtype), np.diff(ends, prepend=-1) - 1
    except ValueError:
        return None


def write_obj(mesh: Mesh | PolygonMesh, normals: NDArray[np.float64] | None = None) -> bytes:
    """The bytes of an OBJ file, with (V, 3) normals of its verts if given."""
    verts = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in mesh.verts.tolist())
    corner = str if normals is None else "{0}//{0}".format
    directions = "".join(f"vn {x!r} {y!r} {z!r}\n" for x, y, z in ([] if normals is None else normals.tolist()))
    faces = "".join(f"f {' '.join([corner(vert + 1) for vert in face])}\n" for face in face_rows(mesh))
    return f"{verts}{directions}{faces}".encode()


def write_off(mesh: Mesh | PolygonMesh) -> bytes:
    """The bytes of an OFF file."""
    verts = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in mesh.verts.tolist())
    faces = "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in face_rows(mesh))
    return f"OFF\n{mesh.num_verts} {mesh.num_faces} 0\n{verts}{faces}".encode()


def _lines(content: bytes) -> _Lines:
    for number, line in enumerate(content.removeprefix(_MARK).splitlines(), 1):
        words = line.partition(b"#")[0].split()
        if words:
            yield number, words


def _take(lines: _Lines, count: int, what: str) -> _Lines:
    for taken in range(count):
        line = next(lines, None)
        if line is None:
            raise ValueError(f"the file ends after {taken} of {count} {what}")
        yield line


def _point(words: Sequence[bytes], number: int) -> list[float]:
    if len(words) < 3:
        raise ValueError(f"line {number}: a vertex of {len(words)} coordinates, 3 are needed")
    try:
        return [float(word) for word in words[:3]]
    except ValueError:
        raise ValueError(f"line {number}: {_shown(words[:3])} are not three numbers") from None


def _integers(words: Sequence[bytes], number: int) -> list[int]:
    try:
        return [int(word) for word in words]
    except ValueError:
        raise ValueError(f"line {number}: {_shown(words)} are not all integers") from None


def _shown(words: Sequence[bytes]) -> str:
    text = b" ".join(words).decode("ascii", "backslashreplace")
    return repr(text if len(text) <= 40 else text[:39] + "…")
