"""Point clouds in PCD files, text, binary or compressed."""

import math
import re
import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.raw_points import RawPoints
from meshfit.mesh.io.text import parse_float
from meshfit.units import count_text

_HEADER = re.compile(rb"(?:[^\n]*\n)*?DATA[ \t]+(ascii|binary|binary_compressed)[ \t]*\r?\n", re.IGNORECASE)
_VIEWPOINT = re.compile(rb"^VIEWPOINT[ \t]+([^\n]*)", re.IGNORECASE | re.MULTILINE)
_KINDS = {b"F": "f", b"I": "i", b"U": "u"}
_SIZES = {"f": (4, 8), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8)}
_LONGEST_HEADER = 10_000
_AXES, _NORMALS = ("x", "y", "z"), ("normal_x", "normal_y", "normal_z")


class _Layout(NamedTuple):
    """Type and names of a record, and the number of records."""

    dtype: np.dtype[np.void]
    num_points: int

    @property
    def columns(self) -> tuple[str, ...]:
        """The fields that are read: coordinates, and normals if it has some."""
        return _AXES + _NORMALS if _NORMALS[0] in (self.dtype.names or ()) else _AXES


def read_pcd(content: bytes) -> RawPoints:
    """Read the points of a PCD file, with normals in fields normal_x, normal_y and normal_z, and its viewpoint.

    A viewpoint of 0 0 0, which programs write by default, tells nothing.

    Points that are not finite, which stand for pixels without a point, are left out.

    Raises:
        MeshError: a damaged file.

    Warns:
        MeshfitWarning: with the number of points that are left out.
    """
    found = _HEADER.match(content[:_LONGEST_HEADER])
    if found is None:
        raise MeshError(
            "expected a header that ends with a line 'DATA ascii', 'DATA binary' or 'DATA binary_compressed'"
        )
    layout = _layout(found.group())
    body, form = content[found.end() :], found[1].lower()
    read = {b"ascii": _text, b"binary": _binary, b"binary_compressed": _compressed}[form]
    columns = read(body, layout)
    points, normals = columns[:, :3], columns[:, 3:] if columns.shape[1] > len(_AXES) else None
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        left_out = count_text(int((~finite).sum()), "point")
        warnings.warn(f"left out {left_out} with a coordinate that is not finite", MeshfitWarning, stacklevel=2)
    if not finite.any():
        raise MeshError("no points in it")
    return RawPoints(points[finite], None if normals is None else normals[finite], _viewpoint(found.group()))


def _viewpoint(header: bytes) -> tuple[float, float, float] | None:
    found = _VIEWPOINT.search(header)
    numbers = [parse_float(word) for word in found[1].split()[:3]] if found else []
    x, y, z = (number for number in (*numbers, None, None, None)[:3])
    if x is None or y is None or z is None or not np.isfinite([x, y, z]).all() or (x, y, z) == (0, 0, 0):
        return None
    return x, y, z


def _layout(header: bytes) -> _Layout:
    lines = [line.split() for line in header.splitlines() if line.strip() and not line.startswith(b"#")]
    rows = {line[0].upper(): line[1:] for line in lines}
    names, kinds = rows.get(b"FIELDS", rows.get(b"COLUMNS", [])), rows.get(b"TYPE", [])
    sizes, counts = _integers(rows, b"SIZE"), _integers(rows, b"COUNT") or [1] * len(names)
    if not len(names) == len(kinds) == len(sizes) == len(counts):
        raise MeshError("its header has FIELDS, TYPE, SIZE and COUNT of different lengths")
    codes = []
    for kind, size in zip(kinds, sizes, strict=True):
        code = _KINDS.get(kind.upper())
        if code is None or size not in _SIZES[code]:
            raise MeshError("its header has a TYPE other than F, I and U, or a SIZE that such a number cannot have")
        codes.append(f"<{code}{size}")
    if any(names.count(axis) != 1 or counts[names.index(axis)] != 1 for axis in (b"x", b"y", b"z")):
        raise MeshError("expected FIELDS x, y and z, one of each")
    if max(counts) > 10_000:
        raise MeshError(f"its header has a COUNT of {max(counts)}")
    points = _integers(rows, b"POINTS") or [math.prod(_integers(rows, b"WIDTH") + _integers(rows, b"HEIGHT"))]
    has_normals = all(names.count(axis) == 1 and counts[names.index(axis)] == 1 for axis in map(str.encode, _NORMALS))
    kept = {axis.encode() for axis in (_AXES + _NORMALS if has_normals else _AXES)}
    fields = [
        (name.decode() if name in kept else f"column {place}", code, (count,))
        for place, (name, code, count) in enumerate(zip(names, codes, counts, strict=True))
    ]
    return _Layout(np.dtype(fields), points[0])


