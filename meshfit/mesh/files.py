"""Mesh files in and out; STL and GLB through trimesh. The one module that imports it."""

import io
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.file_content import known_suffix, read_content, reading, write_content
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.ply_files import read_ply, write_ply
from meshfit.mesh.repair import clean
from meshfit.mesh.text_files import read_obj, read_off, write_obj, write_off
from meshfit.paths import MESH_SUFFIXES

SUFFIXES = MESH_SUFFIXES

# trimesh takes OBJ's backward indices to count from the end of the file, a comment in OFF for the line before it, and
# binary PLY to hold polygons of one size.
_READERS = {".obj": read_obj, ".off": read_off, ".ply": read_ply}
_WRITERS = {".obj": write_obj, ".off": write_off, ".ply": write_ply}
_SINGLE = (".stl", ".glb")
_LARGEST_SINGLE = float(np.finfo(np.float32).max)


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
    verts, faces = _read(path, known_suffix(path, SUFFIXES, "mesh"))
    return clean(verts, faces, str(path))


def save_mesh(mesh: Mesh, path: str | Path) -> None:
    """Write a mesh in the format that its suffix names, in double precision but for STL and GLB, which have none.

    Raises:
        MeshError: a suffix that is not known, coordinates too large for single precision, or a path that cannot be
            written.
    """
    path = Path(path)
    suffix = known_suffix(path, SUFFIXES, "mesh")
    if suffix in _SINGLE and not np.abs(mesh.verts).max(initial=0.0) <= _LARGEST_SINGLE:
        raise MeshError(f"{path}: {suffix[1:].upper()} holds single precision, too small for the coordinates")
    write_content(path, encode_mesh(mesh, suffix))


def encode_mesh(mesh: Mesh, suffix: str) -> bytes:
    """The bytes of a mesh file of that suffix; the same mesh gives the same bytes."""
    if suffix in _WRITERS:
        return _WRITERS[suffix](mesh)
    import trimesh  # most files need it not, and it takes as long to import as all the rest

    content = trimesh.Trimesh(mesh.verts, mesh.faces, process=False).export(file_type=suffix[1:])
    return content if isinstance(content, bytes) else str(content).encode()


def _read(path: Path, suffix: str) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    content = read_content(path, SUFFIXES)
    with reading(path):  # a damaged file makes trimesh raise anything at all
        verts, faces = _READERS[suffix](content) if suffix in _READERS else _parse(content, suffix)
        if not len(verts):
            raise ValueError("no verts in it; another format, or cut short")
    return verts, faces


def _parse(content: bytes, suffix: str) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    import trimesh

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
