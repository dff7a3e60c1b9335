"""Mesh files in and out; STL and GLB through trimesh. The one module that imports it."""

import io
import warnings
from pathlib import Path

import numpy as np

from meshfit.errors import MeshError
from meshfit.mesh.file_content import known_suffix, read_content, reading, write_content
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.ply_files import read_ply, write_ply
from meshfit.mesh.polygons import PolygonMesh, Polygons, fan_triangles
from meshfit.mesh.repair import clean, clean_polygons
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
    found = _read(path, known_suffix(path, SUFFIXES, "mesh"))
    return clean(found.verts, fan_triangles(found.corners, found.sizes), str(path))


def load_polygons(path: str | Path) -> PolygonMesh:
    """Read a mesh from an OBJ, PLY, STL, OFF or GLB file with its faces as they are; seams are welded.

    Example:
        >>> mesh = load_polygons("quads.obj")  # doctest: +SKIP

    Raises:
        MeshError: as `load_mesh` does.

    Warns:
        MeshfitWarning: as `clean_polygons` does.
    """
    path = Path(path)
    return clean_polygons(_read(path, known_suffix(path, SUFFIXES, "mesh")), str(path))


def save_mesh(mesh: Mesh | PolygonMesh, path: str | Path) -> None:
    """Write a mesh in the format that its suffix names, in double precision but for STL and GLB, which have none.

    OBJ, OFF and PLY hold polygons; STL and GLB get the triangles of each.

    Raises:
        MeshError: a suffix that is not known, coordinates too large for single precision, or a path that cannot be
            written.
    """
    path = Path(path)
    suffix = known_suffix(path, SUFFIXES, "mesh")
    if suffix in _SINGLE and not np.abs(mesh.verts).max(initial=0.0) <= _LARGEST_SINGLE:
        raise MeshError(f"{path}: {suffix[1:].upper()} holds single precision, too small for the coordinates")
    write_content(path, encode_mesh(mesh, suffix))


def encode_mesh(mesh: Mesh | PolygonMesh, suffix: str) -> bytes:
    """The bytes of a mesh file of that suffix; the same mesh gives the same bytes."""
    if suffix in _WRITERS:
        return _WRITERS[suffix](mesh)
    import trimesh  # most files need it not, and it takes as long to import as all the rest

    mesh = mesh.triangulated() if isinstance(mesh, PolygonMesh) else mesh
    content = trimesh.Trimesh(mesh.verts, mesh.faces, process=False).export(file_type=suffix[1:])
    return content if isinstance(content, bytes) else str(content).encode()


def _read(path: Path, suffix: str) -> Polygons:
    content = read_content(path, SUFFIXES)
    with reading(path):  # a damaged file makes trimesh raise anything at all
        found = _READERS[suffix](content) if suffix in _READERS else _parse(content, suffix)
        if not len(found.verts):
            raise ValueError("no verts in it; another format, or cut short")
    return found


def _parse(content: bytes, suffix: str) -> Polygons:
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
    triangles = np.concatenate([np.empty((0, 3), dtype=np.int64), *faces]).astype(np.int64)
    sizes = np.full(len(triangles), 3, dtype=np.int64)
    return Polygons(np.concatenate([np.empty((0, 3)), *verts]), triangles.reshape(-1), sizes)
