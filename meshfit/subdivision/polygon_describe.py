"""The masks of a scheme on polygons as people write them, read off the operators that they were laid down as."""

from collections.abc import Iterator

import numpy as np
from scipy.sparse import csr_array

from meshfit.mesh.polygon_topology import PolygonTopology
from meshfit.subdivision.mask_rows import MaskRow, along, entries, grouped, number, push_back_row
from meshfit.subdivision.polygon_masks import CornerMask, NetMask
from meshfit.subdivision.polygon_scheme import PolygonScheme, PolygonSplit
from meshfit.subdivision.refine import refine

_SIDE = 12
_AT = 5
_VALENCES = (3, 4, 5, 7, 8)
Offsets = tuple[tuple[int, int], ...]

# By where verts are from the origin of the lattice, for a new vertex near to it in each of the edges and faces.
_AT_VERT: dict[str, Offsets] = {
    "itself": ((0, 0),),
    "each neighbour": ((1, 0), (0, 1), (-1, 0), (0, -1)),
    "each diagonally across": ((1, 1), (-1, 1), (1, -1), (-1, -1)),
}
_IN_EDGE: dict[str, Offsets] = {
    "near end": ((0, 0),),
    "far end": ((1, 0),),
    "each beside the near end": ((0, 1), (0, -1)),
    "each beside the far end": ((1, 1), (1, -1)),
    "before the near end": ((-1, 0),),
    "beyond the far end": ((2, 0),),
    "each diagonally off": ((-1, 1), (-1, -1), (2, 1), (2, -1)),
}
_IN_FACE: dict[str, Offsets] = {
    "near corner": ((0, 0),),
    "each corner beside it": ((1, 0), (0, 1)),
    "far corner": ((1, 1),),
    "each across an edge": ((-1, 0), (0, -1), (-1, 1), (1, -1), (2, 0), (0, 2), (2, 1), (1, 2)),
    "each diagonally off": ((-1, -1), (2, -1), (-1, 2), (2, 2)),
}
# The same where an edge has one vertex in its middle, and a face too.
_MID_EDGE: dict[str, Offsets] = {
    "each end": ((0, 0), (1, 0)),
    "each beside an end": ((0, 1), (0, -1), (1, 1), (1, -1)),
    "each beyond an end": ((-1, 0), (2, 0)),
    "each diagonally off": _IN_EDGE["each diagonally off"],
}
_MID_FACE: dict[str, Offsets] = {
    "each corner": ((0, 0), (1, 0), (0, 1), (1, 1)),
    "each across an edge": _IN_FACE["each across an edge"],
    "each diagonally off": _IN_FACE["each diagonally off"],
}


def describe_on_polygons(scheme: PolygonScheme) -> Iterator[MaskRow]:
    """The masks of a scheme on regular quads, at extraordinary vertices or faces, and along the boundary."""
    lattice = _lattice(closed=True)
    rows = refine(lattice, scheme).operators[0]
    origin = _AT * _SIDE + _AT
    if scheme.split is not PolygonSplit.DUAL:
        yield MaskRow("old vertex, valence 4", grouped(rows, origin, _named(origin, _AT_VERT), "other"))
    middle = scheme.split in (PolygonSplit.QUADS, PolygonSplit.SQRT2)
    names = (_MID_EDGE, _MID_FACE) if middle else (_IN_EDGE, _IN_FACE)
    for where, offsets, ends in (("an edge", names[0], 2), ("a face", names[1], 4)):
        roles = _named(origin, offsets)
        row = _nearest(rows, list(roles)[:ends], _SIDE**2)
        if row is not None:
            yield MaskRow(f"new vertex in {where}, regular", grouped(rows, row, roles, "other"))
    yield from _extraordinary(scheme)
    yield from _boundary(scheme)
    if scheme.push_back is not None:
        yield push_back_row(scheme.push_back)


def _extraordinary(scheme: PolygonScheme) -> Iterator[MaskRow]:
    mask = scheme.inserted
    if scheme.vert is not None and scheme.split is not PolygonSplit.TERNARY:
        found = {n: ", ".join(str(weight) for weight in scheme.vert.weights(n)) for n in _VALENCES}
        same = len(set(found.values())) == 1
        weights = found[_VALENCES[0]] if same else "; ".join(f"n = {n}: {found[n]}" for n in found)
        base = "base: " if scheme.push_back is not None else ""
        yield MaskRow("old vertex, valence n", f"{base}itself, mean of neighbours, mean of faces' means: {weights}")
    if isinstance(mask, CornerMask):
        for n in _VALENCES[:3]:
            weights = ", ".join(number(float(weight)) for weight in mask.weights(n))
            yield MaskRow(f"new vertex in a face of {n}", f"{weights} around it, from its own corner on")
    if isinstance(mask, NetMask) and mask.diagonal is not None:
        ring, far = "4/n Σl - (l_i-1 + l_i + l_i+1)", "(h_i-2 + h_i-1 + h_i + h_i+1 - 4/n Σh)"
        yield MaskRow(
            "beyond valence n, from neighbour l_i", f"{ring} + {mask.diagonal} {far}, h_i between l_i and l_i+1"
        )


def _boundary(scheme: PolygonScheme) -> Iterator[MaskRow]:
    """Read off in the second step, the one in which √2 schemes refine the boundary."""
    patch = _lattice(closed=False)
    rows = refine(patch, scheme, 2 if scheme.split is PolygonSplit.SQRT2 else 1).operators[-1]
    if scheme.split is not PolygonSplit.DUAL:
        yield MaskRow("boundary, old vertex", along(rows, _AT, _AT))
    row = _nearest(rows, [_AT, _AT + 1], _SIDE)
    if row is not None:
        yield MaskRow("boundary, new vertex", along(rows, row, _AT))


def _nearest(rows: csr_array, verts: list[int], num_allowed: int) -> int | None:
    """The row whose heaviest weights are at some verts, at the first no less than at others; of so many verts alone."""
    for row in range(rows.shape[0]):
        found = dict(entries(rows, row))
        inside = max(found) < num_allowed
        own = [found.pop(vert, 0.0) for vert in verts]
        if inside and min(own) > max([0.0, *found.values()]) + 1e-12 and own[0] > max(own) - 1e-12:
            return row
    return None


def _named(origin: int, names: dict[str, Offsets]) -> dict[int, str]:
    return {origin + i + j * _SIDE: role for role, offsets in names.items() for i, j in offsets}


def _lattice(*, closed: bool) -> PolygonTopology:
    """A regular lattice of quads: vertex (i, j) is i + j·side; closed up, or with j = 0 on its boundary."""
    j, i = np.divmod(np.arange(_SIDE * _SIDE), _SIDE)
    here = np.flatnonzero(closed | ((i < _SIDE - 1) & (j < _SIDE - 1)))
    right, up = (i + 1) % _SIDE, (j + 1) % _SIDE * _SIDE
    quads = np.stack([here, (right + j * _SIDE)[here], (right + up)[here], (i + up)[here]], axis=1)
    return PolygonTopology(_SIDE**2, quads.reshape(-1), np.full(len(quads), 4))
