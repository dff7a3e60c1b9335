"""Landmark files: CSV tables, and the point lists of 3D Slicer (.fcsv, .mrk.json).

The formats of 3D Slicer are described in its developer guide, under *Markups*
(https://slicer.readthedocs.io/en/latest/developer_guide/modules/markups.html). MeshMonk's landmarks are rows `x,y,z`
without a header, whose order tells which is which, as in the `data` folder of its repository.

A CSV table has a header. Its places are given by one of `vertex`; `face,u,v,w`; or `x,y,z`, of the mesh that the file
is about, or by the same columns after `source_` and `target_`, for pairs. `name` (or `label`) names them, and `use: no`
holds one out. Vertices and faces are numbered from 0.
"""

import csv
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NoReturn

from meshfit.doors import no_type_check
from meshfit.errors import MeshError
from meshfit.mesh.any_mesh import as_path
from meshfit.mesh.io.json_objects import JsonObject
from meshfit.mesh.io.text import decoded_text, read_small_file
from meshfit.mesh.landmarks import Landmark, Landmarks
from meshfit.mesh.places import Place
from meshfit.paths import path_text
from meshfit.specs import suggest

LANDMARK_SUFFIXES = (".csv", ".tsv", ".txt", ".fcsv", ".mrk.json", ".json")
"""Suffixes of landmark files."""

_SIDES = ("source_", "target_")
_PLACES = {"vertex": ("vertex",), "face": ("face", "u", "v", "w"), "position": ("x", "y", "z")}
# Columns of control point tables of 3D Slicer: x and y to the left and back, or to the right and front.
_LPS, _RAS = ("l", "p", "s"), ("r", "a", "s")
_IGNORED = ("selected", "visible", "locked", "description")
_YES, _NO = ("yes", "true", "1", ""), ("no", "false", "0")
# Barycentric coordinates that a program has rounded.
_ROUNDED = 1e-3
_FCSV = ("id", "x", "y", "z", "ow", "ox", "oy", "oz", "vis", "sel", "lock", "label", "desc", "associatednodeid")
# Position status of a point that has been placed, in the column after those.
_DEFINED = "2"
_CODES = {"0": "RAS", "1": "LPS"}

Row = tuple[int, list[str]]
"""A line of a table: its number and its cells."""


@no_type_check
def load_landmarks(path: str | Path, target: str | Path | None = None) -> Landmarks:
    r"""Read landmarks: pairs from one file, or places from two files, which are matched by name.

    Args:
        path: a CSV table, MeshMonk's `x,y,z` rows, or a point list of 3D Slicer (.fcsv, .mrk.json); of pairs, or of
            places on the source.
        target: the file of the places on the target, if the first has none.

    Example:
        >>> import meshfit
        >>> from pathlib import Path
        >>> _ = Path("head.csv").write_text("name,vertex\nnose,7\nleft ear,31\nright ear,32\n")
        >>> _ = Path("scan.csv").write_text("name,x,y,z\nnose,0,0,1\nleft ear,1,0,0\nright ear,-1,0,0\n")
        >>> meshfit.load_landmarks("head.csv", "scan.csv")
        Landmarks(3 pairs: nose, left ear, right ear)

    Raises:
        MeshError: a file that cannot be read, with the line; or too few names on both sides.

    Warns:
        MeshfitWarning: of names that only one side has.
    """
    landmarks = _load(Path(as_path(path)))
    return landmarks if target is None else landmarks.with_goals(_load(Path(as_path(target, role="target"))))


def _load(path: Path) -> Landmarks:
    origin = path_text(path)
    content = read_small_file(path, LANDMARK_SUFFIXES)
    try:
        rows = list(_reader(path.name.lower())(content))
    except MeshError as error:
        raise MeshError(f"{origin}{error}") from None
    if not rows:
        raise MeshError(f"{origin}: no landmarks in it")
    lines: dict[str, str] = {}
    for where, row in rows:
        if row.name in lines:
            raise MeshError(f"{origin}{where}: landmark '{row.name}' is listed before, at{lines[row.name][1:]}")
        lines[row.name] = where
    return Landmarks(tuple(row for _, row in rows), origin)


Found = Iterator[tuple[str, Landmark]]
"""Landmarks, each after the words for its place in the file."""


def _reader(name: str) -> Callable[[bytes], Found]:
    if name.endswith(".fcsv"):
        return _read_fcsv
    if name.endswith(".json"):
        return _read_json
    if name.endswith((".csv", ".tsv", ".txt")):
        return _read_table
    raise MeshError(f": unknown format of landmarks; allowed: {', '.join(LANDMARK_SUFFIXES)}")


def _text(content: bytes) -> str:
    text = decoded_text(content)
    if text is None:
        raise MeshError(": not a text file in UTF-8")
    return text


