"""Load and save meshes and curves: formats by suffix, cleaning, and errors that name the file."""

import os
import re
import warnings
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64

from meshfit.doors import no_type_check
from meshfit.errors import DomainError, MeshError, MeshfitWarning, NoFacesError
from meshfit.mesh.any_mesh import MeshLike, as_mesh, as_path
from meshfit.mesh.attributes import MATERIAL
from meshfit.mesh.cleaning import VertexMap, clean, require_finite_verts
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.curves import Chains, Curves, Segments, join_segments
from meshfit.mesh.faceless import no_faces_message
from meshfit.mesh.io import collada, gltf, las, obj, off, pcd, ply, stl, threemf, vtk_legacy, xyz
from meshfit.mesh.io.gltf_writing import left_out_of_gltf
from meshfit.mesh.io.images import ImagesBeside
from meshfit.mesh.io.mesh_file import (
    MeshFile,
    output_suffix,
    read_file,
    replace_file,
    suffix_of_format,
    write_file,
    wrong_format,
)
from meshfit.mesh.io.mtl import has_look, library_beside
from meshfit.mesh.io.raw_points import RawPoints
from meshfit.mesh.io.recognition import format_name
from meshfit.mesh.mesh import Mesh, Verts, freeze
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup
from meshfit.paths import STDOUT_PATHS, compression_suffix, file_stem, format_suffix, is_regular_file, path_text
from meshfit.printable import described
from meshfit.units import count_text

Normals = Float64[np.ndarray, "V 3"]
_Content = TypeVar("_Content")
_LARGEST_SINGLE = float(np.finfo(np.float32).max)


def _all_attributes(mesh: PolygonMesh) -> list[str]:
    return mesh.attributes.described()


class Format(NamedTuple):
    """A mesh file format: its reader, its writer, and whether it holds vertex normals and double precision.

    A format with normals has a writer that takes them as a second argument; one with `folder`, a reader that takes the
    folder of the file, as it refers to files in it; one with `attributes`, a reader that takes whether to read them.

    `left_out` returns, in words, the attributes of a mesh that its writer leaves out; `unread` is that of a
    `ReadOnlyFormat`.
    """

    read: Callable[..., PolygonSoup]
    write: Callable[..., bytes]
    normals: bool = False
    double: bool = True
    folder: bool = False
    attributes: bool = False
    left_out: Callable[[PolygonMesh], list[str]] = _all_attributes
    unread: Mapping[str, bytes] = MappingProxyType({})


class ReadOnlyFormat(NamedTuple):
    """A mesh file format that is read, but not written.

    `unread` has attributes that are not read, in words, and a pattern that finds them in the bytes of a file.
    """

    read: Callable[..., PolygonSoup]
    folder: bool = False
    attributes: bool = False
    unread: Mapping[str, bytes] = MappingProxyType({})


class PointFormat(NamedTuple):
    """A format of point clouds: its reader, and a way to count the points without reading them, if there is one."""

    read: Callable[[bytes], RawPoints]
    num_points: Callable[[bytes], int] | None = None


class CurveFormat(NamedTuple):
    """A curve file format: its reader of vertices and segments, its writer, and the name of its segments."""

    read: Callable[[bytes], tuple[Verts, Segments]]
    write: Callable[[Curves], bytes]
    elements: str


