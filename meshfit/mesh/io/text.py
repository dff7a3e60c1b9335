"""Lines of text files: numbered, split into words, without comments; and the numbers on them."""

import re
import warnings
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.io.pipes import pipe_chunks
from meshfit.paths import is_pipe, is_regular_file, not_a_file_message, path_text, read_error_message

Lines = Iterator[tuple[int, list[bytes]]]

MOST_BYTES = 100_000_000
"""The largest size of a small text file: a line for each vertex of a large mesh."""
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_INTEGER = re.compile(rb"[-+]?\d+")
_MOST_DIGITS = 15
_DIGITS_TO_ZERO = bytes.maketrans(b"123456789", b"000000000")
# What the C library of Windows has printed for numbers that are not finite, such as `-1.#IND00` and `-nan(ind)`.
_NOT_FINITE = re.compile(rb"[-+]?\d\.#\w*|[-+]?nan\(\w*\)", re.IGNORECASE)
_NOT_A_COMMENT = re.compile(rb"\d\.#(?:QNAN|SNAN|IND|INF)\d*\b")
_COMMENT = re.compile(rb"#[^\n]*")


def plain_text(content: bytes) -> bytes:
    """Return a text without byte order mark, end marks and comments, which begin with `#`, and with LF line ends."""
    text = content.removeprefix(BYTE_ORDER_MARK).rstrip(b"\0\x1a")
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"#" in text:
        text = _NOT_A_COMMENT.sub(b"nan", text) if b".#" in text else text
        text = _COMMENT.sub(b"", text)
    return text


def split_lines(content: bytes) -> Lines:
    """Yield the number and the words of each line that is not empty; `#` begins a comment."""
    for number, line in enumerate(content.removeprefix(BYTE_ORDER_MARK).splitlines(), 1):
        if words := line.partition(b"#")[0].split():
            yield number, words


def read_small_file(path: str | Path, suffixes: Collection[str] = (".txt",)) -> bytes:
    """Return the content of a small file of the user's, which may be a pipe.

    Args:
        path: its path.
        suffixes: those of the files to suggest where there is none.

    Raises:
        MeshError: it cannot be read, is no file, has more than `MOST_BYTES`, or is a pipe without a writer.
    """
    shown = path_text(path)
    if not (is_regular_file(path) or is_pipe(path)):
        raise MeshError(f"{shown}: {not_a_file_message(path, suffixes)}")
    try:
        if is_pipe(path):
            content = _start_of_pipe(path)
        else:
            with Path(path).open("rb") as file:
                content = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise MeshError(f"{shown}: {read_error_message(error)}") from error
    if len(content) > MOST_BYTES:
        raise MeshError(f"{shown}: larger than {MOST_BYTES // 1_000_000} MB; expected a small text file")
    return content


def decoded_text(content: bytes) -> str | None:
    """Return a text in UTF-8, without a byte order mark; None for any other content, such as a binary file."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return None
    return None if "\0" in text else text


def _start_of_pipe(path: str | Path) -> bytes:
    content = bytearray()
    for chunk in pipe_chunks(path):
        content += chunk
        if len(content) > MOST_BYTES:
            break
    return bytes(content)


def read_word_lines(path: str | Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the words of each line of a UTF-8 text file that is not empty; `#` begins a comment.

    Raises:
        MeshError: the file cannot be read, or is not UTF-8 text.
    """
    text = decoded_text(read_small_file(path))
    if text is None:
        raise MeshError(f"{path_text(path)}: not a text file in UTF-8")
    for number, line in enumerate(text.splitlines(), 1):
        if words := line.partition("#")[0].split():
            yield number, words


def parse_float(word: bytes) -> float | None:
    """Return a number; NaN for the ways in which Windows spells it; None for any other word."""
    try:
        return None if b"_" in word else float(word)
    except ValueError:
        return float("nan") if _NOT_FINITE.fullmatch(word) else None


def parse_floats(text: bytes) -> NDArray[np.float64] | None:
    """Return all numbers of a text, correctly rounded, or None if one of its words is not a number."""
    text = _NOT_FINITE.sub(b"nan", text) if b"#" in text else text
    if not text.strip():
        return np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def parse_point_rows(text: bytes, mark: bytes, count: int) -> NDArray[np.float64] | None:
    """Return (N, 3) the first three of the numbers that follow each of N marks; None if anything is unusual.

    A mark is read as NaN, and is nowhere else in the text.
    """
    numbers = parse_floats(text.replace(mark, b" nan "))
    if numbers is None:
        return None
    marks = np.flatnonzero(np.isnan(numbers))
    if len(marks) != count or (np.diff(marks, append=len(numbers)) < 4).any():
        return None
    if len(numbers) == 4 * count:
        return numbers.reshape(-1, 4)[:, 1:].copy()
    return np.asarray(numbers[marks[:, None] + [1, 2, 3]])


def parse_ints(text: bytes) -> NDArray[np.int64] | None:
    """Return all integers of a text, or None if one of its words is not an integer or has too many digits."""
    if not text.strip():
        return np.empty(0, dtype=np.int64)
    if b"-" in text or b"+" in text:  # NumPy would take one before a blank for the sign of the next number
        digits = text.translate(_DIGITS_TO_ZERO)
        if digits.count(b"-0") + digits.count(b"+0") != digits.count(b"-") + digits.count(b"+"):
            return None
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            numbers = np.fromstring(text, dtype=np.int64, sep=" ")
        except (ValueError, DeprecationWarning):
            return None
    limit = 10**_MOST_DIGITS
    return numbers if -limit < numbers.min() and numbers.max() < limit else None


def parse_point(words: Sequence[bytes], number: int) -> list[float]:
    """Return the three coordinates that a line begins with.

    Raises:
        MeshError: naming the line.
    """
    if len(words) < 3:
        raise MeshError(f"line {number}: expected a vertex of 3 coordinates, got {len(words)}")
    point = [value for word in words[:3] if (value := parse_float(word)) is not None]
    if len(point) < 3:
        raise MeshError(f"line {number}: expected three numbers, got {quoted(words[:3])}")
    return point


def parse_integers(words: Sequence[bytes], number: int, line: Sequence[bytes] = ()) -> list[int]:
    """Return the words of a line as integers; messages quote the line, where it has other words.

    Raises:
        MeshError: naming the line.
    """
    if not all(map(_INTEGER.fullmatch, words)):
        raise MeshError(f"line {number}: expected integers, got {quoted(line or words)}")
    if max(map(len, words), default=0) > _MOST_DIGITS:
        raise MeshError(f"line {number}: expected integers of up to {_MOST_DIGITS} digits, got {quoted(line or words)}")
    return [int(word) for word in words]


def quoted(words: Sequence[bytes]) -> str:
    """Return words in quotes, cut at 40 characters."""
    text = b" ".join(words).decode("ascii", "backslashreplace")
    return repr(text if len(text) <= 40 else text[:39] + "…")
