"""OBJ files: vertices, faces and polylines. Texture coordinates, normals, groups and materials are ignored."""

import itertools
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.curves import Curves
from meshfit.mesh.io.text import Lines, parse_integers, parse_point, split_lines
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size, face_rows

_IGNORED = (b"#", b"vn ", b"vt ", b"g ", b"o ", b"s ", b"usemtl ", b"mtllib ")
_AFTER_SLASH = re.compile(rb"/\S*")


def read_obj(content: bytes) -> PolygonSoup:
    """Read vertices and faces in file order.

    Raises:
        MeshError: naming the line at fault.
    """
    if (plain := _read_plain(content)) is not None:
        return plain
    verts: list[list[float]] = []
    faces: list[list[int]] = []
    for number, words in _joined_lines(content):
        if words[0] == b"v":
            verts.append(parse_point(words[1:], number))
        elif words[0] == b"f":
            corners = _corners(words[1:], number, "face", len(verts))
            checked_face_size(len(corners), f"line {number}: ")
            faces.append(corners)
    return PolygonSoup.of_rows(verts, faces)


def read_obj_segments(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read (V, 3) vertices and (S, 2) the segments of all `l` elements, in file order.

    Raises:
        MeshError: naming the line at fault.
    """
    verts: list[list[float]] = []
    segments: list[tuple[int, int]] = []
    for number, words in _joined_lines(content):
        if words[0] == b"v":
            verts.append(parse_point(words[1:], number))
        elif words[0] == b"l":
            corners = _corners(words[1:], number, "line", len(verts))
            if len(corners) < 2:
                raise MeshError(f"line {number}: expected a line of 2 or more vertices, got {len(corners)}")
            segments += itertools.pairwise(corners)
    return np.array(verts, np.float64).reshape(-1, 3), np.array(segments, np.int64).reshape(-1, 2)


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


def _joined_lines(content: bytes) -> Lines:
    """Yield the lines, where a backslash at the end of one continues it on the next."""
    return split_lines(content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" "))


def _corners(words: Sequence[bytes], number: int, kind: str, num_verts: int) -> list[int]:
    """Return vertex indices from 0 on, for an element that follows `num_verts` vertices."""
    corners = parse_integers([word.partition(b"/")[0] for word in words], number)
    if 0 in corners:
        raise MeshError(f"line {number}: a {kind} with vertex 0; OBJ counts from 1, or from -1 backwards")
    return [corner - 1 if corner > 0 else num_verts + corner for corner in corners]


def _read_plain(content: bytes) -> PolygonSoup | None:
    """Read a file of plain `v x y z` and `f a b c …` lines, with or without slashes, fast; return None for others."""
    lines = content.split(b"\n")
    verts = [line[2:] for line in lines if line.startswith(b"v ")]
    faces = [line[2:] for line in lines if line.startswith(b"f ")]
    if len(verts) + len(faces) + sum(line.startswith(_IGNORED) or not line for line in lines) != len(lines):
        return None
    points, corners = _numbers(verts, np.float64), _numbers(faces, np.int64)
    if points is None or corners is None:
        return None
    if not ((points[1] == 3).all() and (corners[1] >= 3).all() and (corners[0] > 0).all()):
        return None
    return PolygonSoup(points[0].reshape(-1, 3), corners[0] - 1, corners[1])


def _numbers(lines: list[bytes], dtype: type[np.generic]) -> tuple[NDArray[Any], NDArray[np.int64]] | None:
    """Return the numbers of all lines in a row, and how many each line has; None where a word is no number."""
    words = np.array(_AFTER_SLASH.sub(b"", b" ; ".join([*lines, b""])).split(), dtype=bytes)
    ends = np.flatnonzero(words == b";")
    if len(ends) != len(lines):  # a line contains the separator itself
        return None
    try:
        return np.delete(words, ends).astype(dtype), np.diff(ends, prepend=-1) - 1
    except ValueError:
        return None