# In OFF, letters before the keyword announce columns of vertices; the colour of a face follows its corners.
_UNREAD_OF_OFF = {
    "texture coordinates": rb"(?i)\A\s*[CN4]*ST[CN4]*OFF",
    "colours": rb"(?i)\A\s*(?:ST|[N4])*C(?:ST|[CN4])*OFF",
    "colours of faces": rb"(?m)^[ \t]*(?:3(?:[ \t]+\d+){3}|4(?:[ \t]+\d+){4})(?:[ \t]+\d*\.?\d+){3,4}[ \t\r]*$",
}
_UNREAD_OF_STL = {"colours": rb"\A[^\0]{0,70}COLOR="}
_GLTF = Format(gltf.read_gltf, gltf.write_glb, double=False, folder=True, attributes=True, left_out=left_out_of_gltf)
FORMATS = {
    ".obj": Format(
        obj.read_obj, obj.write_obj, normals=True, folder=True, attributes=True, left_out=obj.left_out_of_obj
    ),
    ".ply": Format(
        ply.read_ply, ply.write_ply, normals=True, folder=True, attributes=True, left_out=ply.left_out_of_ply
    ),
    ".stl": Format(stl.read_stl, stl.write_stl, double=False, unread=_UNREAD_OF_STL),
    ".off": Format(off.read_off, off.write_off, unread=_UNREAD_OF_OFF),
    ".glb": _GLTF,
    ".gltf": _GLTF._replace(write=gltf.write_gltf),
}
_UNREAD_OF_COLLADA = {
    "texture coordinates": rb"semantic\s*=\s*[\"']TEXCOORD[\"']",
    "colours": rb"semantic\s*=\s*[\"']COLOR[\"']",
    "skin weights": rb"semantic\s*=\s*[\"']WEIGHT[\"']",
}
_UNREAD_OF_VTK = {
    "data of points and cells": rb"\n(?:SCALARS|COLOR_SCALARS|TEXTURE_COORDINATES|VECTORS|FIELD)[ \t]"
    rb"|<(?:Point|Cell)Data[^>]*>\s*<DataArray(?![^>]*Name=\"Normals\")"
}
READ_ONLY_FORMATS = {
    ".3mf": ReadOnlyFormat(threemf.read_3mf, attributes=True),
    ".dae": ReadOnlyFormat(collada.read_dae, unread=_UNREAD_OF_COLLADA),
    ".vtk": ReadOnlyFormat(vtk_legacy.read_vtk, unread=_UNREAD_OF_VTK),
    ".vtp": ReadOnlyFormat(vtk_legacy.read_vtk, unread=_UNREAD_OF_VTK),
    ".vtu": ReadOnlyFormat(vtk_legacy.read_vtk, unread=_UNREAD_OF_VTK),
}
READABLE_FORMATS: dict[str, Format | ReadOnlyFormat] = {**FORMATS, **READ_ONLY_FORMATS}
POINT_FORMATS = {
    **dict.fromkeys((".xyz", ".xyzn", ".pts", ".txt", ".asc", ".csv"), PointFormat(xyz.read_xyz)),
    ".xyzrgb": PointFormat(partial(xyz.read_xyz, with_normals=False)),
    **dict.fromkeys((".las", ".laz"), PointFormat(las.read_las, las.count_las)),
    ".pcd": PointFormat(pcd.read_pcd),
}
CURVE_FORMATS = {
    ".obj": CurveFormat(obj.read_obj_segments, obj.write_obj_curves, "'l' lines"),
    ".ply": CurveFormat(ply.read_ply_segments, ply.write_ply_curves, "'edge' elements"),
}


@no_type_check
def load_mesh(
    path: str | Path | MeshFile,
    cleaning: CleaningOptions | None = None,
    *,
    file_format: str | None = None,
    attributes: bool = True,
) -> Mesh:
    """Read a triangle mesh in one of `FORMATS`; triangulate polygons and weld seams.

    Args:
        path: of the file, which may be compressed (`.gz`, `.bz2`, `.xz`); the text `-` is standard input.
        cleaning: distance of welding, and repair of what is not manifold.
        file_format: the format, such as `ply`, in place of the suffix; pipes and standard input have none.
        attributes: read texture coordinates, colours, materials and the like; the shape alone is faster.

    Example:
        >>> import meshfit
        >>> meshfit.save_mesh("octahedron", "octahedron.obj")
        >>> meshfit.load_mesh("octahedron.obj")
        Mesh(6 verts, 8 faces, box 2 × 2 × 2)

    Raises:
        MeshError: no such file, an unknown format, an unreadable file, or a mesh that `clean` refuses.

    Warns:
        MeshfitWarning: as `clean` does.
    """
    return load_mesh_with_vertex_map(path, cleaning, file_format=file_format, attributes=attributes)[0]


@no_type_check
def load_mesh_with_vertex_map(
    path: str | Path | MeshFile,
    cleaning: CleaningOptions | None = None,
    *,
    file_format: str | None = None,
    attributes: bool = True,
) -> tuple[Mesh, VertexMap]:
    """Return the mesh of `load_mesh`, and the vertices of it that each vertex of the file became.

    Errors and warnings are those of `load_mesh`.
    """
    file = _opened(path, "mesh", file_format)
    mesh, vertex_map = clean(_read_surface(file, attributes=attributes), file.name, cleaning, triangles=True)
    return mesh.triangulated(), vertex_map