def _cells(text: str, separator: str) -> list[Row]:
    """Return the lines of a table that are neither empty nor comments, without blanks around their cells."""
    rows = list[Row]()
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                (cells,) = csv.reader([line], delimiter=separator, skipinitialspace=True)
            except csv.Error as error:
                raise MeshError(f", line {number}: {error}") from None
            rows.append((number, [cell.strip() for cell in cells]))
    return rows


def _read_table(content: bytes) -> Found:
    text = _text(content)
    first = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
    separator = max(",;\t", key=first.count)
    rows = _cells(text, separator)
    if not rows:
        return
    header = [cell.lower() for cell in rows[0][1]]
    if any(map(_is_number, header)):
        yield from _without_header(rows)
        return
    table = _Table.of(header, rows[0][0])
    for index, (number, cells) in enumerate(rows[1:], 1):
        where = f", line {number}"
        if len(cells) > len(header) and any(cells[len(header) :]):
            raise MeshError(f"{where}: {len(cells)} cells, but {len(header)} columns")
        found = table.landmark(dict(zip(header, [*cells, *[""] * len(header)], strict=False)), index, where)
        if found is not None:
            yield where, found


def _without_header(rows: list[Row]) -> Found:
    """Read `x,y,z`, as MeshMonk has it, or `name,x,y,z`."""
    for index, (number, cells) in enumerate(rows, 1):
        where = f", line {number}"
        name = cells[0] if len(cells) == 4 and not _is_number(cells[0]) else str(index)
        numbers = cells[1:] if len(cells) == 4 and name == cells[0] else cells
        if len(numbers) != 3:
            raise MeshError(
                f"{where}: expected x,y,z, got {len(cells)} cells; other columns need a header, such as "
                "name,source_vertex,target_x,target_y,target_z"
            )
        yield where, Landmark(name, Place(position=_position(numbers, where)))


class _Table:
    """The columns of a table with a header."""

    def __init__(self, sides: Mapping[str, bool]) -> None:
        self._sides = sides

    @classmethod
    def of(cls, header: list[str], number: int) -> "_Table":
        """Check a header; return how to read the rows below it."""
        where = f", line {number}"
        own = [column for columns in _PLACES.values() for column in columns] + [*_LPS, *_RAS]
        paired = [f"{side}{column}" for side in _SIDES for columns in _PLACES.values() for column in columns]
        allowed = ["name", "label", "use", "defined", *own, *paired]
        for column in header:
            if column and column not in (*allowed, *_IGNORED):
                raise MeshError(f"{where}: '{column}' is no column of a landmark file: {suggest(column, allowed)}")
        doubled = next((column for column in header if column and header.count(column) > 1), None)
        if doubled is not None:
            raise MeshError(f"{where}: two columns '{doubled}'")
        sides = {side: any(column.startswith(side) for column in header) for side in _SIDES}
        if any(sides.values()) and not all(sides.values()):
            lacking = next(side for side, found in sides.items() if not found)
            raise MeshError(f"{where}: no columns {lacking}…; of one side alone, leave out source_ and target_")
        plain = [column for column in header if column in own]
        if all(sides.values()) and plain:
            raise MeshError(f"{where}: '{plain[0]}' next to columns source_… and target_…; which side is it?")
        kinds = [*_PLACES.values(), _LPS, _RAS]
        for side in [side for side, found in sides.items() if found] or [""]:
            if not any(all(f"{side}{column}" in header for column in columns) for columns in kinds):
                raise MeshError(f"{where}: no places: expected {side}vertex, {side}face,u,v,w or {side}x,y,z")
        return cls(sides)

    def landmark(self, cells: Mapping[str, str], index: int, where: str) -> Landmark | None:
        """Return the landmark of a row; None if it has yet to be placed."""
        if cells.get("defined", "1").lower() in _NO:
            return None
        name = cells.get("name") or cells.get("label") or str(index)
        use = cells.get("use", "").lower()
        if use not in (*_YES, *_NO):
            raise MeshError(f"{where}: use: expected yes or no, got '{use}'")
        if not all(self._sides.values()):
            return Landmark(name, _place(cells, "", where), used=use in _YES)
        place, goal = (_place(cells, side, where) for side in _SIDES)
        return Landmark(name, place, goal, used=use in _YES)


