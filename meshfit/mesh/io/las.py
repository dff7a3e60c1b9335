"""Point clouds in LAS files, and in LAZ files, which are compressed."""

import importlib.util
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
_FREE_SECONDS, _BYTES_PER_SECOND = 5, 200_000
_LASZIP = b"laszip encoded\0"


class _Header(NamedTuple):
    """Where the points are, how many, how long each record is, and how their integers become coordinates."""

    start: int
    num_points: int
    length: int
    compressed: bool
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]


def read_las(content: bytes) -> RawPoints:
    """Read the points of a LAS or LAZ file, in its units.

    Raises:
        MeshError: a damaged file, no points, or a LAZ file where no decoder is installed.
    """
    header = _header(content)
    integers = _decoded_laz(content, header) if header.compressed else _records(content, header)
    with np.errstate(over="ignore", invalid="ignore"):
        points = integers * header.scale + header.offset
    if not np.isfinite(points).all():
        raise MeshError("its scale or offset makes coordinates that are not finite")
    return RawPoints(np.asarray(points))


def count_las(content: bytes) -> int:
    """Return the number of points that a LAS or LAZ file announces."""
    return _header(content).num_points


def _header(content: bytes) -> _Header:
    if not content.startswith(b"LASF") or len(content) < 227:
        raise MeshError(f"expected 'LASF' and a header of 227 bytes or more, got {min(len(content), 227)} other bytes")
    major, minor = content[24:26]
    if major != 1:
        raise MeshError(f"version {major}.{minor}; expected 1.0 to 1.4")
    start, _, form, length, count = struct.unpack_from("<IIBHI", content, 96)
    if minor >= 4 and len(content) >= 255:
        count = struct.unpack_from("<Q", content, 247)[0] or count
    if not count:
        raise MeshError("no points in it")
    if length < 12 or start < 227:
        raise MeshError(f"expected records of 12 bytes or more after the header, got {length} bytes at byte {start}")
    numbers = np.frombuffer(content, "<f8", 6, 131)
    if not np.isfinite(numbers).all() or not numbers[:3].all():
        raise MeshError("expected a scale and an offset that are finite, and a scale that is not 0")
    return _Header(start, count, length, bool(form & _COMPRESSED), numbers[:3], numbers[3:])


def _records(content: bytes, header: _Header) -> NDArray[np.int32]:
    available = max(len(content) - header.start, 0) // header.length
    if available < header.num_points:
        raise MeshError(f"cut short: its header announces {header.num_points} points, but the file has {available}")
    shape, strides = (header.num_points, 3), (header.length, 4)
    return np.ndarray(shape, "<i4", content, header.start, strides)


def _decoded_laz(content: bytes, header: _Header) -> NDArray[np.int32]:
    if header.num_points > _FREE_POINTS + len(content):
        raise MeshError(f"announces {header.num_points} points, far more than {len(content)} bytes can hold")
    if _LASZIP not in content[: header.start]:
        raise MeshError("its points are compressed, but no record says how")
    if importlib.util.find_spec("laspy") is None or importlib.util.find_spec("lazrs") is None:
        raise MeshError("LAZ needs a decoder: pip install 'meshfit[las]', or convert the file to LAS")
    # Damaged data makes the decoder end its process, after lines on standard error.
    command = [sys.executable, "-P", str(Path(__file__).with_name("laz_process.py"))]
    timeout = _FREE_SECONDS + len(content) / _BYTES_PER_SECOND
    try:
        decoded = subprocess.run(command, input=content, capture_output=True, timeout=timeout, check=True).stdout  # noqa: S603
    except (OSError, subprocess.SubprocessError):
        raise MeshError("its compressed points are damaged") from None
    if len(decoded) != 12 * header.num_points:
        raise MeshError(f"its header announces {header.num_points} points, but {len(decoded) // 12} are there")
    return np.frombuffer(decoded, "<i4").reshape(-1, 3)
