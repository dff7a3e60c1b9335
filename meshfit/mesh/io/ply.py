"""PLY files, text or binary: vertices, faces, edges and vertex properties. Other elements are ignored."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.curves import Chains, Curves
from meshfit.mesh.io.ply_elements import Ply, Rows, read_elements
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size

_LISTS = ("vertex_indices", "vertex_index")
_LARGEST_INDEX = 2**53  # float64 holds every integer up to here
_RESTART = 2**32 - 1  # -1 in an unsigned list

_Values = Mapping[str, NDArray[np.float64]]
_Corners = tuple[NDArray[np.int64], NDArray[np.int64]]


def read_ply(content: bytes) -> PolygonSoup:
    """Read vertices and faces in file order, then the triangles of strips.

    Raises:
        MeshError: the file is damaged, or its surface is in elements of another kind; the message names the place.

    Warns:
        MeshfitWarning: of elements with lists of integers that are passed over, and of bytes after the last element.
    """
    ply = read_elements(content)
    _check_other_elements(ply)
    corners, sizes = _faces(ply.rows["face"]) if "face" in ply.rows else (np.empty(0, np.int64), np.empty(0, np.int64))
    if "tristrips" in ply.rows:
        triangles = _strip_triangles(ply.rows["tristrips"])
        corners = np.concatenate([corners, triangles.reshape(-1)])
        sizes = np.concatenate([sizes, np.full(len(triangles), 3, dtype=np.int64)])
    return PolygonSoup(_verts(ply), corners, sizes)


def read_ply_segments(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read (V, 3) vertices and (S, 2) the ends of all `edge` elements, in file order.

    Raises:
        MeshError: the file is damaged; the message names the place.

    Warns:
        MeshfitWarning: of bytes after the last element.
    """
    ply = read_elements(content)
    ends = ply.rows["edge"].numbers("vertex1", "vertex2") if "edge" in ply.rows else np.empty((0, 2))
    return _verts(ply), _indices(ends, "'edge' has ends")


def read_ply_property(content: bytes, name: str) -> NDArray[np.float64]:
    """Read (N,) the values of a vertex property, in file order.

    Raises:
        MeshError: there is no such property, it is a list, or the file is damaged.

    Warns:
        MeshfitWarning: of bytes after the last element.
    """
    rows = read_elements(content).rows
    if "vertex" not in rows:
        raise MeshError("it has no vertices")
    names = [prop.name for prop in rows["vertex"].element.properties]
    if name not in names:
        raise MeshError(f"its vertices have no property '{name}'; they have {', '.join(names) or 'none'}")
    return rows["vertex"].numbers(name).reshape(-1)


def write_ply(mesh: Mesh | PolygonMesh, normals: NDArray[np.float64] | None = None) -> bytes:
    """Return the bytes of a binary PLY file in double precision, with (V, 3) vertex normals if given."""
    polygons = PolygonMesh.of(mesh)
    points = mesh.verts if normals is None else np.concatenate([mesh.verts, normals], axis=1)
    kind, code = ("uchar", "u1") if polygons.sizes.max(initial=0) < 256 else ("uint", "<u4")
    faces = f"element face {mesh.num_faces}\nproperty list {kind} int vertex_indices\n"
    return _write_points(points, faces) + _face_bytes(polygons, np.dtype(code))


def write_ply_values(mesh: Mesh, of_verts: _Values, of_faces: _Values, comment: str) -> bytes:
    """Return the bytes of a binary PLY file in double precision, with values of vertices and faces by property name.

    Args:
        mesh: V vertices, F faces.
        of_verts: (V,) each.
        of_faces: (F,) each.
        comment: one line of the header.
    """
    verts = np.empty(mesh.num_verts, [(name, "<f8") for name in ("x", "y", "z", *of_verts)])
    faces = np.empty(mesh.num_faces, [("size", "u1"), ("corners", "<i4", 3), *((name, "<f8") for name in of_faces)])
    for name, values in {**dict(zip("xyz", mesh.verts.T, strict=True)), **of_verts}.items():
        verts[name] = values
    for name, values in {"size": 3, "corners": mesh.faces, **of_faces}.items():
        faces[name] = values
    lines = ["ply", "format binary_little_endian 1.0", f"comment {comment}", f"element vertex {len(verts)}"]
    lines += [f"property double {name}" for name in ("x", "y", "z", *of_verts)]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    lines += [f"property double {name}" for name in of_faces]
    return "\n".join([*lines, "end_header\n"]).encode() + verts.tobytes() + faces.tobytes()