@no_type_check
def load_polygons(
    path: str | Path | MeshFile,
    cleaning: CleaningOptions | None = None,
    *,
    file_format: str | None = None,
    attributes: bool = True,
) -> PolygonMesh:
    """Read a mesh in one of `FORMATS`; keep its faces as they are and weld seams.

    Example:
        >>> import meshfit
        >>> meshfit.save_mesh("cube", "quads.obj")
        >>> meshfit.load_polygons("quads.obj")
        PolygonMesh(8 verts, 6 quads, box 1.155 × 1.155 × 1.155)

    Arguments, errors and warnings are those of `load_mesh`.
    """
    return load_polygons_with_vertex_map(path, cleaning, file_format=file_format, attributes=attributes)[0]


@no_type_check
def load_polygons_with_vertex_map(
    path: str | Path | MeshFile,
    cleaning: CleaningOptions | None = None,
    *,
    file_format: str | None = None,
    attributes: bool = True,
) -> tuple[PolygonMesh, VertexMap]:
    """Return the mesh of `load_polygons`, and the vertices of it that each vertex of the file became."""
    file = _opened(path, "mesh", file_format)
    return clean(_read_surface(file, attributes=attributes), file.name, cleaning)


@no_type_check
def load_curves(path: str | Path | MeshFile, *, file_format: str | None = None) -> Curves:
    """Read curves from an OBJ or PLY file; join segments that share vertices to chains, as long as possible.

    A chain that ends where it starts is closed. Faces are ignored, and vertices of no segment dropped.

    Args:
        path: as for `load_mesh`.
        file_format: as for `load_mesh`.

    Example:
        >>> import meshfit
        >>> meshfit.save_curves(meshfit.Curves.through([[0, 0, 0], [1, 0, 0], [1, 1, 0]]), "profile.obj")
        >>> meshfit.load_curves("profile.obj")
        Curves(3 verts, 1 chain, 2 segments)

    Raises:
        MeshError: no such file, an unknown format, an unreadable file or one without curves, a coordinate that is not
            finite or beyond 1e60, a segment with an index out of range, or curves that branch.

    Warns:
        MeshfitWarning: with the number of dropped vertices.
    """
    file = _opened(path, "curve", file_format)
    form = CURVE_FORMATS[file.suffix]
    verts, segments = parse_file(file, form.read, CURVE_FORMATS)
    if not len(segments):
        raise DomainError(f"{file.name}: no curves in it; {format_name(file.suffix)} holds them as {form.elements}")
    require_finite_verts(verts, file.name)
    return _without_unused_verts(verts, join_segments(len(verts), segments, file.name), file.name)


@no_type_check
def open_mesh_file(
    path: str | Path, kind: Literal["mesh", "curve"], file_format: str | None = None, *, points: bool = False
) -> MeshFile:
    """Read a file's bytes once, for functions that take it in place of a path.

    Args:
        path: as for `load_mesh`.
        kind: of its content.
        file_format: as for `load_mesh`.
        points: name the formats of point clouds, too, among those that are allowed.

    Raises:
        FormatError: the format is not known, or the content is not of it.
        MeshError: no such file, or one that cannot be read.
    """
    if kind == "curve":
        return read_file(path, CURVE_FORMATS, kind, file_format)
    suffix = format_suffix(path) if file_format is None else suffix_of_format(file_format)
    # Point clouds are recognised, but are not among the formats that messages allow for a mesh.
    formats = READABLE_FORMATS | POINT_FORMATS if points or suffix in POINT_FORMATS else READABLE_FORMATS
    return read_file(path, formats, kind, file_format)


