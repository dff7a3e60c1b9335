"""Point clouds as text: XYZ, PTS, ASC, TXT and CSV, one point per line."""

import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.io.raw_points import RawPoints

_COMMENT = re.compile(rb"(?:#|//)[^\n]*")
_BLANK_BETWEEN = re.compile(rb"[^\s,;][ \t]+[^\s,;]")
_LONGEST = 40
_NORMALS = ((b"nx", b"ny", b"nz"), (b"normal_x", b"normal_y", b"normal_z"), (b"normalx", b"normaly", b"normalz"))
# Rows are taken for normals if their lengths differ from 1 by less than this, as numbers of three digits do.
_UNIT = 0.01


class _Table(NamedTuple):
    """Words of a text, with the line and the number of words of each line that has some."""

    words: list[bytes]
    numbers: Int64[np.ndarray, " L"]
    sizes: Int64[np.ndarray, " L"]

    def line(self, row: int) -> list[bytes]:
        """Return the words of a line."""
        end = int(self.sizes[: row + 1].sum())
        return self.words[end - int(self.sizes[row]) : end]

    def without_first(self) -> "_Table":
        """Return all but the first line."""
        return _Table(self.words[int(self.sizes[0]) :], self.numbers[1:], self.sizes[1:])


def read_xyz(content: bytes, *, with_normals: bool = True) -> RawPoints:
    """Read the first three columns of each line, or those named x, y and z.

    Normals are in columns named nx, ny and nz, or normal_x and so on; without names, they are the next three columns,
    or the last three, if each of these rows has length 1. Blanks, commas or semicolons separate columns; `#` and `//`
    begin comments. A line of one integer announces the number of points that follow it, in one block or several.

    Args:
        content: of the file.
        with_normals: whether it may have normals.

    Raises:
        MeshError: naming the line at fault.
    """
    table = _table(content)
    if not len(table.sizes):
        raise MeshError("no points in it")
    columns: tuple[int, ...] = (0, 1, 2)
    of_normals: list[tuple[int, ...]] | None = None
    if not _is_number(table.words[0]):
        columns, of_normals = _named_columns(table.line(0), int(table.numbers[0]))
        table = _under_names(table)
    _check_blocks(table)
    points = _coordinates(table, columns)
    return RawPoints(points, _normals(table, of_normals) if with_normals else None)


def _table(content: bytes) -> _Table:
    text = content.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if text.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in text:
        raise MeshError("expected text in UTF-8, got other data")
    if b"#" in text or b"//" in text:
        text = _COMMENT.sub(b"", text)
    if text.startswith((b",", b";")):  # the first column has no name, such as an index
        text = b"index" + text
    if b";" in text or b"," in text:
        text = _without_separators(text)
    letters = np.frombuffer(text + b"\n", np.uint8)
    blank = (letters == 32) | ((letters >= 9) & (letters <= 13))
    starts = np.flatnonzero(~blank & np.concatenate([[True], blank[:-1]]))
    ends = np.flatnonzero(letters == ord("\n"))
    sizes = np.diff(np.searchsorted(starts, ends), prepend=0)
    numbers = np.flatnonzero(sizes)
    return _Table(text.split(), numbers + 1, sizes[numbers])


def _without_separators(text: bytes) -> bytes:
    """Replace commas or semicolons by blanks; refuse commas in the place of decimal points."""
    for number, line in enumerate(text.split(b"\n"), 1):
        if b"," in line and (b";" in line or _BLANK_BETWEEN.search(line)):
            raise MeshError(
                f"line {number}: expected commas between columns or none, got {_shown([line.strip()])}; "
                "write decimal points, not commas"
            )
    return text.replace(b";", b" ").replace(b",", b" ")


def _named_columns(names: list[bytes], number: int) -> tuple[tuple[int, ...], list[tuple[int, ...]]]:
    """Return the columns of coordinates, and those of normals, if there are some."""
    lower = [name.strip(b"\"'").lower() for name in names]
    if not {b"x", b"y", b"z"} <= set(lower):
        raise MeshError(f"line {number}: expected numbers, or columns named x, y and z, got {_shown(names)}")
    named = [axes for axes in _NORMALS if set(axes) <= set(lower)]
    return tuple(map(lower.index, (b"x", b"y", b"z"))), [tuple(map(lower.index, axes)) for axes in named[:1]]


