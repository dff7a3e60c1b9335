"""VTK XML files of poly data (`.vtp`) and unstructured grids (`.vtu`): text, base64, appended and compressed."""

import base64
import binascii
import itertools
import lzma
import re
import zlib
from collections.abc import Mapping
from contextlib import suppress
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.io.vtk_cells import Cells, surface
from meshfit.mesh.io.xml_elements import (
    Element,
    attribute,
    child,
    children,
    integer_attribute,
    local_name,
    numbers,
    parse_xml,
    shown,
)
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonSoup

_TYPES = {
    "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8",
    "UInt64": "u8", "Float32": "f4", "Float64": "f8",
}  # fmt: skip
# In the order in which VTK counts the cells, whatever the order in a file.
_POLY_CELLS = {"Verts": "verts", "Lines": "lines", "Polys": "polygons", "Strips": "strips"}
_COMPRESSORS = ("", "vtkZLibDataCompressor", "vtkLZMADataCompressor")
_APPENDED = re.compile(rb"<AppendedData\b[^>]*>\s*_")
_RAW = re.compile(rb"""encoding\s*=\s*["']raw["']""")
# Compressed data may unpack to this much for nothing, and to so many bytes for each of its own.
_FREE_BYTES = 10_000_000
_BYTES_PER_PACKED_BYTE = 100


def read_vtk_xml(content: bytes) -> PolygonSoup:
    """Read the polygons and triangle strips of all pieces of a VTK XML file; of one without them, points and normals.

    Raises:
        MeshError: a damaged file, another kind of data, or a volume mesh.

    Warns:
        MeshfitWarning: with the number of cells that are passed over.
    """
    xml, appended = _without_appended(content)
    root = parse_xml(xml, "VTKFile")
    kind = attribute(root, "type") or "nothing"
    data = child(root, kind) if kind in {"PolyData", "UnstructuredGrid"} else None
    if data is None:
        raise MeshError(f"expected poly data or an unstructured grid, got {shown(kind)}")
    arrays = _Arrays(root, appended, len(content))
    verts, pieces = [np.empty((0, 3))], [Cells.of_type(np.empty(0, np.int64), np.empty(0, np.int64), "verts")]
    count, all_pieces = 0, list(children(data, "Piece"))
    for number, piece in enumerate(all_pieces):
        place = f"piece {number}"
        points = arrays.points(piece, place)
        for cells in arrays.cells(piece, place):
            if len(cells.corners) and not 0 <= cells.corners.min() <= cells.corners.max() < len(points):
                raise MeshError(f"{place}: a cell names a point that is not among its {len(points)} points")
            pieces.append(cells._replace(corners=cells.corners + count))
        verts.append(points)
        count += len(points)
    soup = surface(np.concatenate(verts), pieces)
    if len(soup.sizes):
        return soup
    normals = [arrays.normals(piece, len(points)) for piece, points in zip(all_pieces, verts[1:], strict=True)]
    found = [rows for rows in normals if rows is not None]
    return soup._replace(normals=np.concatenate(found)) if found and len(found) == len(normals) else soup


