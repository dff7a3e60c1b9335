"""Open mesh and curve files: from a path, a pipe or standard input, compressed or not, in a format that is known."""

import os
import re
import sys
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from meshfit.doors import no_type_check
from meshfit.errors import FormatError, MeshError
from meshfit.memory import joined, require_memory
from meshfit.mesh.io.compression import COMPRESSIONS, compress, compression_of, decompress, decompressed_head
from meshfit.mesh.io.pipes import pipe_chunks
from meshfit.mesh.io.recognition import Kind, format_name, guess, kind_of_suffix, recognise
from meshfit.paths import (
    STDOUT_PATHS,
    STREAM,
    compression_suffix,
    file_stem,
    format_suffix,
    is_folder,
    is_pipe,
    is_regular_file,
    not_a_file_message,
    path_text,
    quoted_path,
    read_error_message,
    uncompressed,
    write_error_message,
)
from meshfit.printable import described

_HEAD = 1 << 16
_STDOUT = 1
_CHUNK = 1 << 20
_THIN = "thin the mesh in the tool that wrote it, or free some memory"
_COUNTS = re.compile(rb"\s*(#[^\n]*\n\s*)*\d+[ \t]+\d+([ \t]+\d+)?[ \t]*[\r\n]")


@dataclass(frozen=True)
class MeshFile:
    """A mesh or curve file that has been read.

    Attributes:
        name: of the file in messages.
        suffix: of its format, in lower case.
        content: its bytes, unpacked.
        path: of the file; None for standard input.
        named: whether the caller gave the format, rather than the file's suffix.
    """

    name: str
    suffix: str
    content: bytes
    path: Path | None = None
    named: bool = False

    @property
    def folder(self) -> Path | None:
        """The folder of the files that it refers to: its own; None if it came through a stream."""
        return None if self.path is None or is_pipe(self.path) else self.path.parent


@no_type_check
def read_file(path: str | Path, suffixes: Collection[str], kind: str, file_format: str | None = None) -> MeshFile:
    """Read a file whose format is told by its suffix, or given.

    Args:
        path: of the file; the text `-` is standard input. A pipe is read too, if its format is given.
        suffixes: of the formats that can be read, in lower case.
        kind: of the file in messages: `mesh` or `curve`.
        file_format: the format, such as `ply`, in place of the suffix; the content may then be compressed under any
            name.

    Raises:
        FormatError: the format is not known, or the content is not of it.
        MeshError: no such file, one that cannot be read, or compression that is damaged.
    """
    given = None if file_format is None else _given_suffix(file_format, suffixes, kind)
    if path == STREAM:
        return _checked(_read_standard_input(given, suffixes), suffixes)
    name = path_text(path)
    if not is_regular_file(path):
        if not is_pipe(path):
            raise MeshError(f"{name}: {not_a_file_message(path, suffixes)}")
        if given is None and not format_suffix(path):
            raise _without_suffix(name, suffixes)
    path, suffix = Path(path), given or format_suffix(path)
    if suffix not in suffixes:
        raise _unknown_format(path, name, suffixes, kind)
    content = _read_bytes(path, name)
    packed = compression_suffix(path) or (compression_of(content) if given else "")
    return _checked(MeshFile(name, suffix, _unpacked(name, path, content, packed), path, given is not None), suffixes)


def wrong_format(file: MeshFile, suffixes: Collection[str]) -> FormatError | None:
    """Return the error for a file that cannot be parsed, if its content looks like another format."""
    kind = guess(file.content, len(file.content))
    if kind is None or file.suffix in kind.suffixes or not (kind.remedy or _readable(kind, suffixes)):
        return None
    if file.suffix == ".off" and _COUNTS.match(file.content):  # an OFF file without its keyword is rows of numbers too
        return None
    return _mismatch(file, kind, suffixes)


