"""Lines of text files: numbered, split into words, without comments; and the numbers on them."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from meshfit.errors import MeshError

Lines = Iterator[tuple[int, list[bytes]]]

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def split_lines(content: bytes) -> Lines:
    """Yield the number and the words of each line that is not empty; `#` begins a comment."""
    for number, line in enumerate(content.removeprefix(_BYTE_ORDER_MARK).splitlines(), 1):
        if words := line.partition(b"#")[0].split():
            yield number, words


def read_word_lines(path: str | Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the words of each line of a UTF-8 text file that is not empty; `#` begins a comment.

    Raises:
        MeshError: the file cannot be read, or is not UTF-8 text.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise MeshError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
    for number, line in enumerate(text.splitlines(), 1):
        if words := line.partition("#")[0].split():
            yield number, words


def parse_point(words: Sequence[bytes], number: int) -> list[float]:
    """Return the three coordinates that a line begins with.

    Raises:
        MeshError: naming the line.
    """
    if len(words) < 3:
        raise MeshError(f"line {number}: expected a vertex of 3 coordinates, got {len(words)}")
    try:
        return [float(word) for word in words[:3]]
    except ValueError:
        raise MeshError(f"line {number}: expected three numbers, got {quoted(words[:3])}") from None


def parse_integers(words: Sequence[bytes], number: int) -> list[int]:
    """Return the words of a line as integers.

    Raises:
        MeshError: naming the line.
    """
    try:
        return [int(word) for word in words]
    except ValueError:
        raise MeshError(f"line {number}: expected integers, got {quoted(words)}") from None


def quoted(words: Sequence[bytes]) -> str:
    """Return words in quotes, cut at 40 characters."""
    text = b" ".join(words).decode("ascii", "backslashreplace")
    return repr(text if len(text) <= 40 else text[:39] + "…")
