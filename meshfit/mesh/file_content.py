"""The bytes of a file, and what to say where they cannot be had, written or made sense of."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from meshfit.errors import MeshError
from meshfit.paths import missing, unwritable


def known_suffix(path: Path, suffixes: Sequence[str], what: str) -> str:
    """The suffix of a path, in small letters.

    Args:
        path: of a file to be read or written.
        suffixes: those that are known.
        what: they are formats of, such as `mesh`.

    Raises:
        MeshError: another one, or none.
    """
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        found = (
            f"'{path.suffix}' is not a {what} format that is known"
            if path.suffix
            else "no suffix to tell its format by"
        )
        raise MeshError(f"{path}: {found}; allowed: {', '.join(suffixes)}")
    return suffix


def read_content(path: Path, suffixes: Sequence[str]) -> bytes:
    """What a file holds.

    Args:
        path: of the file.
        suffixes: of files that could have been meant where there is none.

    Raises:
        MeshError: no such file, one that cannot be read, or an empty one.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise MeshError(f"{path}: {missing(path, suffixes)}") from None
    except OSError as error:
        raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
    if not content.strip():
        raise MeshError(f"{path}: the file is empty")
    return content


def write_content(path: Path, content: bytes) -> None:
    """Write a file.

    Raises:
        MeshError: it cannot be written.
    """
    try:
        path.write_bytes(content)
    except OSError as error:
        raise MeshError(f"{path}: {unwritable(path, error)}") from error


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn whatever goes wrong while a damaged file is made sense of into one line.

    Raises:
        MeshError: in place of any other exception.
    """
    try:
        yield
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MeshError(f"{path}: cannot be read as {path.suffix[1:].upper()}: {reason}") from error
