"""Load and save meshes and curves: formats by suffix, cleaning, and errors that name the file."""

import warnings
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64

from meshfit.errors import DomainError, MeshError, MeshfitWarning
from meshfit.mesh.cleaning import clean, require_finite_verts
from meshfit.mesh.curves import Chains, Curves, Segments, join_segments
from meshfit.mesh.io import gltf, obj, off, ply, stl
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, fan_triangles
from meshfit.mesh.topology import Indices
from meshfit.paths import missing_file_message, write_error_message

Normals = Float64[np.ndarray, "V 3"]
_Content = TypeVar("_Content")
_LARGEST_SINGLE = float(np.finfo(np.float32).max)


class Format(NamedTuple):
    """A mesh file format: its reader, its writer, and whether it holds vertex normals and double precision.

    A format with normals has a writer that takes them as a second argument; one with `folder`, a reader that takes the
    folder of the file, as it refers to files in it.
    """

    read: Callable[..., PolygonSoup]
    write: Callable[..., bytes]
    normals: bool = False
    double: bool = True
    folder: bool = False


class CurveFormat(NamedTuple):
    """A curve file format: its reader of vertices and segments, its writer, and the name of its segments."""

    read: Callable[[bytes], tuple[Verts, Segments]]
    write: Callable[[Curves], bytes]
    elements: str


FORMATS = {
    ".obj": Format(obj.read_obj, obj.write_obj, normals=True),
    ".ply": Format(ply.read_ply, ply.write_ply, normals=True),
    ".stl": Format(stl.read_stl, stl.write_stl, double=False),
    ".off": Format(off.read_off, off.write_off),
    ".glb": Format(gltf.read_gltf, gltf.write_glb, double=False, folder=True),
    ".gltf": Format(gltf.read_gltf, gltf.write_gltf, double=False, folder=True),
}
CURVE_FORMATS = {
    ".obj": CurveFormat(obj.read_obj_segments, obj.write_obj_curves, "'l' lines"),
    ".ply": CurveFormat(ply.read_ply_segments, ply.write_ply_curves, "'edge' elements"),
}


def load_mesh(path: str | Path) -> Mesh:
    """Read a triangle mesh from an OBJ, PLY, STL, OFF, GLB or glTF file; triangulate polygons and weld seams.

    Example:
        >>> mesh = load_mesh("bunny.obj")  # doctest: +SKIP

    Raises:
        MeshError: no such file, an unknown suffix, an unreadable file, or a mesh that `clean` refuses.

    Warns:
        MeshfitWarning: as `clean` does.
    """
    return load_mesh_with_vertex_map(path)[0]


def load_mesh_with_vertex_map(path: str | Path) -> tuple[Mesh, Indices]:
    """Return the mesh of `load_mesh`, and (N,) the index in it of each vertex of the file.

    Welded vertices share an index; dropped ones have `NONE`. Errors and warnings are those of `load_mesh`.
    """
    soup = _read_soup(Path(path))
    triangles = PolygonSoup.of_triangles(soup.verts, fan_triangles(soup.corners, soup.sizes))
    mesh, vertex_map = clean(triangles, str(path))
    return mesh.triangulated(), vertex_map


def load_polygons(path: str | Path) -> PolygonMesh:
    """Read a mesh from an OBJ, PLY, STL, OFF, GLB or glTF file; keep its faces as they are and weld seams.

    Example:
        >>> mesh = load_polygons("quads.obj")  # doctest: +SKIP

    Errors and warnings are those of `load_mesh`.
    """
    return load_polygons_with_vertex_map(path)[0]


def load_polygons_with_vertex_map(path: str | Path) -> tuple[PolygonMesh, Indices]:
    """Return the mesh of `load_polygons`, and (N,) the index in it of each vertex of the file."""
    return clean(_read_soup(Path(path)), str(path))


def load_curves(path: str | Path) -> Curves:
    """Read curves from an OBJ or PLY file; join segments that share vertices to chains, as long as possible.

    A chain that ends where it starts is closed. Faces are ignored, and vertices of no segment dropped.

    Example:
        >>> curves = load_curves("profile.obj")  # doctest: +SKIP

    Raises:
        MeshError: no such file, an unknown suffix, an unreadable file or one without curves, a coordinate that is not
            finite or beyond 1e60, a segment with an index out of range, or curves that branch.

    Warns:
        MeshfitWarning: with the number of dropped vertices.
    """
    path = Path(path)
    suffix = _known_suffix(path, CURVE_FORMATS, "curve")
    verts, segments = _read_file(path, CURVE_FORMATS, CURVE_FORMATS[suffix].read)
    if not len(segments):
        raise DomainError(
            f"{path}: no curves in it; {suffix[1:].upper()} holds them as {CURVE_FORMATS[suffix].elements}"
        )
    require_finite_verts(verts, str(path))
    return _without_unused_verts(verts, join_segments(len(verts), segments, str(path)), str(path))


