"""Memory that is available, and work that would need more of it."""

import os
import re
from collections.abc import Iterable
from pathlib import Path

from meshfit.errors import MeshError
from meshfit.units import size_text

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_MEMINFO = Path("/proc/meminfo")
_CGROUP = Path("/sys/fs/cgroup")
_UNCHECKED = 64_000_000
_STATM = Path("/proc/self/statm")


def available_memory() -> int | None:
    """Return the bytes that this process can still take: of the system, its container and its own limit.

    None where the system does not tell.
    """
    known = [size for size in (_of_system(), _of_container(), _of_limit()) if size is not None]
    return max(0, min(known)) if known else None


def require_memory(num_bytes: float, what: str, remedy: str) -> None:
    """Refuse work that needs more memory than is available, before it is begun.

    Args:
        num_bytes: that the work surely needs.
        what: it makes, for the message, such as `8 levels make 1,310,720 faces`.
        remedy: what to do, for the message.

    Raises:
        MeshError: it is more than is available.
    """
    available = available_memory()
    if available is not None and num_bytes > available:
        needed, there = size_text(int(num_bytes)), size_text(available)
        raise MeshError(f"{what}, about {needed} of memory, and {there} are available; {remedy}")


def joined(chunks: Iterable[bytes], what: str, remedy: str) -> bytes:
    """Return chunks as one, unless there are more than memory has room for.

    Args:
        chunks: parts of a content whose size is not known.
        what: it is, for the message, such as `its content unpacks`.
        remedy: what to do, for the message.

    Raises:
        MeshError: as `require_memory`, for a copy of what has been read so far.
    """
    parts, size, looked_at = list[bytes](), 0, 0
    for chunk in chunks:
        parts.append(chunk)
        size += len(chunk)
        if size > looked_at + _UNCHECKED:
            looked_at = size
            require_memory(size, f"{what} to more than {size_text(size)}", remedy)
    return b"".join(parts)


def _of_system() -> int | None:
    found = re.search(r"^MemAvailable:\s*(\d+) kB$", _read(_MEMINFO), re.MULTILINE)
    return None if found is None else 1024 * int(found[1])


def _of_container() -> int | None:
    limit, used = _read(_CGROUP / "memory.max").strip(), _read(_CGROUP / "memory.current").strip()
    return int(limit) - int(used) if limit.isdecimal() and used.isdecimal() else None


def _of_limit() -> int | None:
    """The address space that `ulimit -v` leaves."""
    if resource is None or (limit := resource.getrlimit(resource.RLIMIT_AS)[0]) == resource.RLIM_INFINITY:
        return None
    pages = _read(_STATM).split()
    return limit - (int(pages[0]) * os.sysconf("SC_PAGE_SIZE") if pages else 0)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except OSError:
        return ""