@no_type_check
def output_suffix(path: str | Path, suffixes: Collection[str], kind: str, file_format: str | None = None) -> str:
    """Return the suffix of the format to write, in lower case.

    Args:
        path: of the file to write; the text `-` is standard output.
        suffixes: of the formats that can be written, in lower case.
        kind: of the file in messages: `mesh` or `curve`.
        file_format: the format, in place of the suffix.

    Raises:
        FormatError: a format that is not known, or not that of the suffix.
        MeshError: a directory, or an empty path.
    """
    name = "standard output" if path in STDOUT_PATHS else path_text(path)
    if not str(path):
        raise MeshError(f"{name}: the path is empty; give the path of a file to write")
    if path != STREAM and is_folder(path):
        raise MeshError(f"{name}: cannot be written: it is a directory; give the path of a file")
    suffix = format_suffix(path)
    if file_format is not None:
        given = _given_suffix(file_format, suffixes, kind)
        if suffix in suffixes and suffix != given:
            finding = f"{name}: its suffix names {format_name(suffix)}, but the format to write is {format_name(given)}"
            raise FormatError(finding, f"end the name in {given}")
        return given
    if path in STDOUT_PATHS:
        raise _without_suffix(name, suffixes)
    if suffix in suffixes:
        return suffix
    foreign = kind_of_suffix(suffix) if kind == "mesh" else None
    if foreign is not None:
        raise FormatError(f"{name}: {foreign.name} cannot be written", _allowed(suffixes))
    raise FormatError(f"{name}: {_suffix_fault(Path(path), kind)}", _allowed(suffixes), "FORMAT")


def write_file(path: str | Path, content: bytes) -> None:
    """Write the content of a file, compressed if its suffix says so; the text `-` is standard output.

    A reader of a file sees all of it or nothing; pipes and devices are written as they are.

    Raises:
        MeshError: a path that cannot be written.
    """
    if path in STDOUT_PATHS:
        _write_standard_output(content)
        return
    path = Path(path)
    packed = compression_suffix(path)
    data = compress(content, packed) if packed else content
    try:
        if is_regular_file(path) or not os.path.lexists(path):
            replace_file(path, data)
            return
        path.write_bytes(data)
    except OSError as error:
        raise MeshError(f"{path_text(path)}: {write_error_message(path, error)}") from error
    except ValueError:
        raise MeshError(f"{path_text(path)}: no file can have this name; give another one") from None


def replace_file(path: Path, content: bytes) -> None:
    """Write a file that is there whole or not at all, and leave one of the same content as it is.

    Raises:
        MeshError: a path that cannot be written.
    """
    try:
        whole = Path(os.path.realpath(path))  # a link stays
        part = whole.with_name(f".{whole.name}.{os.getpid()}.part")
        if is_regular_file(path) and path.stat().st_size == len(content) and path.read_bytes() == content:
            return
        try:
            part.write_bytes(content)
            part.replace(whole)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise MeshError(f"{path_text(path)}: {write_error_message(path, error)}") from error
    except ValueError:
        raise MeshError(f"{path_text(path)}: no file can have this name; give another one") from None


def _write_standard_output(content: bytes) -> None:
    if sys.stdout is None:  # closed by the shell
        raise MeshError("standard output: it is closed; give the path of a file")
    try:
        sys.stdout.flush()
        with open(_STDOUT, "wb", buffering=0, closefd=False) as stream:
            left = memoryview(content)
            while left:
                left = left[stream.write(left) or 0 :]
    except BrokenPipeError:  # the reader has had enough
        raise
    except OSError as error:
        raise MeshError(f"standard output: {write_error_message(Path(STREAM), error)}") from error


@no_type_check
def suffix_of_format(file_format: str) -> str:
    """Return the suffix of a format that a caller gives, such as `ply` or `.PLY`.

    Raises:
        MeshError: not a text.
    """
    if not isinstance(file_format, str):
        raise MeshError(f"file_format: expected the name of a format, such as 'ply', got {described(file_format)}")
    return f".{file_format.lower().removeprefix('.')}"


@no_type_check
def _given_suffix(file_format: str, suffixes: Collection[str], kind: str) -> str:
    suffix = suffix_of_format(file_format)
    if suffix not in suffixes:
        allowed = ", ".join(suffix[1:] for suffix in suffixes)
        raise MeshError(f"unknown {kind} format '{file_format}'; allowed: {allowed}")
    return suffix


def _read_standard_input(suffix: str | None, suffixes: Collection[str]) -> MeshFile:
    name = "standard input"
    if suffix is None:
        raise _without_suffix(name, suffixes)
    try:
        stream = sys.stdin.buffer
        if stream.isatty():
            raise MeshError(f"{name}: it is a terminal; pipe a mesh file into the command, or give a path")
        content = _joined(iter(partial(stream.read, _CHUNK), b""), name)
    except (AttributeError, ValueError):
        raise MeshError(f"{name}: it is closed; pipe a mesh file into the command, or give a path") from None
    except OSError as error:
        raise MeshError(f"{name}: {read_error_message(error)}") from error
    return MeshFile(name, suffix, _unpacked(name, None, content, compression_of(content)), named=True)