@no_type_check
def save_mesh(
    mesh: "MeshLike", path: str | Path, normals: Normals | None = None, *, file_format: str | None = None
) -> None:
    """Write a mesh in the format of the suffix, in double precision except STL, GLB and glTF, which are single.

    OBJ, OFF and PLY keep polygons; STL, GLB and glTF get their triangles. A format keeps what it can of the mesh's
    attributes; a warning names what it cannot hold.

    Args:
        mesh: V vertices, in any form that `as_mesh` takes.
        path: of the file, compressed if it ends in `.gz`, `.bz2` or `.xz`; the text `-` is standard output.
        normals: (V, 3) of the vertices, for OBJ and PLY.
        file_format: the format, such as `ply`, in place of the suffix.

    Example:
        >>> import meshfit
        >>> meshfit.save_mesh("icosahedron", "ball.ply")
        >>> meshfit.load_mesh("ball.ply")
        Mesh(12 verts, 20 faces, box 1.701 × 1.701 × 1.701)

    Raises:
        MeshError: not a mesh, an unknown format or one without normals, normals of another shape, coordinates too large
            for single precision, or a path that cannot be written.
    """
    path = as_path(path, "save_mesh(mesh, path)")
    mesh = as_mesh(mesh)
    suffix, name = mesh_output_suffix(path, file_format), path_text(path)
    if not FORMATS[suffix].double and not np.abs(mesh.verts).max(initial=0.0) <= _LARGEST_SINGLE:
        raise MeshError(f"{name}: {format_name(suffix)} holds single precision, too small for the coordinates")
    if normals is not None:
        normals = _checked_normals(normals, mesh.num_verts)
    if normals is not None and not FORMATS[suffix].normals:
        with_normals = " and ".join(suffix for suffix, form in FORMATS.items() if form.normals)
        raise MeshError(f"{name}: vertex normals can be written to {with_normals} files only")
    if mesh.attributes and (left_out := FORMATS[suffix].left_out(PolygonMesh.of(mesh))):
        pronoun = "they are" if len(left_out) > 1 or left_out[0].endswith("s") else "it is"
        text = f"{name}: {format_name(suffix)} cannot hold {', '.join(left_out)}; {pronoun} left out"
        warnings.warn(text, MeshfitWarning, stacklevel=2)
    options = _write_beside(mesh, suffix, path)
    if normals is not None:
        options["normals"] = normals
    write_file(path, FORMATS[suffix].write(mesh, **options))


@no_type_check
def _checked_normals(normals: Normals, num_verts: int) -> Normals:
    """Return vertex normals as float64; refuse what is not a row of three numbers for each vertex."""
    try:
        array = np.asarray(normals, dtype=np.float64)
    except (TypeError, ValueError):
        array = None
    if array is None or array.shape != (num_verts, 3):
        found = described(normals) if array is None or not array.shape else f"shape {array.shape}"
        raise MeshError(f"normals: expected an array of shape ({num_verts}, 3), one row per vertex; got {found}")
    return array


def _write_beside(mesh: Mesh | PolygonMesh, suffix: str, path: str | Path) -> dict[str, Any]:
    """Write the files beside a mesh file, its materials and textures, and return what its writer needs to name them.

    Warns:
        MeshfitWarning: where they cannot be written, beside standard output or a compressed file.
    """
    materials = mesh.attributes.materials if MATERIAL in mesh.attributes.face else ()
    images = ply.textures_of(mesh)[0] if suffix == ".ply" else []
    if not images and not (suffix == ".obj" and any(map(has_look, materials))):
        return {}
    if path in STDOUT_PATHS or compression_suffix(path) or not (is_regular_file(path) or not os.path.lexists(path)):
        name = "standard output" if path in STDOUT_PATHS else path_text(path)
        what = "its textures" if images else "the looks of its materials"
        warnings.warn(f"{name}: {what} would be in files beside it; they are left out", MeshfitWarning, stacklevel=3)
        return {}
    options: dict[str, Any]
    if suffix == ".obj":
        library = library_beside(materials, Path(path))
        options, files = {"library": library.name}, library.files
    else:
        beside = ImagesBeside(Path(path).parent)
        options = {"textures": [beside.place(image, file_stem(path)) for image in images]}
        files = beside.files
    for file, content in files.items():
        replace_file(file, content)
    return options


@no_type_check
def save_curves(curves: Curves, path: str | Path, *, file_format: str | None = None) -> None:
    """Write curves as OBJ or PLY, in double precision.

    Args:
        curves: the curves.
        path: as for `save_mesh`.
        file_format: as for `save_mesh`.

    Example:
        >>> import meshfit
        >>> square = meshfit.Curves.through([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], closed=True)
        >>> meshfit.save_curves(square, "square.ply")

    Raises:
        MeshError: not curves, an unknown format, or a path that cannot be written.
    """
    path = as_path(path, "save_curves(curves, path)")
    if not isinstance(curves, Curves):
        raise MeshError(f"curves: expected Curves, got {type(curves).__name__}; save_mesh writes meshes")
    write_file(path, encode_curves(curves, curve_output_suffix(path, file_format)))


@no_type_check
def mesh_output_suffix(path: str | Path, file_format: str | None = None) -> str:
    """Return the suffix of the format in which `save_mesh` writes a file; unknown ones raise MeshError."""
    return output_suffix(path, FORMATS, "mesh", file_format)