def write_ply_curves(curves: Curves) -> bytes:
    """Return the bytes of a binary PLY file in double precision, with one `edge` element per segment."""
    chains = Chains.of(curves)
    edges = f"element edge {curves.num_segments}\nproperty int vertex1\nproperty int vertex2\n"
    return _write_points(curves.verts, edges) + np.stack([chains.tail, chains.head], axis=1).astype("<i4").tobytes()


def _write_points(points: NDArray[np.float64], other_elements: str) -> bytes:
    """Return the header and the rows of the vertices: x, y, z and perhaps a normal."""
    properties = "".join(f"property double {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz")[: points.shape[1]])
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{properties}{other_elements}end_header\n"
    )
    return header.encode() + points.astype("<f8").tobytes()


def _face_bytes(mesh: PolygonMesh, count: np.dtype[Any]) -> bytes:
    """Return the rows of the faces: the number of corners, then the corners."""
    index = np.dtype("<i4")
    content = np.empty(mesh.num_faces * count.itemsize + len(mesh.corners) * index.itemsize, dtype=np.uint8)
    starts = np.arange(mesh.num_faces) * count.itemsize + mesh.starts * index.itemsize
    is_count = np.zeros(len(content), dtype=bool)
    is_count[(starts[:, None] + np.arange(count.itemsize)).reshape(-1)] = True
    content[is_count] = mesh.sizes.astype(count).view(np.uint8)
    content[~is_count] = mesh.corners.astype(index).view(np.uint8)
    return content.tobytes()


def _verts(ply: Ply) -> NDArray[np.float64]:
    return ply.rows["vertex"].numbers("x", "y", "z") if "vertex" in ply.rows else np.empty((0, 3))


def _faces(rows: Rows) -> _Corners:
    """Return the corners of all faces in a row, and the size of each face."""
    entries, sizes = rows.lists(*_LISTS)
    small = np.flatnonzero(sizes < 3)
    if len(small):
        checked_face_size(int(sizes[small[0]]), f"face {small[0]}: ")
    return _indices(entries, "'face' has corners"), sizes


def _strip_triangles(rows: Rows) -> NDArray[np.int64]:
    """Return (T, 3) the triangles of all strips, of which -1 ends one; every other one is turned.

    A triangle with a repeated vertex joins two parts of a strip and is left out.
    """
    entries, sizes = rows.lists(*_LISTS)
    indices = _indices(entries, "'tristrips' has entries")
    strip = np.repeat(np.arange(len(sizes)), sizes)
    is_restart = (indices == -1) | (indices == _RESTART)
    strip = (strip + np.cumsum(is_restart))[~is_restart]
    indices = indices[~is_restart]
    first = np.flatnonzero(np.diff(strip, prepend=-1))
    place = np.arange(len(strip)) - np.repeat(first, np.diff(first, append=len(strip)))
    triangles = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    turned = place[:-2] % 2 == 1
    triangles[turned] = triangles[turned][:, [1, 0, 2]]
    a, b, c = triangles.T
    is_triangle = (strip[:-2] == strip[2:]) & (a != b) & (b != c) & (c != a)
    return np.asarray(triangles[is_triangle])


def _indices(values: NDArray[Any], what: str) -> NDArray[np.int64]:
    if values.dtype.kind == "f" or values.dtype.itemsize == 8:
        with np.errstate(invalid="ignore"):
            bad = np.flatnonzero(~(np.abs(values.astype(np.float64)) < _LARGEST_INDEX) | (values % 1 != 0))
        if len(bad):
            raise MeshError(f"{what} that are not vertex indices: {float(values.flat[bad[0]]):g}")
    return values.astype(np.int64)


def _check_other_elements(ply: Ply) -> None:
    """Warn of elements that may hold a surface in a way that is not read; refuse a file whose only surface it is."""
    known = ("vertex", "face", "tristrips")
    elements = [rows.element for name, rows in ply.rows.items() if name not in known and rows.element.length]
    names = [f"'{element.name}'" for element in elements if element.integer_lists]
    if not names:
        return
    has_faces = any(name in ply.rows and ply.rows[name].element.length for name in known[1:])
    if has_faces or names == ["'range_grid'"]:  # of a scanner, which has points and no faces
        warnings.warn(f"passed over elements with lists of indices: {', '.join(names)}", MeshfitWarning, stacklevel=3)
        return
    raise MeshError(f"its surface is in elements {', '.join(names)}; expected 'face' or 'tristrips'")