def save_mesh(mesh: Mesh | PolygonMesh, path: str | Path, normals: Normals | None = None) -> None:
    """Write a mesh in the format of the suffix, in double precision except STL, GLB and glTF, which are single.

    OBJ, OFF and PLY keep polygons; STL, GLB and glTF get their triangles.

    Args:
        mesh: V vertices.
        path: of the file.
        normals: (V, 3) of the vertices, for OBJ and PLY.

    Raises:
        MeshError: an unknown suffix or one without normals, coordinates too large for single precision, or a path that
            cannot be written.
    """
    path = Path(path)
    suffix = _known_suffix(path, FORMATS, "mesh")
    if not FORMATS[suffix].double and not np.abs(mesh.verts).max(initial=0.0) <= _LARGEST_SINGLE:
        raise MeshError(f"{path}: {suffix[1:].upper()} holds single precision, too small for the coordinates")
    if normals is not None and not FORMATS[suffix].normals:
        with_normals = " and ".join(suffix for suffix, form in FORMATS.items() if form.normals)
        raise MeshError(f"{path}: vertex normals can be written to {with_normals} files only")
    _write_content(path, encode_mesh(mesh, suffix, normals))


def save_curves(curves: Curves, path: str | Path) -> None:
    """Write curves as OBJ or PLY, by the suffix, in double precision.

    Raises:
        MeshError: an unknown suffix, or a path that cannot be written.
    """
    path = Path(path)
    _write_content(path, encode_curves(curves, _known_suffix(path, CURVE_FORMATS, "curve")))


def encode_mesh(mesh: Mesh | PolygonMesh, suffix: str, normals: Normals | None = None) -> bytes:
    """Return the bytes of a mesh file with this suffix; the same mesh gives the same bytes."""
    write = FORMATS[suffix].write
    return write(mesh) if normals is None else write(mesh, normals)


def encode_curves(curves: Curves, suffix: str) -> bytes:
    """Return the bytes of a curve file with this suffix; the same curves give the same bytes."""
    return CURVE_FORMATS[suffix].write(curves)


def _read_soup(path: Path) -> PolygonSoup:
    form = FORMATS[_known_suffix(path, FORMATS, "mesh")]
    soup = _read_file(path, FORMATS, partial(form.read, folder=path.parent) if form.folder else form.read)
    if not len(soup.verts):
        raise _unreadable(path, "no vertices in it; another format, or cut short")
    return soup


def _read_file(path: Path, suffixes: Collection[str], parse: Callable[[bytes], _Content]) -> _Content:
    """Return the parsed content of a file, or turn any exception that a damaged one causes into one line."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise MeshError(f"{path}: {missing_file_message(path, suffixes)}") from None
    except OSError as error:
        raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
    if not content.strip():
        raise MeshError(f"{path}: the file is empty")
    return _parse(path, content, parse)


def _parse(path: Path, content: bytes, parse: Callable[[bytes], _Content]) -> _Content:
    """Return the parsed content of a file; its name precedes the errors and warnings of the parser."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            parsed = parse(content)
        except MeshError as error:
            raise _unreadable(path, str(error)) from None
        except Exception as error:
            raise _unreadable(path, "the file is damaged, or of another format") from error
    for warning in caught:
        if issubclass(warning.category, MeshfitWarning):
            warnings.warn(f"{path}: {warning.message}", MeshfitWarning, stacklevel=5)
    return parsed


def _unreadable(path: Path, reason: str) -> MeshError:
    return MeshError(f"{path}: cannot be read as {path.suffix[1:].upper()}: {reason}")


def _known_suffix(path: Path, suffixes: Collection[str], kind: str) -> str:
    """Return the suffix of a mesh or curve file in lower case, or refuse an unknown one."""
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        fault = f"unknown {kind} format '{path.suffix}'" if path.suffix else f"no suffix to tell the {kind} format"
        raise MeshError(f"{path}: {fault}; allowed: {', '.join(suffixes)}")
    return suffix


def _write_content(path: Path, content: bytes) -> None:
    try:
        path.write_bytes(content)
    except OSError as error:
        raise MeshError(f"{path}: {write_error_message(path, error)}") from error


def _without_unused_verts(verts: Verts, chains: Chains, origin: str) -> Curves:
    used = np.zeros(len(verts), dtype=bool)
    used[chains.corners] = True
    if not used.all():
        unused = int((~used).sum())
        warnings.warn(f"{origin}: dropped {unused} vertices that no curve uses", MeshfitWarning, stacklevel=3)
    return Curves(verts[used], (np.cumsum(used) - 1)[chains.corners], chains.sizes, chains.closed)
