"""Point clouds in LAS files, and in LAZ files, which are compressed."""

import importlib.util
import re
import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.io.raw_points import RawPoints

_COMPRESSED = 0b1100_0000
# A LAZ file may announce this many points for nothing, and one more for each byte.
_FREE_POINTS = 1_000_000
_SIGKILL = 9
_FREE_SECONDS, _BYTES_PER_SECOND = 5, 200_000
_LASZIP = b"laszip encoded\0"
# Length of a record of each point format without extra bytes, and types of extra bytes, from 1 on.
_LENGTHS = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
_TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
_NORMALS = [[f"{name}{axis}" for axis in "xyz"] for name in ("normal", "normals", "n")]


class _Extra(NamedTuple):
    """A number in the extra bytes of a record, and its column if it is one of several of that name."""

    name: str
    place: int
    code: str
    scale: float
    offset: float
    column: int | None


class _Header(NamedTuple):
    """Where the points are, how many, how long each record is, and how their integers become coordinates."""

    start: int
    num_points: int
    length: int
    form: int
    first_record: int
    num_records: int
    compressed: bool
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]


def read_las(content: bytes) -> RawPoints:
    """Read the points of a LAS or LAZ file, in its units, with normals if they are among its extra bytes.

    Extra bytes are normals where three are named like NormalX, nx or `normal_x`.

    Raises:
        MeshError: a damaged file, no points, or a LAZ file where no decoder is installed.
    """
    header = _header(content)
    extra = _extra_bytes(content, header)
    integers, normals = (_decoded_laz if header.compressed else _records)(content, header, extra)
    with np.errstate(over="ignore", invalid="ignore"):
        points = integers * header.scale + header.offset
    if not np.isfinite(points).all():
        raise MeshError("its scale or offset makes coordinates that are not finite")
    return RawPoints(np.asarray(points), normals)


def count_las(content: bytes) -> int:
    """Return the number of points that a LAS or LAZ file announces."""
    return _header(content).num_points


def _header(content: bytes) -> _Header:
    if not content.startswith(b"LASF") or len(content) < 227:
        raise MeshError(f"expected 'LASF' and a header of 227 bytes or more, got {min(len(content), 227)} other bytes")
    major, minor = content[24:26]
    if major != 1:
        raise MeshError(f"version {major}.{minor}; expected 1.0 to 1.4")
    first_record, (start, records, form, length, count) = _at(content), struct.unpack_from("<IIBHI", content, 96)
    if minor >= 4 and len(content) >= 255:
        count = struct.unpack_from("<Q", content, 247)[0] or count
    if not count:
        raise MeshError("no points in it")
    if length < 12 or start < 227:
        raise MeshError(f"expected records of 12 bytes or more after the header, got {length} bytes at byte {start}")
    numbers = np.frombuffer(content, "<f8", 6, 131)
    if not np.isfinite(numbers).all() or not numbers[:3].all():
        raise MeshError("expected a scale and an offset that are finite, and a scale that is not 0")
    compressed, form = bool(form & _COMPRESSED), form & ~_COMPRESSED
    return _Header(start, count, length, form, first_record, records, compressed, numbers[:3], numbers[3:])


def _at(content: bytes) -> int:
    return int(struct.unpack_from("<H", content, 94)[0])


def _extra_bytes(content: bytes, header: _Header) -> list[_Extra]:
    """Return the extra bytes that hold normals, x, y and z; none if there are none."""
    if header.form >= len(_LENGTHS):
        return []
    place, at = header.first_record, _LENGTHS[header.form]
    for _ in range(header.num_records):
        if place + 54 > header.start or place + 54 > len(content):
            return []
        user, number, length = struct.unpack_from("<16sHH", content, place + 2)
        if (user.rstrip(b"\0"), number) == (b"LASF_Spec", 4):
            break
        place += 54 + length
    else:
        return []
    found: dict[str, _Extra] = {}
    for start in range(place + 54, min(place + 54 + length, len(content)) - 191, 192):
        kind, options, name = struct.unpack_from("<BB32s", content, start + 2)
        if not 1 <= kind <= 30:
            at += options
            continue
        code, count = _TYPES[(kind - 1) % 10], 1 + (kind - 1) // 10
        scales, offsets = (struct.unpack_from("<3d", content, start + at_numbers) for at_numbers in (112, 136))
        text = name.partition(b"\0")[0].decode("utf-8", "replace")
        for axis in range(count):
            key = re.sub(r"[^a-z]", "", text.lower()) + ("" if count == 1 else "xyz"[axis])
            scale, offset = scales[axis] if options & 8 else 1.0, offsets[axis] if options & 16 else 0.0
            found.setdefault(key, _Extra(text, at, code, scale, offset, None if count == 1 else axis))
            at += int(code[1])
    chosen = ([found.get(name) for name in names] for names in _NORMALS)
    return next((list(filter(None, axes)) for axes in chosen if all(axes)), [])


def _records(
    content: bytes, header: _Header, extra: list[_Extra]
) -> tuple[NDArray[np.int32], NDArray[np.float64] | None]:
    available = max(len(content) - header.start, 0) // header.length
    if available < header.num_points:
        raise MeshError(f"cut short: its header announces {header.num_points} points, but the file has {available}")
    shape, strides = (header.num_points, 3), (header.length, 4)
    points = np.ndarray(shape, "<i4", content, header.start, strides)
    if not extra or any(axis.place + int(axis.code[1]) > header.length for axis in extra):
        return points, None
    columns = [
        np.ndarray(shape[:1], f"<{axis.code}", content, header.start + axis.place, strides[:1]) * axis.scale
        + axis.offset
        for axis in extra
    ]
    return points, np.stack(columns, axis=1).astype(np.float64)


def _decoded_laz(
    content: bytes, header: _Header, extra: list[_Extra]
) -> tuple[NDArray[np.int32], NDArray[np.float64] | None]:
    if header.num_points > _FREE_POINTS + len(content):
        raise MeshError(f"announces {header.num_points} points, far more than {len(content)} bytes can hold")
    if _LASZIP not in content[: header.start]:
        raise MeshError("its points are compressed, but no record says how")
    if importlib.util.find_spec("laspy") is None or importlib.util.find_spec("lazrs") is None:
        raise MeshError("LAZ needs a decoder: pip install 'meshfit[las]', or convert the file to LAS")
    # Damaged data makes the decoder end its process, after lines on standard error.
    names = [f"{'' if axis.column is None else axis.column}:{axis.name}" for axis in extra]
    command = [sys.executable, "-P", str(Path(__file__).with_name("laz_process.py")), *names]
    timeout = _FREE_SECONDS + len(content) / _BYTES_PER_SECOND
    try:
        decoded = subprocess.run(command, input=content, capture_output=True, timeout=timeout, check=True).stdout  # noqa: S603
    except subprocess.CalledProcessError as error:
        if error.returncode == -_SIGKILL:
            raise MeshError("the process that decodes it was killed; perhaps there was not enough memory") from None
        raise MeshError("its compressed points are damaged") from None
    except (OSError, subprocess.SubprocessError):
        raise MeshError("its compressed points are damaged") from None
    width = 36 if names else 12
    if len(decoded) != width * header.num_points:
        raise MeshError(f"its header announces {header.num_points} points, but {len(decoded) // width} are there")
    points = np.frombuffer(decoded, "<i4", 3 * header.num_points).reshape(-1, 3)
    return points, np.frombuffer(decoded, "<f8", -1, 12 * header.num_points).reshape(-1, 3) if names else None
