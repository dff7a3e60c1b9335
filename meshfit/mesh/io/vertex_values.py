"""One number per vertex of a mesh file, from a text file or from a property of the PLY file itself."""

import warnings
from math import inf
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.cleaning import VertexMap
from meshfit.mesh.io.mesh_file import MeshFile, read_file
from meshfit.mesh.io.ply import read_ply_property
from meshfit.mesh.io.text import parse_float, read_word_lines
from meshfit.paths import MESH_SUFFIXES, format_suffix, path_text

Values = Float64[np.ndarray, "_"]


def read_vertex_values(path: str | Path, vertex_map: VertexMap, within: tuple[float, float] = (-inf, inf)) -> Values:
    """Return (V,) the numbers of a text file with one line per vertex of the mesh file; `#` begins a comment.

    Args:
        path: of the text file.
        vertex_map: the vertices of the mesh that those of the file became, from `load_mesh_with_vertex_map`.
        within: the smallest and the largest number allowed.

    Raises:
        MeshError: the file cannot be read, a line is not an allowed number, the count differs from that of the mesh
            file's vertices, or vertices that were welded have different numbers.
    """
    values = []
    for number, words in read_word_lines(path):
        value = parse_float(words[0].encode()) if len(words) == 1 else None
        if value is None:
            raise MeshError(f"{path}, line {number}: expected one number, got '{' '.join(words)}'")
        values.append(value)
    if len(values) != vertex_map.num_file_verts:
        raise MeshError(
            f"{path}: expected one number for each of the {vertex_map.num_file_verts} vertices of the mesh file, "
            f"got {len(values)}"
        )
    return _at_mesh_verts(np.array(values, dtype=np.float64), vertex_map, within, str(path))


def read_vertex_property(
    path: str | Path | MeshFile, name: str, vertex_map: VertexMap, within: tuple[float, float] = (-inf, inf)
) -> Values:
    """Return (V,) a vertex property of a PLY file, such as `property float alpha`.

    Args:
        path: of the mesh file; or the file, if it has been read.
        name: of the property.
        vertex_map: as for `read_vertex_values`.
        within: as for `read_vertex_values`.

    Raises:
        MeshError: the file is not a PLY or lacks the property, a value is not allowed, or vertices that were welded
            have different values.
    """
    origin, suffix = (path.name, path.suffix) if isinstance(path, MeshFile) else (path_text(path), format_suffix(path))
    if suffix != ".ply":
        raise MeshError(
            f"{origin}: '{name}' can be read from a PLY file only; use a text file with one number per line instead"
        )
    file = path if isinstance(path, MeshFile) else read_file(path, MESH_SUFFIXES, "mesh")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshfitWarning)  # they were given when the mesh was read
            values = read_ply_property(file.content, name)
    except MeshError as error:
        raise MeshError(f"{file.name}: '{name}' cannot be read: {error}") from error
    except Exception as error:
        raise MeshError(f"{file.name}: '{name}' cannot be read: not all of its values are numbers") from error
    return _at_mesh_verts(values, vertex_map, within, f"{file.name}: '{name}'")


def _at_mesh_verts(values: Values, vertex_map: VertexMap, within: tuple[float, float], origin: str) -> Values:
    kept, verts = vertex_map.pairs()
    outside = kept[~((values[kept] >= within[0]) & (values[kept] <= within[1]))]
    if len(outside):
        bad, allowed = int(outside[0]), "" if np.isinf(within[0]) else f" from {within[0]:g} to {within[1]:g}"
        raise MeshError(f"{origin}: vertex {bad}: expected a number{allowed}, got {values[bad]:g}")
    _, first, row = np.unique(verts, return_index=True, return_inverse=True)
    of_vert = kept[first]
    differs = np.flatnonzero(values[of_vert[row]] != values[kept])
    if len(differs):
        bad, other = int(kept[differs[0]]), int(of_vert[row[differs[0]]])
        raise MeshError(
            f"{origin}: vertices {other} and {bad} share a position on a seam, but have {values[other]:g} and "
            f"{values[bad]:g}; give both the same value"
        )
    return np.asarray(values[of_vert])