def _under_names(table: _Table) -> _Table:
    """Return the lines below that of the names; refuse those of more columns, whose names would be others'."""
    names, rows = int(table.sizes[0]), table.without_first()
    if len(rows.sizes) and rows.sizes[0] > names:
        line = f"line {rows.numbers[0]}: expected {names} columns, as line {table.numbers[0]} names"
        raise MeshError(f"{line}, got {rows.sizes[0]}; write decimal points, not commas, and a name for each column")
    return rows


def _check_blocks(table: _Table) -> None:
    """Refuse blocks of other sizes than their first lines announce."""
    heads = np.flatnonzero(table.sizes == 1)
    if not len(heads):
        return
    first = int(heads[0])
    if first:
        raise MeshError(f"line {table.numbers[first]}: expected 3 coordinates or more, got {_shown(table.line(first))}")
    words = [table.words[place] for place in (np.cumsum(table.sizes)[heads] - 1).tolist()]
    numbers = table.numbers[heads].tolist()
    for word, number in zip(words, numbers, strict=True):
        if not word.isdigit() or len(word) > 18:
            raise MeshError(f"line {number}: expected a number of points, got {_shown([word])}")
    following = np.diff(heads, append=len(table.sizes)) - 1
    for word, number, rows in zip(words, numbers, following.tolist(), strict=True):
        if int(word) != rows:
            raise MeshError(f"line {number} announces {int(word)} points, but {rows} follow")


def _coordinates(table: _Table, columns: tuple[int, ...]) -> Float64[np.ndarray, "N 3"]:
    rows = np.flatnonzero(table.sizes > 1)
    if not len(rows):
        raise MeshError("no points in it")
    width = int(table.sizes[rows[0]])
    other = rows[table.sizes[rows] != width]
    if width <= max(columns) or len(other):
        row = int(other[0]) if len(other) and width > max(columns) else int(rows[0])
        expected = f"{width} columns, as before" if row != rows[0] else f"{max(columns) + 1} columns or more"
        raise MeshError(f"line {table.numbers[row]}: expected {expected}, got {int(table.sizes[row])}")
    starts = (np.cumsum(table.sizes) - table.sizes)[rows]
    words = np.array(table.words, dtype=bytes)[starts[:, None] + np.array(columns)] if len(rows) else np.empty((0, 3))
    try:
        points = words.astype(np.float64)
    except ValueError:
        bad = next(row for row, line in enumerate(words.tolist()) if not all(map(_is_number, line)))
        raise MeshError(
            f"line {table.numbers[rows[bad]]}: expected numbers, got {_shown(words[bad].tolist())}"
        ) from None
    return points


def _normals(table: _Table, named: list[tuple[int, ...]] | None) -> NDArray[np.float64] | None:
    """Return (N, 3) the normals in named columns, or in some whose rows have length 1; None if there are none."""
    rows = np.flatnonzero(table.sizes > 1)
    width = int(table.sizes[rows[0]])
    unnamed = [(3, 4, 5), (width - 3, width - 2, width - 1)] if width >= 6 else []
    starts = (np.cumsum(table.sizes) - table.sizes)[rows]
    for columns in dict.fromkeys(unnamed if named is None else named):
        try:
            vectors = np.array(table.words, dtype=bytes)[starts[:, None] + np.array(columns)].astype(np.float64)
        except (ValueError, IndexError):
            continue
        lengths = np.linalg.norm(np.nan_to_num(vectors), axis=1)
        known = lengths > 0
        if named is not None or (known.any() and np.abs(lengths[known] - 1).max() < _UNIT):
            return np.asarray(vectors)
    return None


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _shown(words: list[bytes]) -> str:
    text = b" ".join(words).decode("ascii", "backslashreplace")
    return repr(text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…")