def write_vtp_values(
    mesh: Mesh, of_verts: Mapping[str, NDArray[np.float64]], of_faces: Mapping[str, NDArray[np.float64]]
) -> bytes:
    """Return the bytes of a VTP file in double precision, with values of vertices and faces by name.

    Args:
        mesh: V vertices, F faces.
        of_verts: (V,) each; the first is the one that viewers show.
        of_faces: (F,) each.
    """
    corners = {"connectivity": mesh.faces.reshape(-1), "offsets": np.arange(1, mesh.num_faces + 1) * 3}
    root = ElementTree.Element(
        "VTKFile", type="PolyData", version="1.0", byte_order="LittleEndian", header_type="UInt64"
    )
    counts = {"NumberOfPoints": str(mesh.num_verts), "NumberOfPolys": str(mesh.num_faces)}
    piece = ElementTree.SubElement(ElementTree.SubElement(root, "PolyData"), "Piece", counts)
    for section, values in (("PointData", of_verts), ("CellData", of_faces)):
        _add_arrays(ElementTree.SubElement(piece, section, Scalars=next(iter(values), "")), values)
    _add_arrays(ElementTree.SubElement(piece, "Points"), {"Points": mesh.verts})
    _add_arrays(ElementTree.SubElement(piece, "Polys"), corners)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _add_arrays(section: ElementTree.Element, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Add arrays in base64, each after its number of bytes."""
    for name, array in arrays.items():
        kind, dtype = ("Float64", "<f8") if array.dtype.kind == "f" else ("Int64", "<i8")
        attributes = {"type": kind, "Name": name, "format": "binary"}
        if array.ndim == 2:
            attributes["NumberOfComponents"] = str(array.shape[1])
        content = array.astype(dtype).tobytes()
        element = ElementTree.SubElement(section, "DataArray", attributes)
        element.text = base64.b64encode(len(content).to_bytes(8, "little") + content).decode()


def _without_appended(content: bytes) -> tuple[bytes, tuple[bytes | None, bool]]:
    """Return the XML without the data appended to it, that data, and whether it is raw."""
    found = _APPENDED.search(content)
    if found is None:
        return content, (None, False)
    end = content.rfind(b"</AppendedData")
    end = len(content) if end < found.end() else end
    data = content[found.end() : end]
    raw = _RAW.search(found.group()) is not None
    return content[: found.start()] + b"</VTKFile>", (data if raw else b"".join(data.split()), raw)


class _Arrays:
    """The data arrays of a file."""

    def __init__(self, root: Element, appended: tuple[bytes | None, bool], num_bytes: int) -> None:
        self._appended, self._raw = appended
        order = {"LittleEndian": "<", "BigEndian": ">"}.get(attribute(root, "byte_order") or "LittleEndian")
        header = {"UInt32": "u4", "UInt64": "u8"}.get(attribute(root, "header_type") or "UInt32")
        if order is None or header is None:
            raise MeshError("expected a byte order LittleEndian or BigEndian, and headers of UInt32 or UInt64")
        self._order, self._header = order, np.dtype(order + header)
        self._compressor = attribute(root, "compressor") or ""
        if self._compressor not in _COMPRESSORS:
            raise MeshError(f"compressed with {shown(self._compressor)}, which is not supported; compress it with zlib")
        self._limit = _FREE_BYTES + _BYTES_PER_PACKED_BYTE * num_bytes

    def points(self, piece: Element, place: str) -> NDArray[np.float64]:
        """Return (V, 3) the points of a piece."""
        count = integer_attribute(piece, "NumberOfPoints", place)
        parent = child(piece, "Points")
        array = None if parent is None else child(parent, "DataArray")
        if array is None:
            if count:
                raise MeshError(f"{place}: no points in it, but {count} are announced")
            return np.empty((0, 3))
        values = self._values(array, f"{place}: Points")
        if len(values) != 3 * count:
            raise MeshError(f"{place}: expected {count} points, got {len(values)} coordinates")
        return values.astype(np.float64).reshape(-1, 3)

    def normals(self, piece: Element, count: int) -> NDArray[np.float64] | None:
        """Return (V, 3) the normals of the points of a piece; None if there are none."""
        parent = child(piece, "PointData")
        if parent is None:
            return None
        named = {(attribute(array, "Name") or "").lower(): array for array in children(parent, "DataArray")}
        array = named.get((attribute(parent, "Normals") or "normals").lower())
        with suppress(MeshError):  # no other data of points matters
            values = None if array is None else self._values(array, "Normals")
            if values is not None and len(values) == 3 * count:
                return values.astype(np.float64).reshape(-1, 3)
        return None

    def cells(self, piece: Element, place: str) -> list[Cells]:
        """Return the cells of a piece."""
        found = []
        parents = [parent for name in ("Cells", *_POLY_CELLS) for parent in children(piece, name)]
        for parent in parents:
            name = local_name(parent)
            named = {attribute(array, "Name") or "": array for array in children(parent, "DataArray")}
            arrays = {
                key: self._values(named[key], f"{place}: {key} of {name}").astype(np.int64)
                for key in ("connectivity", "offsets", "types")
                if key in named
            }
            offsets = arrays.get("offsets", np.empty(0, np.int64))
            corners = arrays.get("connectivity", np.empty(0, np.int64))
            sizes = np.diff(offsets, prepend=0)
            if (sizes < 0).any() or int(sizes.sum()) != len(corners):
                raise MeshError(
                    f"{place}: expected offsets of {name} that rise to {len(corners)}, the number of corners"
                )
            key = "NumberOfCells" if name == "Cells" else f"NumberOf{name}"
            announced = integer_attribute(piece, key, place, len(sizes))
            if announced != len(sizes):
                raise MeshError(f"{place}: {key} is {announced}, but {len(sizes)} are there")
            if name != "Cells":
                found.append(Cells.of_type(corners, sizes, _POLY_CELLS[name]))
            elif len(arrays.get("types", [])) != len(sizes):
                raise MeshError(f"{place}: {len(arrays.get('types', []))} cell types, but {len(sizes)} cells")
            else:
                found.append(Cells(corners, sizes, arrays["types"]))
        return found

    def _values(self, array: Element, place: str) -> NDArray[Any]:
        code, form = _TYPES.get(attribute(array, "type") or ""), attribute(array, "format") or "ascii"
        if code is None:
            raise MeshError(f"{place}: expected a type such as Float32, got {shown(attribute(array, 'type'))}")
        dtype = np.dtype(self._order + code)
        if form == "ascii":
            return numbers(array.text, np.float64 if dtype.kind == "f" else np.int64, place)
        if form == "binary":
            return self._decoded(
                "".join((array.text or "").split()).encode("ascii", "replace"), dtype, place, raw=False
            )
        if form != "appended" or self._appended is None:
            raise MeshError(f"{place}: expected data as ascii, binary or appended to the file, got {shown(form)}")
        start = integer_attribute(array, "offset", place, 0)
        return self._decoded(self._appended[start:], dtype, place, raw=self._raw)

    def _decoded(self, data: bytes, dtype: np.dtype[Any], place: str, *, raw: bool) -> NDArray[Any]:
        unpack = self._unpacked if self._compressor else self._plain
        content = unpack(data, place, raw=raw)
        if len(content) % dtype.itemsize:
            raise MeshError(f"{place}: {len(content)} bytes are not a whole number of {dtype.itemsize}-byte numbers")
        return np.frombuffer(content, dtype)

    def _plain(self, data: bytes, place: str, *, raw: bool) -> bytes:
        """Return data that its length precedes."""
        size = self._header.itemsize
        length = int(np.frombuffer(_first(data, size, place, raw=raw)[0], self._header)[0])
        return _first(data, size + length, place, raw=raw)[0][size:]

    def _unpacked(self, data: bytes, place: str, *, raw: bool) -> bytes:
        """Return data in compressed blocks; before them are their number, their sizes unpacked, and those packed."""
        size = self._header.itemsize
        head = np.frombuffer(_first(data, 3 * size, place, raw=raw)[0], self._header)
        blocks, block_size, last = (int(number) for number in head)
        if blocks * block_size > self._limit:
            raise MeshError(f"{place}: expands to {blocks * block_size} bytes, implausibly many")
        header, used = _first(data, (3 + blocks) * size, place, raw=raw)
        lengths = np.frombuffer(header, self._header)[3:].tolist()
        packed, _ = _first(data[used:], sum(lengths), place, raw=raw)
        ends = np.cumsum([0, *lengths]).tolist()
        pieces = [self._block(packed[start:end], block_size, place) for start, end in itertools.pairwise(ends)]
        content = b"".join(pieces)
        if len(content) != max(blocks - 1, 0) * block_size + (last or block_size) * bool(blocks):
            raise MeshError(f"{place}: its compressed blocks are of other sizes than announced")
        return content

    def _block(self, packed: bytes, size: int, place: str) -> bytes:
        try:
            if self._compressor == "vtkZLibDataCompressor":
                return zlib.decompressobj().decompress(packed, size + 1)
            return lzma.LZMADecompressor().decompress(packed, size + 1)
        except (zlib.error, lzma.LZMAError, EOFError):
            raise MeshError(f"{place}: its compressed data is damaged") from None


def _first(data: bytes, count: int, place: str, *, raw: bool) -> tuple[bytes, int]:
    """Return the first bytes of raw or base64 data, and how much of the data they take."""
    used = count if raw else -(-count // 3) * 4
    if used > len(data):
        raise MeshError(f"{place}: cut short: {count} bytes are announced, but the file has no more")
    if raw:
        return data[:count], used
    try:
        return base64.b64decode(data[:used], validate=True)[:count], used
    except binascii.Error:
        raise MeshError(f"{place}: its base64 is damaged") from None