def _place(cells: Mapping[str, str], side: str, where: str) -> Place:
    kinds = {**_PLACES, "lps": _LPS, "ras": _RAS}
    given = [kind for kind, columns in kinds.items() if all(cells.get(f"{side}{column}") for column in columns)]
    some = [kind for kind, columns in _PLACES.items() if any(cells.get(f"{side}{column}") for column in columns)]
    partial = [kind for kind in some if kind not in given]
    if len(given) != 1 or partial:
        found = "none" if not given + partial else "incomplete" if partial else "several"
        named = f"{side.removesuffix('_')} " if side else ""
        raise MeshError(f"{where}: expected one {named}place: vertex; face,u,v,w; or x,y,z; got {found}")
    values = [cells[f"{side}{column}"] for column in kinds[given[0]]]
    if given[0] == "vertex":
        return Place(vertex=_integer(values[0], f"{side}vertex", where))
    if given[0] == "face":
        return Place(face=_integer(values[0], f"{side}face", where), weights=_weights(values[1:], where))
    if given[0] == "position":
        return Place(position=_position(values, where))
    return _anatomical(_position(values, where), given[0].upper())


def _anatomical(position: tuple[float, float, float], system: str) -> Place:
    """Return a place in LPS, in which 3D Slicer writes meshes."""
    x, y, z = position
    return Place(position=(x, y, z) if system == "LPS" else (-x, -y, z), anatomical=True)


def _position(words: list[str], where: str) -> tuple[float, float, float]:
    x, y, z = (_number(word, where) for word in words)
    return x, y, z


def _weights(words: list[str], where: str) -> tuple[float, float, float]:
    u, v, w = (_number(word, where) for word in words)
    total = u + v + w
    if min(u, v, w) < -_ROUNDED or abs(total - 1) > _ROUNDED:
        raise MeshError(f"{where}: u,v,w: expected weights of 0 or more with a sum of 1, got {u:g}, {v:g}, {w:g}")
    return u / total, v / total, w / total


def _number(word: str, where: str) -> float:
    value = float(word) if _is_number(word) else math.nan
    if not math.isfinite(value):
        raise MeshError(f"{where}: expected a finite number, got '{word}'")
    return value


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return "_" not in word


def _integer(word: str, column: str, where: str) -> int:
    if not re.fullmatch(r"\d{1,15}", word):
        raise MeshError(f"{where}: {column}: expected a number from 0 on, got '{word}'")
    return int(word)


def _read_fcsv(content: bytes) -> Found:
    """Read a point list with comments for its version, coordinate system and columns."""
    text = _text(content)
    system, columns = _fcsv_header(text)
    for index, (number, cells) in enumerate(_cells(text, ","), 1):
        where, row = f", line {number}", dict(zip(columns, cells, strict=False))
        if len(cells) > len(_FCSV) and columns == list(_FCSV) and cells[len(_FCSV)] not in ("", _DEFINED):
            continue  # it has yet to be placed
        if not all(row.get(column) for column in ("x", "y", "z")):
            raise MeshError(f"{where}: expected the columns {','.join(columns)}, got {len(cells)} cells")
        position = _position([row[column] for column in ("x", "y", "z")], where)
        yield where, Landmark(row.get("label") or str(index), _anatomical(position, system))


def _fcsv_header(text: str) -> tuple[str, list[str]]:
    """Return the coordinate system and the columns that comments name.

    In the files of early versions, numbers stand for the coordinate system: 0 for RAS, 1 for LPS. Without the comment,
    it is RAS, as it was then.
    """
    system, columns = "RAS", list(_FCSV)
    for number, line in enumerate(text.splitlines(), 1):
        key, _, value = line.lstrip("# \t").partition("=")
        key, value = key.strip().lower(), value.strip()
        if not line.startswith("#"):
            continue
        if key == "coordinatesystem":
            system = _checked_system(_CODES.get(value, value), f", line {number}: CoordinateSystem")
        if key == "columns":
            columns = [column.strip().lower() for column in value.split(",")]
            for column in ("x", "y", "z"):
                if column not in columns:
                    raise MeshError(f", line {number}: columns: no '{column}' among them")
    return system, columns


def _checked_system(text: str, where: str) -> str:
    if text.upper() not in ("LPS", "RAS"):
        raise MeshError(f"{where}: expected LPS or RAS, got '{text}'")
    return text.upper()


def _no_position(point: JsonObject) -> NoReturn:
    raise MeshError(f"{point.place}: no position")


def _read_json(content: bytes) -> Found:
    """Read the control points of all markups of a file."""
    try:
        for markup in JsonObject.parse(content).objects("markups"):
            system = _checked_system(markup.text("coordinateSystem", "LPS"), f"{markup.place}.coordinateSystem")
            for index, point in enumerate(markup.objects("controlPoints"), 1):
                if point.text("positionStatus", "defined") != "defined":
                    continue  # it has yet to be placed
                x, y, z = point.numbers("position", 3) or _no_position(point)
                name = point.text("label", "") or str(index)
                yield f", {point.place}", Landmark(name, _anatomical((x, y, z), system))
    except MeshError as error:
        raise MeshError(f": {error}") from None
