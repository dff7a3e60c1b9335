"""The bytes of a file, and what to say where they cannot be had, written or made sense of."""

import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError
from meshfit.mesh.cleaning import clean_with_vertex_map
from meshfit.mesh.io.ply import read_ply, write_ply
from meshfit.mesh.io.text import read_obj, read_off, write_obj, write_off
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, fan_triangles
from meshfit.mesh.topology import Indices
from meshfit.paths import MESH_SUFFIXES, missing_file_message, write_error_message


def known_suffix(path: Path, suffixes: Sequence[str], what: str) -> str:
    """The suffix of a path, in small letters.

    Args:
        path: of a file to be read or written.
        suffixes: those that are known.
        what: they are formats of, such as `mesh`.

    Raises:
        MeshError: another one, or none.
    """
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        found = (
            f"'{path.suffix}' is not a {what} format that is known"
            if path.suffix
            else "no suffix to tell its format by"
        )
        raise MeshError(f"{path}: {found}; allowed: {', '.join(suffixes)}")
    return suffix


def read_content(path: Path, suffixes: Sequence[str]) -> bytes:
    """What a file holds.

    Args:
        path: of the file.
        suffixes: of files that could have been meant where there is none.

    Raises:
        MeshError: no such file, one that cannot be read, or an empty one.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise MeshError(f"{path}: {missing_file_message(path, suffixes)}") from None
    except OSError as error:
        raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
    if not content.strip():
        raise MeshError(f"{path}: the file is empty")
    return content


def write_content(path: Path, content: bytes) -> None:
    """Write a file.

    Raises:
        MeshError: it cannot be written.
    """
    try:
        path.write_bytes(content)
    except OSError as error:
        raise MeshError(f"{path}: {write_error_message(path, error)}") from error


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn whatever goes wrong while a damaged file is made sense of into one line.

    Raises:
        MeshError: in place of any other exception.
    """
    try:
        yield
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MeshError(f"{path}: cannot be read as {path.suffix[1:].upper()}: {reason}") from error


SUFFIXES = MESH_SUFFIXES
Normals = Float64[np.ndarray, "V 3"]

# trimesh takes OBJ's backward indices to count from the end of the file, a comment in OFF for the line before it, and
# binary PLY to hold polygons of one size.
_READERS = {".obj": read_obj, ".off": read_off, ".ply": read_ply}
_WRITERS = {".obj": write_obj, ".off": write_off, ".ply": write_ply}
_WITH_NORMALS = {".obj": write_obj, ".ply": write_ply}
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
    return load_mesh_with_vertex_map(path)[0]


def load_mesh_with_vertex_map(path: str | Path) -> tuple[Mesh, Indices]:
    """The mesh that `load_mesh` reads, and (N,) the vertex that each of the file's verts is in it.

    Welded verts of a file are the same vertex, and those that were dropped are `NONE`.

    Raises:
        MeshError: as `load_mesh`.

    Warns:
        MeshfitWarning: as `clean` does.
    """
    found = _read(Path(path), known_suffix(Path(path), SUFFIXES, "mesh"))
    faces = fan_triangles(found.corners, found.sizes)
    triangles = PolygonSoup(found.verts, faces.reshape(-1), np.full(len(faces), 3, dtype=np.int64))
    mesh, numbering = clean_with_vertex_map(triangles, str(path))
    return mesh.triangulated(), numbering


def load_polygons(path: str | Path) -> PolygonMesh:
    """Read a mesh from an OBJ, PLY, STL, OFF or GLB file with its faces as they are; seams are welded.

    Example:
        >>> mesh = load_polygons("quads.obj")  # doctest: +SKIP

    Raises:
        MeshError: as `load_mesh` does.

    Warns:
        MeshfitWarning: as `clean_polygons` does.
    """
    return load_polygons_with_vertex_map(path)[0]


def load_polygons_with_vertex_map(path: str | Path) -> tuple[PolygonMesh, Indices]:
    """The mesh that `load_polygons` reads, and (N,) the vertex that each of the file's verts is in it.

    Raises:
        MeshError: as `load_mesh`.

    Warns:
        MeshfitWarning: as `clean_polygons` does.
    """
    return clean_with_vertex_map(_read(Path(path), known_suffix(Path(path), SUFFIXES, "mesh")), str(path))


def save_mesh(mesh: Mesh | PolygonMesh, path: str | Path, normals: Normals | None = None) -> None:
    """Write a mesh in the format that its suffix names, in double precision but for STL and GLB, which have none.

    OBJ, OFF and PLY hold polygons; STL and GLB get the triangles of each.

    Args:
        mesh: what to write.
        path: where to.
        normals: (V, 3) of its verts, which OBJ and PLY hold.

    Raises:
        MeshError: a suffix that is not known or has no place for normals, coordinates too large for single precision,
            or a path that cannot be written.
    """
    path = Path(path)
    suffix = known_suffix(path, SUFFIXES, "mesh")
    if suffix in _SINGLE and not np.abs(mesh.verts).max(initial=0.0) <= _LARGEST_SINGLE:
        raise MeshError(f"{path}: {suffix[1:].upper()} holds single precision, too small for the coordinates")
    if normals is not None and suffix not in _WITH_NORMALS:
        raise MeshError(f"{path}: vertex normals are written to {' and '.join(_WITH_NORMALS)} files only")
    write_content(path, encode_mesh(mesh, suffix, normals))


def encode_mesh(mesh: Mesh | PolygonMesh, suffix: str, normals: Normals | None = None) -> bytes:
    """The bytes of a mesh file of that suffix; the same mesh gives the same bytes."""
    if normals is not None:
        return _WITH_NORMALS[suffix](mesh, normals)
    if suffix in _WRITERS:
        return _WRITERS[suffix](mesh)
    import trimesh  # most files need it not, and it takes as long to import as all the rest

    mesh = mesh.triangulated() if isinstance(mesh, PolygonMesh) else mesh
    content = trimesh.Trimesh(mesh.verts, mesh.faces, process=False).export(file_type=suffix[1:])
    return content if isinstance(content, bytes) else str(content).encode()


def _read(path: Path, suffix: str) -> PolygonSoup:
    content = read_content(path, SUFFIXES)
    with reading(path):  # a damaged file makes trimesh raise anything at all
        found = _READERS[suffix](content) if suffix in _READERS else _parse(content, suffix)
        if not len(found.verts):
            raise ValueError("no verts in it; another format, or cut short")
    return found


def _parse(content: bytes, suffix: str) -> PolygonSoup:
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
    return PolygonSoup(np.concatenate([np.empty((0, 3)), *verts]), triangles.reshape(-1), sizes)
