"""Compressed files: gzip, bzip2 and xz, limited in size when they are unpacked."""

import io
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any, NamedTuple

from meshfit.errors import MeshError
from meshfit.memory import joined
from meshfit.units import size_text

_LARGEST_RATIO = 200
_ALWAYS_ALLOWED = 16_000_000
_CHUNK = 1 << 20
_UNPACK = "if it is one, unpack it yourself"


class Compression(NamedTuple):
    """A kind of compression: its name, the first bytes of its files, and the standard library's module for it."""

    name: str
    start: bytes
    module: str


COMPRESSIONS = {
    ".gz": Compression("gzip", b"\x1f\x8b", "gzip"),
    ".bz2": Compression("bzip2", b"BZh", "bz2"),
    ".xz": Compression("xz", b"\xfd7zXZ\x00", "lzma"),
}


def compression_of(content: bytes) -> str:
    """Return the suffix of the compression that some bytes start like; empty if there is none."""
    return next((suffix for suffix, kind in COMPRESSIONS.items() if content.startswith(kind.start)), "")


def decompress(content: bytes, suffix: str) -> bytes:
    """Return the unpacked content of a compressed file.

    Raises:
        MeshError: it is cut short or damaged, or unpacks to more than 16 MB and 200 times its size, or than memory has
            room for.
    """
    kind = COMPRESSIONS[suffix]
    module, limit = _module(kind), max(_ALWAYS_ALLOWED, _LARGEST_RATIO * len(content))
    try:
        with module.open(io.BytesIO(content)) as stream:
            unpacked = joined(_chunks(stream, limit), f"its {size_text(len(content))} unpack", _UNPACK)
    except MeshError:
        raise
    except EOFError:
        raise MeshError(f"its {kind.name} compression is cut short; copy or download it again") from None
    except MemoryError:
        raise
    except Exception as error:  # zlib.error, OSError, LZMAError or ValueError, depending on the module
        raise MeshError(f"its {kind.name} compression is damaged; copy or download it again") from error
    if len(unpacked) > limit:
        sizes = f"its {size_text(len(content))} unpack to more than {size_text(limit)}"
        raise MeshError(f"{sizes}, as no mesh file should; {_UNPACK}")
    return unpacked


def decompressed_head(content: bytes, suffix: str, size: int) -> bytes:
    """Return up to so many bytes of what compressed content unpacks to, even if it is cut short; none if damaged."""
    try:
        with _module(COMPRESSIONS[suffix]).open(io.BytesIO(content)) as stream:
            return bytes(stream.read1(size))
    except Exception:  # noqa: BLE001  as in `decompress`
        return b""


def compress(content: bytes, suffix: str) -> bytes:
    """Return compressed content, without time or name: the same content gives the same bytes."""
    kind = COMPRESSIONS[suffix]
    pack: Callable[..., bytes] = _module(kind).compress
    if suffix != ".gz":
        return pack(content)
    packed = pack(content, compresslevel=6, mtime=0)
    return packed[:9] + b"\xff" + packed[10:]  # no operating system, which versions of Python fill in differently


def _chunks(stream: io.BufferedIOBase, limit: int) -> Iterator[bytes]:
    """Yield the content of a stream up to the first chunk beyond a limit in bytes."""
    while limit >= 0 and (chunk := stream.read(_CHUNK)):
        limit -= len(chunk)
        yield chunk


def _module(kind: Compression) -> Any:  # noqa: ANN401  one of three modules
    try:
        return import_module(kind.module)
    except ImportError:
        raise MeshError(f"this Python was built without {kind.name}; unpack the file first") from None
