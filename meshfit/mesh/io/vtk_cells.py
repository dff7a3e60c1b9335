"""Cells of VTK files as polygons."""

import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.polygons import PolygonSoup

_TRIANGLE, _STRIP, _POLYGON, _PIXEL, _QUAD = 5, 6, 7, 8, 9
_SURFACE = (_TRIANGLE, _STRIP, _POLYGON, _PIXEL, _QUAD)
_POINTS_AND_LINES = (0, 1, 2, 3, 4, 21, 35, 68, 75)
_VOLUMES = {
    10: "tetrahedra", 11: "voxels", 12: "hexahedra", 13: "wedges", 14: "pyramids", 15: "pentagonal prisms",
    16: "hexagonal prisms", 24: "quadratic tetrahedra", 25: "quadratic hexahedra", 26: "quadratic wedges",
    27: "quadratic pyramids", 29: "quadratic hexahedra", 42: "polyhedra", 71: "Lagrange tetrahedra",
    72: "Lagrange hexahedra",
}  # fmt: skip
_CURVED = {
    22: "quadratic triangles", 23: "quadratic quads", 28: "quadratic quads", 34: "quadratic triangles",
    36: "quadratic polygons", 69: "Lagrange triangles", 70: "Lagrange quads", 76: "Bezier triangles",
    77: "Bezier quads",
}  # fmt: skip


class Cells(NamedTuple):
    """Cells of an unstructured grid: their corners one after the other, their sizes and their types."""

    corners: NDArray[np.int64]
    sizes: NDArray[np.int64]
    types: NDArray[np.int64]

    @classmethod
    def of_type(cls, corners: NDArray[np.int64], sizes: NDArray[np.int64], kind: str) -> "Cells":
        """Return the polygons, strips, lines or vertices of poly data."""
        number = {"polygons": _POLYGON, "strips": _STRIP, "lines": 4, "verts": 2}[kind]
        return cls(corners, sizes, np.full(len(sizes), number))


def surface(verts: NDArray[np.float64], pieces: list[Cells]) -> PolygonSoup:
    """Return the polygons among the cells: triangles, quads, polygons and triangle strips.

    Raises:
        MeshError: cells of solids alone, curved ones, or corners that are not vertices.

    Warns:
        MeshfitWarning: with the number of cells that are passed over.
    """
    cells = Cells(*(np.concatenate([piece[column] for piece in pieces]) for column in range(3)))
    _check(cells, len(verts))
    chosen = np.isin(cells.types, _SURFACE)
    if len(other := cells.types[~chosen]):
        _warn_of_others(other, alone=not chosen.any())
    corners, sizes, types = cells.corners[np.repeat(chosen, cells.sizes)], cells.sizes[chosen], cells.types[chosen]
    _check_sizes(sizes, types)
    corners = _pixels_as_quads(corners, sizes, types)
    if (types == _STRIP).any():
        corners, sizes = _without_strips(corners, sizes, types)
    return PolygonSoup(verts, corners, sizes)


def _check(cells: Cells, num_verts: int) -> None:
    outside = np.flatnonzero((cells.corners < 0) | (cells.corners >= num_verts))
    if len(outside):
        bad = int(np.searchsorted(np.cumsum(cells.sizes), outside[0], side="right"))
        corner = int(cells.corners[outside[0]])
        raise MeshError(f"cell {bad} names point {corner}, but points are numbered 0 to {num_verts - 1}")


def _warn_of_others(types: NDArray[np.int64], *, alone: bool) -> None:
    solids, curved = (
        [f"{int((types == number).sum())} {name}" for number, name in names.items() if (types == number).any()]
        for names in (_VOLUMES, _CURVED)
    )
    if curved:
        raise MeshError(f"{', '.join(curved)}, which are not supported; expected cells with straight edges")
    unknown = np.setdiff1d(types, [*_VOLUMES, *_POINTS_AND_LINES])
    if len(unknown):
        raise MeshError(f"cells of type {int(unknown[0])}, which is not supported")
    if solids and alone:
        raise MeshError(
            f"a volume mesh of {', '.join(solids)}; expected a surface: extract it, for example with ParaView's "
            "filter Extract Surface"
        )
    flat = int(np.isin(types, _POINTS_AND_LINES).sum())
    passed_over = [*solids, *([f"{flat} points and lines"] if flat else [])]
    if not alone:
        warnings.warn(f"passed over {', '.join(passed_over)}", MeshfitWarning, stacklevel=3)


def _check_sizes(sizes: NDArray[np.int64], types: NDArray[np.int64]) -> None:
    expected = np.select([types == _TRIANGLE, types == _QUAD, types == _PIXEL], [3, 4, 4], sizes)
    bad = np.flatnonzero((sizes != expected) | (sizes < 3))
    if len(bad):
        wanted = f"{int(expected[bad[0]])}" if sizes[bad[0]] != expected[bad[0]] else "3 or more"
        raise MeshError(f"surface cell {bad[0]}: expected {wanted} corners, got {int(sizes[bad[0]])}")


def _pixels_as_quads(
    corners: NDArray[np.int64], sizes: NDArray[np.int64], types: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the corners with those of each pixel in order around it; a pixel lists them row by row."""
    if not (types == _PIXEL).any():
        return corners
    third = (np.cumsum(sizes) - sizes)[types == _PIXEL] + 2
    result = corners.copy()
    result[third], result[third + 1] = corners[third + 1], corners[third]
    return result


def _without_strips(
    corners: NDArray[np.int64], sizes: NDArray[np.int64], types: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cells with triangles in the place of strips, without those that only lead a strip elsewhere."""
    is_strip = types == _STRIP
    counts = np.where(is_strip, sizes - 2, 1)
    new_sizes = np.repeat(np.where(is_strip, 3, sizes), counts)
    step = np.arange(len(new_sizes)) - np.repeat(np.cumsum(counts) - counts, counts)
    first = np.repeat(np.cumsum(sizes) - sizes, counts) + step
    strip = np.repeat(is_strip, counts)
    ends = np.cumsum(new_sizes)
    place = np.arange(int(ends[-1])) - np.repeat(ends - new_sizes, new_sizes)
    odd = np.repeat(strip & (step % 2 == 1), new_sizes)
    turned = np.where(odd & (place > 0), 3 - place, place)
    result = corners[np.repeat(first, new_sizes) + turned]
    keep = np.ones(len(new_sizes), dtype=bool)
    starts = (ends - new_sizes)[strip]
    a, b, c = result[starts], result[starts + 1], result[starts + 2]
    keep[strip] = (a != b) & (b != c) & (c != a)
    return result[np.repeat(keep, new_sizes)], new_sizes[keep]