def _integers(rows: dict[bytes, list[bytes]], key: bytes) -> list[int]:
    words = rows.get(key, [])
    if not all(word.isdigit() and len(word) < 12 for word in words):
        raise MeshError(f"expected integers after {key.decode()} in its header")
    return [int(word) for word in words]


def _text(body: bytes, layout: _Layout) -> NDArray[np.float64]:
    widths = {name: math.prod(field[0].shape) for name, field in (layout.dtype.fields or {}).items()}
    width, places = sum(widths.values()), np.cumsum([0, *widths.values()])
    words = body.split()
    if len(words) != width * layout.num_points:
        raise MeshError(f"expected {layout.num_points} points of {width} numbers, got {len(words)} numbers")
    rows = np.array(words, dtype=bytes).reshape(-1, max(width, 1))
    chosen = [int(places[list(widths).index(axis)]) for axis in layout.columns]
    try:
        return rows[:, chosen].astype(np.float64)
    except ValueError:
        raise MeshError(f"expected numbers in the columns {', '.join(layout.columns)}") from None


def _binary(body: bytes, layout: _Layout) -> NDArray[np.float64]:
    if len(body) < layout.num_points * layout.dtype.itemsize:
        found = len(body) // layout.dtype.itemsize
        raise MeshError(f"cut short: its header announces {layout.num_points} points, but the file has {found}")
    records = np.frombuffer(body, layout.dtype, layout.num_points)
    return np.stack([records[axis][:, 0].astype(np.float64) for axis in layout.columns], axis=1)


def _compressed(body: bytes, layout: _Layout) -> NDArray[np.float64]:
    """Read columns that LZF compressed, one after the other."""
    if len(body) < 8:
        raise MeshError("cut short within its compressed points")
    packed, size = (int(number) for number in np.frombuffer(body, "<u4", 2))
    if size != layout.num_points * layout.dtype.itemsize or packed > len(body) - 8:
        raise MeshError(f"expected {packed} compressed bytes for {layout.num_points} points, got other numbers")
    columns = _decompressed(body[8 : 8 + packed], size)
    start, points = 0, {}
    for name, field in (layout.dtype.fields or {}).items():
        if name in layout.columns:
            points[name] = np.frombuffer(columns, field[0].base, layout.num_points, start).astype(np.float64)
        start += layout.num_points * field[0].itemsize
    return np.stack([points[axis] for axis in layout.columns], axis=1)


def _decompressed(data: bytes, size: int) -> bytes:
    """Return data that LZF compressed: runs of literal bytes, and copies of earlier ones."""
    result = bytearray()
    place = 0
    while place < len(data) and len(result) <= size:
        control = data[place]
        place += 1
        if control < 32:
            result += data[place : place + control + 1]
            place += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[place] if place < len(data) else 0
            place += 1
        back = ((control & 31) << 8 | (data[place] if place < len(data) else 0)) + 1
        place += 1
        if back > len(result):
            raise MeshError("its compressed points are damaged")
        start = len(result) - back
        piece = result[start : start + length + 2]
        result += (piece * (-(-(length + 2) // len(piece))))[: length + 2]
    if len(result) != size:
        raise MeshError(f"its compressed points are {len(result)} bytes; expected {size}")
    return bytes(result)