def _read_bytes(path: Path, name: str) -> bytes:
    try:
        if is_pipe(path):
            return _joined(pipe_chunks(path), name)
        size = path.stat().st_size
        require_memory(size, f"{name}: the file is read whole", _THIN)
        return path.read_bytes()
    except OSError as error:
        raise MeshError(f"{name}: {read_error_message(error)}") from error
    except MemoryError:
        raise MeshError(f"{name}: the file needs more memory than is free") from None


def _joined(chunks: Iterable[bytes], name: str) -> bytes:
    return joined(chunks, f"{name}: it adds up", _THIN)


def _unpacked(name: str, path: Path | None, content: bytes, packed: str) -> bytes:
    if not packed or not content:
        return content
    if not content.startswith(COMPRESSIONS[packed].start):
        rename = f"; rename it to {quoted_path(uncompressed(path).name)}" if path is not None else ""
        kind = COMPRESSIONS[packed].name
        raise MeshError(f"{name}: its content is not compressed with {kind}{rename}")
    try:
        return decompress(content, packed)
    except MeshError as error:
        raise MeshError(f"{name}: {error}") from None
    except MemoryError:
        raise MeshError(f"{name}: the file needs more memory than is free") from None


def _checked(file: MeshFile, suffixes: Collection[str]) -> MeshFile:
    """Refuse an empty file, and content with the signature of another format."""
    if not file.content or file.content.isspace():
        raise MeshError(f"{file.name}: the file is empty")
    if file.content.startswith(b"\0") and not file.content.strip(b"\0"):
        raise MeshError(f"{file.name}: the file holds nothing but zeros; copy or download it again")
    packed = compression_of(file.content)
    if packed:
        rename = "" if file.path is None or file.named else f"; rename it to {quoted_path(file.path.name + packed)}"
        raise MeshError(f"{file.name}: its content is compressed with {COMPRESSIONS[packed].name}{rename}")
    kind = recognise(file.content)
    if kind is not None and file.suffix not in kind.suffixes:
        raise _mismatch(file, kind, suffixes)
    return file


def _mismatch(file: MeshFile, kind: Kind, suffixes: Collection[str]) -> FormatError:
    finding = f"{file.name}: its content looks like {kind.name}, not {format_name(file.suffix)}"
    readable = _readable(kind, suffixes)
    if not readable:
        return FormatError(finding, kind.remedy)
    rename = "" if file.path is None or file.named else _rename(file.path, readable)
    return FormatError(finding, rename, readable[1:])


def _readable(kind: Kind, suffixes: Collection[str]) -> str:
    return next((suffix for suffix in kind.suffixes if suffix in suffixes), "")


def _rename(path: Path, suffix: str, packed: str = "") -> str:
    stem = file_stem(path.name.strip()).removesuffix(suffix)  # browsers add `.txt` to `scan.obj`
    return f"rename it to {quoted_path(stem + suffix + (packed or compression_suffix(path)))}"


def _without_suffix(name: str, suffixes: Collection[str]) -> FormatError:
    formats = "|".join(suffix[1:] for suffix in suffixes)
    return FormatError(f"{name}: there is no suffix to tell the format", "", formats)


def _unknown_format(path: Path, name: str, suffixes: Collection[str], kind: str) -> FormatError:
    """Return the error for a suffix that is not known, with what the content looks like."""
    foreign = kind_of_suffix(format_suffix(path)) if kind == "mesh" else None
    if foreign is not None:
        return FormatError(f"{name}: {foreign.name} cannot be read", foreign.remedy)
    finding = f"{name}: {_suffix_fault(path, kind)}"
    found, packed = (None, "") if is_pipe(path) else _guess_of_file(path)
    if found is None or format_suffix(path) in found.suffixes:
        return FormatError(finding, _allowed(suffixes), "FORMAT")
    finding = f"{finding}; its content looks like {found.name}"
    if readable := _readable(found, suffixes):
        return FormatError(finding, _rename(path, readable, packed), readable[1:])
    return FormatError(finding, found.remedy or _allowed(suffixes))


def _guess_of_file(path: Path) -> tuple[Kind | None, str]:
    """Return the kind of file that a file of unknown suffix looks like, and the suffix of its compression."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
        packed = compression_of(head)
        if packed:
            return guess(decompressed_head(head, packed, _HEAD), 0), packed
        return guess(head, path.stat().st_size), ""
    except OSError:
        return None, ""


def _suffix_fault(path: Path, kind: str) -> str:
    suffix = uncompressed(path).suffix
    return f"unknown {kind} format {quoted_path(suffix)}" if suffix else f"no suffix to tell the {kind} format"


def _allowed(suffixes: Collection[str]) -> str:
    return f"allowed: {', '.join(suffixes)}"
