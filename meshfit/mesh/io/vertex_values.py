"""Numbers given at the verts of a mesh file, by a text file or by the PLY file itself, for the verts of its mesh."""

from collections.abc import Iterator
from math import inf
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError
from meshfit.mesh.io.ply import read_ply_property
from meshfit.mesh.topology import NONE, Indices

Values = Float64[np.ndarray, "_"]


def read_vertex_values(path: str | Path, numbering: Indices, within: tuple[float, float] = (-inf, inf)) -> Values:
    """(V,) the numbers of a text file: one a line for each vertex of the mesh file, in its order; `#` begins a comment.

    Args:
        path: of the text file.
        numbering: (N,) the vertex that each of the mesh file's verts is now, as `load_numbered` tells it.
        within: the least and the most that is allowed.

    Raises:
        MeshError: it cannot be read, a line is no number that is allowed, there are more or fewer of them than verts in
            the mesh file, or two verts that were welded have different ones.
    """
    values = []
    for number, words in read_word_lines(path):
        try:
            (value,) = map(float, words)
        except ValueError:
            raise MeshError(f"{path}, line {number}: found '{' '.join(words)}'; one number is needed") from None
        values.append(value)
    if len(values) != len(numbering):
        raise MeshError(
            f"{path}: found {len(values)} numbers; the mesh file has {len(numbering)} verts, and one for each is needed"
        )
    return _at_verts(np.array(values, dtype=np.float64), numbering, within, str(path))


def read_vertex_property(
    path: str | Path, name: str, numbering: Indices, within: tuple[float, float] = (-inf, inf)
) -> Values:
    """(V,) a property of the verts of a PLY file, such as `property float alpha`.

    Args:
        path: of the mesh file.
        name: of the property.
        numbering: as for `read_values`.
        within: as for `read_values`.

    Raises:
        MeshError: it is no PLY file, has no such property, a value is not allowed, or two verts that were welded differ
            in it.
    """
    path = Path(path)
    if path.suffix.lower() != ".ply":
        raise MeshError(f"{path}: '{name}' can be read from a PLY file only; a text file with a number a line would do")
    try:
        values = read_ply_property(path.read_bytes(), name)
    except (OSError, ValueError) as error:
        raise MeshError(f"{path}: '{name}' cannot be read: {error}") from error
    return _at_verts(values, numbering, within, f"{path}: '{name}'")


def read_word_lines(path: str | Path) -> Iterator[tuple[int, list[str]]]:
    """The lines of a text file that hold anything, by number, in words; `#` begins a comment.

    Raises:
        MeshError: it cannot be read.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise MeshError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
    for number, line in enumerate(text.splitlines(), 1):
        if words := line.partition("#")[0].split():
            yield number, words


def _at_verts(values: Values, numbering: Indices, within: tuple[float, float], origin: str) -> Values:
    kept = np.flatnonzero(numbering != NONE)
    outside = kept[~((values[kept] >= within[0]) & (values[kept] <= within[1]))]
    if len(outside):
        bad, allowed = int(outside[0]), "" if np.isinf(within[0]) else f" from {within[0]:g} to {within[1]:g}"
        raise MeshError(f"{origin}: vertex {bad} has {values[bad]:g}; a number{allowed} is needed")
    verts, first = np.unique(numbering[kept], return_index=True)
    found = np.empty(len(verts))
    found[verts] = values[kept[first]]
    differs = kept[found[numbering[kept]] != values[kept]]
    if len(differs):
        bad = int(differs[0])
        other = int(kept[first[numbering[bad]]])
        raise MeshError(
            f"{origin}: verts {other} and {bad} lie at one place of a seam, but have {values[other]:g} and "
            f"{values[bad]:g}; give them the same"
        )
    return found
