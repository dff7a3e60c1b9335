"""PLY files of meshes, of polygons of any sizes, and of curves."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.ply_elements import Element, Rows, elements_of
from meshfit.mesh.polygons import PolygonMesh, Polygons, of_size, polygons

_LARGEST_INDEX = 2**53


def read_ply(content: bytes) -> Polygons:
    """Verts and faces of a PLY file, in its order; whatever else it holds is passed over.

    Raises:
        ValueError: saying where the file is at fault.
    """
    found = polygons([], [])
    for element, rows in elements_of(content):
        if element.name == "vertex":
            found = found._replace(verts=_points(element, rows))
        elif element.name == "face":
            corners, sizes = _faces(element, rows)
            found = found._replace(corners=corners, sizes=sizes)
    return found


def read_ply_segments(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(V, 3) verts and (S, 2) the ends of the `edge` elements of a PLY file, in its order; faces are passed over.

    Raises:
        ValueError: saying where the file is at fault.
    """
    verts, ends = np.empty((0, 3)), np.empty((0, 2))
    for element, rows in elements_of(content):
        if element.name == "vertex":
            verts = _points(element, rows)
        elif element.name == "edge":
            ends = _columns(element, rows, ("vertex1", "vertex2"))
    if not (np.abs(ends) < _LARGEST_INDEX).all() or (ends % 1).any():
        raise ValueError("'edge' has ends that are not indices of verts")
    return verts, ends.astype(np.int64)


def read_ply_property(content: bytes, name: str) -> NDArray[np.float64]:
    """(N,) the values of a property of the verts of a PLY file, in its order.

    Raises:
        ValueError: it has no such property, one that is a list, or is at fault.
    """
    for element, rows in elements_of(content):
        if element.name == "vertex":
            found = next((one for one in element.properties if one.name == name), None)
            if found is None:
                there = ", ".join(one.name for one in element.properties)
                raise ValueError(f"its verts have no property '{name}'; they have {there}")
            if found.count_code:
                raise ValueError(f"the property '{name}' is a list; a number for each vertex is needed")
            if isinstance(rows, np.ndarray):
                return np.asarray(rows[name], dtype=np.float64).reshape(-1)
            return np.array([float(row[name][0]) for row in rows], dtype=np.float64)
    raise ValueError("it has no verts")


def write_ply(mesh: Mesh | PolygonMesh, normals: NDArray[np.float64] | None = None) -> bytes:
    """The bytes of a PLY file: binary, in double precision, with (V, 3) normals of its verts if given."""
    whole = PolygonMesh.of(mesh)
    points = mesh.verts if normals is None else np.concatenate([mesh.verts, normals], axis=1)
    names = ("x", "y", "z", "nx", "ny", "nz")[: points.shape[1]]
    declared = "".join(f"property double {name}\n" for name in names)
    kind, code = ("uchar", "u1") if whole.sizes.max(initial=0) < 256 else ("uint", "<u4")
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {mesh.num_verts}\n{declared}"
        f"element face {mesh.num_faces}\nproperty list {kind} int vertex_indices\nend_header\n"
    )
    return header.encode() + points.astype("<f8").tobytes() + _face_bytes(whole, np.dtype(code))


def _face_bytes(mesh: PolygonMesh, count: np.dtype[Any]) -> bytes:
    """Of each face how many corners it has, and which."""
    index = np.dtype("<i4")
    content = np.empty(mesh.num_faces * count.itemsize + len(mesh.corners) * index.itemsize, dtype=np.uint8)
    starts = np.arange(mesh.num_faces) * count.itemsize + mesh.starts * index.itemsize
    is_count = np.zeros(len(content), dtype=bool)
    is_count[(starts[:, None] + np.arange(count.itemsize)).reshape(-1)] = True
    content[is_count] = mesh.sizes.astype(count).view(np.uint8)
    content[~is_count] = mesh.corners.astype(index).view(np.uint8)
    return content.tobytes()


def _points(element: Element, rows: Rows) -> NDArray[np.float64]:
    return _columns(element, rows, "xyz")


def _columns(element: Element, rows: Rows, names: Iterable[str]) -> NDArray[np.float64]:
    """(N, K) the numbers of some properties, which float64 holds exactly whatever their kind."""
    found = [_property(element, name) for name in names]
    if isinstance(rows, np.ndarray):
        return np.concatenate([rows[name] for name in found], axis=1).astype(np.float64)
    return np.array([[float(row[name][0]) for name in found] for row in rows], np.float64).reshape(-1, len(found))


def _faces(element: Element, rows: Rows) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    name = _property(element, "vertex_indices", "vertex_index")
    if isinstance(rows, np.ndarray):
        corners = rows[name].astype(np.int64)
        return corners.reshape(-1), np.full(len(corners), of_size(corners.shape[1]))
    sizes = np.array([of_size(len(row[name])) for row in rows], dtype=np.int64)
    return np.array([int(corner) for row in rows for corner in row[name]], dtype=np.int64), sizes


def _property(element: Element, *names: str) -> str:
    found = [one.name for one in element.properties if one.name in names]
    if not found and element.length:
        raise ValueError(f"'{element.name}' has no property '{names[0]}'")
    return found[0] if found else names[0]
