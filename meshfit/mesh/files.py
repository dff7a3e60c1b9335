"""Mesh files in and out, through trimesh. The one module that imports it."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.repair import clean

SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb")

# Enough decimals for a double to survive text; the other formats are binary.
_TEXT_DIGITS = {".obj": 17, ".off": 17}


def load_mesh(path: str | Path) -> Mesh:
    """Read a triangle mesh from an OBJ, PLY, STL, OFF or GLB file; polygons are triangulated, seams are welded.

    Example:
        >>> mesh = load_mesh("bunny.obj")  # doctest: +SKIP

    Raises:
        MeshError: no such file, a suffix that is not known, a file that cannot be read, or a mesh that `clean` refuses.

    Warns:
        MeshfitWarning: as `clean` does.
    """
    path = Path(path)
    verts, faces = _read(path, _checked_suffix(path))
    return clean(verts, faces, str(path))


def save_mesh(mesh: Mesh, path: str | Path) -> None:
    """Write a mesh in the format that its suffix names, in double precision but for STL and GLB, which have none.

    Raises:
        MeshError: a suffix that is not known, or a path that cannot be written.
    """
    path = Path(path)
    content = encode_mesh(mesh, _checked_suffix(path))
    try:
        path.write_bytes(content)
    except OSError as error:
        raise MeshError(f"{path}: cannot be written: {error.strerror}") from error


def encode_mesh(mesh: Mesh, suffix: str) -> bytes:
    """The bytes of a mesh file of that suffix; the same mesh gives the same bytes."""
    if suffix == ".ply":
        return _encode_ply(mesh)
    solid = trimesh.Trimesh(mesh.verts, mesh.faces, process=False)
    options: dict[str, Any] = {"digits": _TEXT_DIGITS[suffix]} if suffix in _TEXT_DIGITS else {}
    if suffix == ".obj":
        options |= {"header": None, "include_normals": False, "include_color": False}
    content = solid.export(file_type=suffix[1:], **options)
    return content if isinstance(content, bytes) else str(content).encode()


def _encode_ply(mesh: Mesh) -> bytes:
    """Binary PLY in double precision; trimesh writes single."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {mesh.num_verts}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {mesh.num_faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(mesh.num_faces, dtype=[("count", "u1"), ("index", "<i4", 3)])
    rows["count"], rows["index"] = 3, mesh.faces
    return header.encode() + mesh.verts.astype("<f8").tobytes() + rows.tobytes()


def _checked_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        found = f"'{path.suffix}'" if path.suffix else "no suffix"
        raise MeshError(f"{path}: {found} is not a mesh format that is known; allowed: {', '.join(SUFFIXES)}")
    return suffix


def _read(path: Path, suffix: str) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise MeshError(f"{path}: no such file") from None
    except OSError as error:
        raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
    if not content.strip():
        raise MeshError(f"{path}: the file is empty")
    try:  # a damaged file makes trimesh raise anything at all
        return _parse(content, suffix)
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MeshError(f"{path}: cannot be read as {suffix[1:].upper()}: {reason}") from error


def _parse(content: bytes, suffix: str) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=suffix[1:], process=False, validate=False, skip_materials=True
        )
    verts, faces, count = [], [], 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        part = scene.geometry[name]
        points = np.reshape(getattr(part, "vertices", []), (-1, 3))
        verts.append(points if np.array_equal(transform, np.eye(4)) else trimesh.transform_points(points, transform))
        faces.append(np.reshape(getattr(part, "faces", []), (-1, 3)) + count)
        count += len(points)
    empty_verts, empty_faces = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    return np.concatenate([empty_verts, *verts]), np.concatenate([empty_faces, *faces]).astype(np.int64)