@no_type_check
def curve_output_suffix(path: str | Path, file_format: str | None = None) -> str:
    """Return the suffix of the format in which `save_curves` writes a file; unknown ones raise MeshError."""
    return output_suffix(path, CURVE_FORMATS, "curve", file_format)


def encode_mesh(mesh: Mesh | PolygonMesh, suffix: str, normals: Normals | None = None) -> bytes:
    """Return the bytes of a mesh file with this suffix; the same mesh gives the same bytes."""
    write = FORMATS[suffix].write
    return write(mesh) if normals is None else write(mesh, normals)


def encode_curves(curves: Curves, suffix: str) -> bytes:
    """Return the bytes of a curve file with this suffix; the same curves give the same bytes."""
    return CURVE_FORMATS[suffix].write(curves)


@no_type_check
def _opened(path: str | Path | MeshFile, kind: Literal["mesh", "curve"], file_format: str | None) -> MeshFile:
    return path if isinstance(path, MeshFile) else open_mesh_file(as_path(path), kind, file_format)


def read_soup(file: MeshFile, *, attributes: bool = False) -> PolygonSoup:
    """Return the raw content of a mesh file, with vertices and perhaps without faces.

    Args:
        file: the file.
        attributes: read them too.

    Raises:
        MeshError: an unreadable file.
    """
    form = READABLE_FORMATS[file.suffix]
    options: dict[str, Any] = {"folder": file.folder} if form.folder else {}
    options |= {"attributes": attributes} if form.attributes else {}
    soup = parse_file(file, partial(form.read, **options), READABLE_FORMATS)
    for array in (soup.verts, soup.corners, soup.sizes):  # so that meshes share them, rather than copy them
        freeze(array)
    if not len(soup.verts):
        raise _unreadable(file, "no vertices in it; another format, or cut short", READABLE_FORMATS)
    if attributes and form.unread:
        unread = [words for words, pattern in form.unread.items() if re.search(pattern, file.content)]
        if unread:
            text = f"{', '.join(unread)} are not read from {format_name(file.suffix)}"
            warnings.warn(f"{file.name}: {text}", MeshfitWarning, stacklevel=3)
    return soup


def _read_surface(file: MeshFile, *, attributes: bool) -> PolygonSoup:
    """Return the raw content of a mesh file that has faces; refuse points and curves as what they are."""
    if file.suffix in POINT_FORMATS:
        read, count = POINT_FORMATS[file.suffix]
        num_points = parse_file(
            file, count or (lambda content: len(read(content).verts)), READABLE_FORMATS | POINT_FORMATS
        )
        raise NoFacesError(f"{file.name}: {no_faces_message(num_points)}")
    soup = read_soup(file, attributes=attributes)
    if not len(soup.sizes):
        curves = CURVE_FORMATS.get(file.suffix)
        num_segments = len(parse_file(file, curves.read, CURVE_FORMATS)[1]) if curves else 0
        error = DomainError if num_segments else NoFacesError
        raise error(f"{file.name}: {no_faces_message(len(soup.verts), num_segments)}")
    return soup


def parse_file(file: MeshFile, parse: Callable[[bytes], _Content], suffixes: Collection[str]) -> _Content:
    """Return the parsed content of a file; its name precedes the errors and warnings of the parser."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            parsed = parse(file.content)
        except MeshError as error:
            raise _unreadable(file, str(error), suffixes) from None
        except MemoryError:
            raise MeshError(f"{file.name}: the file needs more memory than is free") from None
        except Exception as error:
            raise _unreadable(file, "the file is damaged, or of another format", suffixes) from error
    for warning in caught:
        if issubclass(warning.category, MeshfitWarning):
            warnings.warn(f"{file.name}: {warning.message}", MeshfitWarning, stacklevel=4)
    return parsed


def _unreadable(file: MeshFile, reason: str, suffixes: Collection[str]) -> MeshError:
    mismatch = wrong_format(file, suffixes)
    return mismatch or MeshError(f"{file.name}: cannot be read as {format_name(file.suffix)}: {reason}")


def _without_unused_verts(verts: Verts, chains: Chains, origin: str) -> Curves:
    used = np.zeros(len(verts), dtype=bool)
    used[chains.corners] = True
    if not used.all():
        unused = count_text(int((~used).sum()), "vertex")
        warnings.warn(f"{origin}: dropped {unused} that no curve uses", MeshfitWarning, stacklevel=3)
    return Curves(verts[used], (np.cumsum(used) - 1)[chains.corners], chains.sizes, chains.closed)
