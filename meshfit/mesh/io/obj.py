"""OBJ files: vertices, faces, texture coordinates, vertex colours, materials, groups and polylines; no normals."""

import itertools
import re
import warnings
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.attributes import COLOR, GROUP, MATERIAL, UV, Attributes, Values
from meshfit.mesh.curves import Curves
from meshfit.mesh.io.mtl import NO_MATERIAL, library_files, material_names, read_materials
from meshfit.mesh.io.text import (
    Lines,
    parse_float,
    parse_floats,
    parse_integers,
    parse_ints,
    parse_point,
    parse_point_rows,
    plain_text,
    quoted,
)
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size
from meshfit.mesh.welding import first_equal
from meshfit.units import count_text

_CONTINUED = re.compile(rb"^(?:vt?|fo?|l)(?=[ \t\\])(?:[^\n]*\\[ \t]*(?:\n|\Z))+[^\n]*", re.MULTILINE)
_LINE_END = re.compile(rb"\\[ \t]*(?:\n|\Z)")
_BLANKS_BEFORE = re.compile(rb"^[ \t]+", re.MULTILINE)
_KEYWORDS = {"face": (b"f", b"fo"), "line": (b"l",)}
_PASSED_OVER = re.compile(rb"^(?:call|curv2?|surf|bzp|bsp|cdc|cdp)(?=[ \t])", re.MULTILINE)
_AFTER_SLASH = re.compile(rb"/\S*")
_DIGITS = b"0123456789-+"
_BLANKS = bytes.maketrans(b"\v\f", b"  ")
_SLASH_TO_BLANK = bytes.maketrans(b"/", b" ")
_NEWLINE = ord("\n")
_BLANK_BYTES, _PASSED_OVER_BYTES = set(b" \t"), set(b"csb")
_AFTER_KEYWORD = np.frombuffer(b" \t\n\v", np.uint8)
_LIBRARY = re.compile(rb"^mtllib[ \t]([^\n]*)", re.MULTILINE)
_STATEMENTS = {"usemtl": MATERIAL, "g": GROUP, "o": GROUP}
_NONE = {MATERIAL: {"", NO_MATERIAL}, GROUP: {"", "default"}}
_FIRST_OF_STATEMENTS = np.frombuffer(b"umgo", np.uint8)
_CORNER = re.compile(rb"(?<=[ \t\v])[-+]?\d+(?:/([-+]?\d{1,15}))?\S*")
_NORMAL = re.compile(rb"^[ \t]*vn[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)
_LARGEST_FRACTION = 255
# Runs of vertices, such as those of objects, whose first one is looked at for a colour.
_MOST_RUNS = 1000


def read_obj(content: bytes, folder: Path | None = None, *, attributes: bool = False) -> PolygonSoup:
    """Read vertices and faces in file order.

    Args:
        content: of the file.
        folder: of the file, where its materials and their images are.
        attributes: read texture coordinates, colours of vertices, materials and groups.

    Raises:
        MeshError: naming the line at fault.

    Warns:
        MeshfitWarning: of free-form curves and surfaces and of calls of other files, which are passed over, and of
            materials and images that are missing.
    """
    text = _element_text(content)
    lines = _Lines(text)
    soup = _read_at_once(lines) or _read_one_by_one(text)
    _require_in_range(text, soup.corners, len(soup.verts), "face")
    return soup._replace(attributes=_read_attributes(lines, soup, folder)) if attributes else soup


def read_obj_segments(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read (V, 3) vertices and (S, 2) the segments of all `l` elements, in file order.

    Raises:
        MeshError: naming the line at fault.

    Warns:
        MeshfitWarning: of free-form curves and surfaces and of calls of other files, which are passed over.
    """
    verts: list[list[float]] = []
    segments: list[tuple[int, int]] = []
    text = _element_text(content)
    for number, words in _numbered_lines(text):
        if words[0] == b"v":
            verts.append(parse_point(words[1:], number))
        elif words[0] in _KEYWORDS["line"]:
            corners = _corners(words[1:], number, "line", len(verts))
            if len(corners) < 2:
                raise MeshError(f"line {number}: expected a line of 2 or more vertices, got {len(corners)}")
            segments += itertools.pairwise(corners)
    ends = np.array(segments, np.int64).reshape(-1, 2)
    _require_in_range(text, ends, len(verts), "line")
    return np.array(verts, np.float64).reshape(-1, 3), ends


def obj_files(content: bytes, folder: Path) -> list[Path]:
    """Return the files that the materials of an OBJ file are read from: libraries and images.

    Args:
        content: of the file.
        folder: of the file.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # reading the file says the same
        text = _element_text(content)
    names = [line.decode("utf-8", "surrogateescape").strip() for line in _LIBRARY.findall(text)]
    return library_files([name for name in names if name], folder)


def read_obj_normals(content: bytes) -> NDArray[np.float64] | None:
    """Read (N, 3) all normals, in file order, as programs write one per point of a cloud; None if there are none."""
    words = _NORMAL.findall(content)
    try:
        return np.array(words, dtype=bytes).astype(np.float64) if words else None
    except ValueError:
        return None


def write_obj(mesh: Mesh | PolygonMesh, normals: NDArray[np.float64] | None = None, *, library: str = "") -> bytes:
    """Return the bytes of an OBJ file; numbers are read back to the last bit.

    Args:
        mesh: the mesh, with texture coordinates, vertex colours, materials and groups, if it has any.
        normals: (V, 3) of its vertices.
        library: name of the MTL file that defines its materials.
    """
    polygons = PolygonMesh.of(mesh)
    colours, uv = mesh.attributes.vertex.get(COLOR), mesh.attributes.corner.get(UV)
    columns = mesh.verts if colours is None else np.hstack([mesh.verts, _fractions(colours)])
    pieces = [f"mtllib {library}\n"] if library else []
    pieces.append(_rows("v", columns))
    words = list(map(str, (polygons.corners + 1).tolist()))
    after = ["" if normals is None else f"//{word}" for word in words]
    if normals is not None:
        pieces.append(_rows("vn", normals))
    if uv is not None:
        first = first_equal(np.ascontiguousarray(uv, np.float64))
        distinct = np.unique(first)
        pieces.append(_rows("vt", np.asarray(uv[distinct], np.float64)))
        numbers = (np.searchsorted(distinct, first) + 1).tolist()
        after = [f"/{number}{end[1:]}" for number, end in zip(numbers, after, strict=True)]
    if uv is not None or normals is not None:
        words = [word + end for word, end in zip(words, after, strict=True)]
    faces = _statements(mesh.attributes)
    ends = np.cumsum(polygons.sizes).tolist()
    for face, (start, end) in enumerate(zip([0, *ends], ends, strict=False)):
        pieces.append(f"{faces.get(face, '')}f {' '.join(words[start:end])}\n")
    return "".join(pieces).encode("utf-8", "surrogateescape")


def left_out_of_obj(mesh: PolygonMesh) -> list[str]:
    """Return, in words, the attributes of a mesh that an OBJ file and its MTL file leave out."""
    given = mesh.attributes
    colours = given.vertex.get(COLOR)
    rest = Attributes(
        {name: values for name, values in given.vertex.items() if name != COLOR},
        {name: values for name, values in given.face.items() if name not in (MATERIAL, GROUP)},
        {name: values for name, values in given.corner.items() if name != UV},
    )
    further = [
        material
        for material in given.materials
        if material.definition is not None
        and material.definition.suffix != ".obj"
        and len(material.definition.images) > (material.texture is not None)
    ]
    phrases = rest.described()
    if colours is not None and colours.shape[1] > 3 and (colours[:, 3] != colours[:, 3].max()).any():
        phrases.append("the opacity of vertices")
    if further:
        phrases.append(f"further images of {count_text(len(further), 'material')}")
    return phrases


def _fractions(colours: Values) -> NDArray[np.float64]:
    """Return (V, 3) red, green and blue from 0 to 1."""
    whole = np.iinfo(colours.dtype).max if colours.dtype.kind in "ui" else 1
    return np.asarray(colours[:, :3].astype(np.float64) / whole)


def _statements(attributes: Attributes) -> dict[int, str]:
    """Return the lines before each face at which a material or a group begins."""
    lines: dict[int, str] = {}
    groups = [" ".join(name.split()) or f"group{number}" for number, name in enumerate(attributes.groups)]
    names = {
        GROUP: ("g", [*groups, "default"]),
        MATERIAL: ("usemtl", [*material_names(attributes.materials), NO_MATERIAL]),
    }
    for kind, (keyword, words) in names.items():
        if kind in attributes.face:
            numbers = attributes.face[kind].astype(np.int64)
            for face in np.flatnonzero(np.diff(numbers, prepend=-1)).tolist():
                lines[face] = f"{lines.get(face, '')}{keyword} {words[numbers[face]]}\n"
    return lines


def write_obj_curves(curves: Curves) -> bytes:
    """Return the bytes of an OBJ file with one `l` element per chain; a closed one ends at its first vertex."""
    starts = np.cumsum(curves.sizes)[:-1]
    chains = [chain.tolist() for chain in np.split(curves.corners + 1, starts)] if len(curves.sizes) else []
    lines = "".join(
        f"l {' '.join(map(str, [*chain, *chain[: int(closed)]]))}\n"
        for chain, closed in zip(chains, curves.closed, strict=True)
    )
    return f"{_rows('v', curves.verts)}{lines}".encode()


def _rows(keyword: str, rows: NDArray[np.float64]) -> str:
    return "".join(f"{keyword} {' '.join(map(repr, row))}\n" for row in rows.tolist())


def _element_text(content: bytes) -> bytes:
    """Return a file without comments and blanks before keywords, its lines joined where one goes on in the next.

    A backslash joins lines of the elements that are read only: it may also end the path of a material.
    A joined line has a vertical tab for each line end that it lost, so that lines can be counted.
    """
    text = plain_text(content)
    if b"\v" in text or b"\f" in text:
        text = text.translate(_BLANKS)
    first = _first_bytes(text)
    if first & _BLANK_BYTES:
        text = _BLANKS_BEFORE.sub(b"", text)
        first = _first_bytes(text)
    if b"\\" in text:
        text = _CONTINUED.sub(lambda lines: _LINE_END.sub(b" \v", lines[0]), text)
    if first & _PASSED_OVER_BYTES and (passed_over := {word.decode() for word in _PASSED_OVER.findall(text)}):
        names = ", ".join(sorted(passed_over))
        warnings.warn(f"passed over free-form geometry and other files: {names}", MeshfitWarning, stacklevel=3)
    return text


def _first_bytes(text: bytes) -> set[int]:
    """Return the first byte of all lines."""
    codes, starts = _line_starts(text)
    return set(np.flatnonzero(np.bincount(codes[starts[:-1]])).tolist())


def _line_starts(text: bytes) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return the bytes of a text, which some blanks follow, and where each line starts and the last ends."""
    codes = np.frombuffer(text + b"\n  ", np.uint8)
    return codes, np.concatenate([[0], np.flatnonzero(codes == _NEWLINE) + 1])


def _numbered_lines(text: bytes) -> Lines:
    """Yield the number and the words of each line of a text that is not empty."""
    number = 1
    for line in text.split(b"\n"):
        if words := line.split():
            yield number, words
        number += 1 + line.count(b"\v")


def _corners(words: Sequence[bytes], number: int, kind: str, num_verts: int) -> list[int]:
    """Return vertex indices from 0 on, for an element that follows `num_verts` vertices."""
    corners = parse_integers([word.partition(b"/")[0] for word in words], number, words)
    if 0 in corners:
        raise MeshError(f"line {number}: a {kind} with vertex 0; OBJ counts from 1, or from -1 backwards")
    return [corner - 1 if corner > 0 else num_verts + corner for corner in corners]


def _read_one_by_one(text: bytes) -> PolygonSoup:
    verts: list[list[float]] = []
    faces: list[list[int]] = []
    for number, words in _numbered_lines(text):
        if words[0] == b"v":
            verts.append(parse_point(words[1:], number))
        elif words[0] in _KEYWORDS["face"]:
            corners = _corners(words[1:], number, "face", len(verts))
            checked_face_size(len(corners), f"line {number}: ")
            faces.append(corners)
    return PolygonSoup.of_rows(verts, faces)


def _require_in_range(text: bytes, corners: NDArray[np.int64], num_verts: int, kind: str) -> None:
    """Refuse the first line with a vertex that the file lacks; a file without any vertices is refused elsewhere."""
    if not num_verts or ((corners >= 0) & (corners < num_verts)).all():
        return
    before = 0
    for number, words in _numbered_lines(text):
        before += words[0] == b"v"
        if words[0] in _KEYWORDS[kind]:
            for word, corner in zip(words[1:], _corners(words[1:], number, kind, before), strict=True):
                if not 0 <= corner < num_verts:
                    index = word.partition(b"/")[0].decode()
                    found = (
                        f"{count_text(before, 'vertex')} before it" if corner < 0 else count_text(num_verts, "vertex")
                    )
                    raise MeshError(f"line {number}: a {kind} with vertex {index}, but the file has {found}")


class _Lines:
    """The lines of a text by their keywords."""

    def __init__(self, text: bytes) -> None:
        self.text = text
        self._codes, self.starts = _line_starts(text)
        self._second_ends = self._ends_keyword(1)

    @cached_property
    def verts(self) -> NDArray[np.bool_]:
        """(L,) which lines are vertices."""
        return np.asarray((self._at(0) == ord("v")) & self._second_ends)

    @cached_property
    def old_faces(self) -> NDArray[np.bool_]:
        """(L,) which lines are faces with the keyword `fo`."""
        return np.asarray((self._at(0) == ord("f")) & (self._at(1) == ord("o")) & self._ends_keyword(2))

    @cached_property
    def faces(self) -> NDArray[np.bool_]:
        """(L,) which lines are faces."""
        return np.asarray((self._at(0) == ord("f")) & self._second_ends | self.old_faces)

    @cached_property
    def textures(self) -> NDArray[np.bool_]:
        """(L,) which lines are texture coordinates."""
        return np.asarray((self._at(0) == ord("v")) & (self._at(1) == ord("t")) & self._ends_keyword(2))

    @cached_property
    def statements(self) -> NDArray[np.bool_]:
        """(L,) which lines may name a material, a library of them, a group or an object."""
        return np.isin(self._at(0), _FIRST_OF_STATEMENTS)

    @cached_property
    def of_faces(self) -> bytes:
        """The lines of all faces, each with the keyword `f`."""
        lines = self.joined(self.faces)
        return lines.replace(b"fo", b"f") if self.old_faces.any() else lines

    def joined(self, chosen: NDArray[np.bool_]) -> bytes:
        """Return the chosen lines."""
        changes = np.flatnonzero(np.diff(chosen, prepend=False, append=False))
        ends = self.starts[changes].tolist()
        return b"".join([self.text[start:end] for start, end in zip(ends[::2], ends[1::2], strict=True)])

    def line(self, row: int) -> bytes:
        """Return a line by its row."""
        return self.text[self.starts[row] : self.starts[row + 1]]

    def number(self, row: int) -> int:
        """Return the number of a line in the file."""
        return row + 1 + self.text.count(b"\v", 0, int(self.starts[row]))

    def numbers(self, chosen: NDArray[np.bool_], keyword: bytes, width: int) -> NDArray[np.float64]:
        """Return (N, width) the first numbers of the chosen lines; NaN where a line has fewer.

        Raises:
            MeshError: a word that is not a number, naming its line.
        """
        values = np.full((int(chosen.sum()), width), np.nan)
        numbers = parse_floats(self.joined(chosen).replace(keyword, b" nan "))
        marks = np.empty(0) if numbers is None else np.flatnonzero(np.isnan(numbers))
        if numbers is not None and len(marks) == len(values):
            lengths = np.diff(marks, append=len(numbers)) - 1
            for column in range(width):
                there = lengths > column
                values[there, column] = numbers[marks[there] + 1 + column]
            return values
        for place, row in enumerate(np.flatnonzero(chosen).tolist()):
            words = self.line(row).split()[1 : 1 + width]
            for column, word in enumerate(words):
                number = parse_float(word)
                if number is None:
                    raise MeshError(f"line {self.number(row)}: expected numbers, got {quoted(words)}")
                values[place, column] = number
        return values

    def _at(self, place: int) -> NDArray[np.uint8]:
        """Return (L,) one of the first bytes of each line."""
        return np.asarray(self._codes[self.starts[:-1] + place])

    def _ends_keyword(self, place: int) -> NDArray[np.bool_]:
        return np.isin(self._at(place), _AFTER_KEYWORD)


def _read_at_once(lines: _Lines) -> PolygonSoup | None:
    """Read the numbers of all vertices and then of all faces of a text; return None if anything is unusual."""
    verts = parse_point_rows(lines.joined(lines.verts), b"v", int(lines.verts.sum()))
    faces = _face_corners(lines.of_faces, int(lines.faces.sum()))
    if verts is None or faces is None:
        return None
    corners, sizes = faces
    backwards = corners < 0
    if backwards.any():
        verts_before = np.repeat(np.cumsum(lines.verts)[lines.faces], sizes)
        corners = np.where(backwards, verts_before + corners, corners - 1)
    else:
        corners = corners - 1
    return PolygonSoup(verts, corners, sizes)


def _face_corners(lines: bytes, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the vertices of all faces, from 1 on, and (F,) their sizes, with 0 in place of each keyword."""
    per_corner = 1
    if b"/" in lines:
        if any(blank in lines for blank in (b" /", b"\t/", b"\v/")):
            return None
        per_corner = _numbers_per_corner(lines)
        lines = lines.translate(_SLASH_TO_BLANK) if per_corner > 1 else _AFTER_SLASH.sub(b"", lines)
    numbers = parse_ints(lines.replace(b"f", b" 0 "))
    if numbers is None:
        return None
    is_keyword = numbers == 0
    keywords = np.flatnonzero(is_keyword)
    sizes, further = np.divmod(np.diff(keywords, append=len(numbers)) - 1, per_corner)
    if len(keywords) != count or (sizes < 3).any() or further.any():
        return None
    return numbers[~is_keyword][::per_corner], sizes


def _numbers_per_corner(lines: bytes) -> int:
    """Return how many numbers each corner has, if all are written alike and after one blank each, else 1."""
    skeleton = lines.translate(None, _DIGITS)
    corners, slashes = skeleton.count(b" "), skeleton.count(b"/")
    if slashes == corners == skeleton.count(b" /"):
        per_corner = 2
    elif slashes == 2 * corners == 2 * skeleton.count(b" //"):
        per_corner = 2 if lines.count(b"//") == corners else 3
    else:
        return 1
    if b"\t" in lines or b"\v" in lines:
        return 1
    blanks = lines.count(b"/ ") + lines.count(b"/\n") + lines.count(b"//") * (per_corner == 3)
    return 1 if blanks else per_corner


def _read_attributes(lines: _Lines, soup: PolygonSoup, folder: Path | None) -> Attributes:
    colours = _colours(lines)
    uv = _texture_coordinates(lines, soup.sizes) if lines.textures.any() else None
    vertex = {} if colours is None else {COLOR: colours}
    corner = {} if uv is None else {UV: uv}
    if not lines.statements.any():
        return Attributes(vertex, corner=corner)
    statements = _Statements.of(lines)
    numbers, names = statements.numbers, statements.names
    materials, missing = read_materials(statements.libraries, names[MATERIAL], folder)
    if materials and missing:
        warnings.warn(f"the look of its materials is incomplete: {missing}", MeshfitWarning, stacklevel=3)
    face = {kind: numbers[kind] for kind in numbers if names[kind]}
    return Attributes(vertex, face, corner, materials, tuple(names[GROUP]))


def _colours(lines: _Lines) -> Values | None:
    """Return (V, 3) or (V, 4) the colours of vertices, which follow their coordinates; white where there are none."""
    runs = np.flatnonzero(lines.verts & ~np.append(False, lines.verts[:-1]))
    if not any(len(lines.line(row).split()) > 6 for row in runs[:_MOST_RUNS].tolist()):
        return None
    colours = lines.numbers(lines.verts, b"v", 7)[:, 3:]
    coloured = ~np.isnan(colours[:, 2])
    known = colours[coloured]
    if not len(known) or not (np.nanmin(known) >= 0 and np.nanmax(known) <= _LARGEST_FRACTION):
        return None  # vertex normals, for example
    whole = 1.0
    if known.max(initial=0.0, where=~np.isnan(known)) > 1:
        if not (np.nan_to_num(known) % 1 == 0).all():
            return None
        whole = float(_LARGEST_FRACTION)
    colours[np.isnan(colours) | ~coloured[:, None]] = whole
    colours = colours[:, : 4 if not np.isnan(known[:, 3]).all() else 3]
    return colours if whole == 1 else colours.astype(np.uint8)


def _texture_coordinates(lines: _Lines, sizes: NDArray[np.int64]) -> Values | None:
    """Return (C, 2) the texture coordinates of corners, 0 for those without; None if no corner has any.

    Raises:
        MeshError: a corner with texture coordinates that the file lacks, naming its line.
    """
    numbers = _texture_numbers(lines.of_faces, int(sizes.sum()))
    if numbers is None or not numbers.any():
        return None
    values = np.nan_to_num(lines.numbers(lines.textures, b"vt", 2), nan=0.0, posinf=np.inf, neginf=-np.inf)
    before = np.repeat(np.cumsum(lines.textures)[lines.faces], sizes)
    rows = np.where(numbers < 0, before + numbers, numbers - 1)
    there = numbers != 0
    outside = np.flatnonzero(there & ((rows < 0) | (rows >= len(values))))
    if len(outside):
        at = int(outside[0])
        line = lines.number(int(np.flatnonzero(lines.faces)[np.searchsorted(np.cumsum(sizes), at, side="right")]))
        place = f"{before[at]:,} of them before it" if numbers[at] < 0 else f"{len(values):,}"
        raise MeshError(f"line {line}: a face with texture coordinates {numbers[at]}, but the file has {place}")
    return np.where(there[:, None], values[np.where(there, rows, 0)], 0.0)


def _texture_numbers(lines: bytes, count: int) -> NDArray[np.int64] | None:
    """Return (C,) the number after the first slash of each corner, 0 for none; None if there are none."""
    if b"/" not in lines:
        return None
    per_corner = _numbers_per_corner(lines)
    if per_corner > 1:
        if b"//" in lines:
            return None
        numbers = parse_ints(lines.translate(_SLASH_TO_BLANK).replace(b"f", b" "))
        if numbers is not None and len(numbers) == count * per_corner:
            return numbers[1::per_corner]
    words = _CORNER.findall(lines)
    return np.array([int(word or 0) for word in words], dtype=np.int64) if len(words) == count else None


class _Statements(NamedTuple):
    """The statements between faces.

    Attributes:
        names: of the materials and groups that faces have.
        numbers: (F,) the material and the group of each face; -1 for none.
        libraries: the text of each `mtllib`.
    """

    names: dict[str, list[str]]
    numbers: dict[str, NDArray[np.int64]]
    libraries: list[str]

    @classmethod
    def of(cls, lines: _Lines) -> "_Statements":
        libraries, faces = list[str](), np.flatnonzero(lines.faces)
        known: dict[str, dict[str, int]] = {MATERIAL: {}, GROUP: {}}
        rows: dict[str, list[int]] = {MATERIAL: [-1], GROUP: [-1]}
        values: dict[str, list[int]] = {MATERIAL: [-1], GROUP: [-1]}
        for row in np.flatnonzero(lines.statements).tolist():
            keyword, *texts = lines.line(row).decode("utf-8", "surrogateescape").strip().split(maxsplit=1)
            name = texts[0] if texts else ""
            if keyword == "mtllib" and name:
                libraries.append(name)
            elif kind := _STATEMENTS.get(keyword):
                rows[kind].append(row)
                is_none = name in _NONE[kind]
                values[kind].append(-1 if is_none else known[kind].setdefault(name, len(known[kind])))
        names, numbers = dict[str, list[str]](), dict[str, NDArray[np.int64]]()
        for kind, of_kind in known.items():
            numbers[kind] = np.array(values[kind])[np.searchsorted(rows[kind], faces) - 1]
            used = np.unique(numbers[kind][numbers[kind] >= 0])
            numbers[kind] = np.where(numbers[kind] < 0, -1, np.searchsorted(used, numbers[kind]))
            every = list(of_kind)
            names[kind] = [every[number] for number in used.tolist()]
        return cls(names, numbers, libraries)
