"""Masks of a scheme as people write them: weights as fractions, by the roles of the vertices around an edge or face.

The rows are read off the operators that the scheme makes of a regular mesh, on which vertex (i, j) is i + j·side.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.sparse import coo_array, csr_array

from meshfit.mesh.curves import Chains
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.curves.assemble import assemble_curves
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import CornerMask, PolygonScheme, PolygonSplit, TensorProductMask
from meshfit.subdivision.refine import refine
from meshfit.subdivision.registry import Scheme
from meshfit.subdivision.triangles.assemble import assemble
from meshfit.subdivision.triangles.scheme import Split, TriangleScheme
from meshfit.subdivision.triangles.splits import divide

_LARGEST_DENOMINATOR = 8192
_ZERO = 1e-14
_VALENCES = (3, 4, 5, 7, 8)
_SIDE = 12
_INNER = 5  # index along a curve, or coordinate on a lattice, of a vertex far from the border
_ORIGIN = _INNER * _SIDE + _INNER

Offsets = dict[str, tuple[tuple[int, int], ...]]
"""Coordinates of vertices relative to the origin of a lattice, by role."""

# On triangles, where (i, j) has the neighbours (±1, 0), (0, ±1), (1, -1), (-1, 1): in the edge or face at the origin.
_TRIANGLE_EDGE: Offsets = {
    "each end": ((0, 0), (1, 0)),
    "each opposite": ((0, 1), (1, -1)),
    "each wing": ((-1, 1), (1, 1), (0, -1), (2, -1)),
    "each in line": ((-1, 0), (2, 0)),
}
_TRIANGLE_FACE: Offsets = {
    "each corner": ((0, 0), (1, 0), (0, 1)),
    "each across an edge": ((1, -1), (1, 1), (-1, 1)),
    "each wing": ((0, -1), (2, -1), (2, 0), (0, 2), (-1, 2), (-1, 0)),
}
# On quads: of an old vertex, and of new ones near the origin in an edge and in a face.
_QUAD_VERT: Offsets = {
    "itself": ((0, 0),),
    "each neighbour": ((1, 0), (0, 1), (-1, 0), (0, -1)),
    "each diagonally across": ((1, 1), (-1, 1), (1, -1), (-1, -1)),
}
_QUAD_EDGE: Offsets = {
    "near end": ((0, 0),),
    "far end": ((1, 0),),
    "each beside the near end": ((0, 1), (0, -1)),
    "each beside the far end": ((1, 1), (1, -1)),
    "before the near end": ((-1, 0),),
    "beyond the far end": ((2, 0),),
    "each diagonally off": ((-1, 1), (-1, -1), (2, 1), (2, -1)),
}
_QUAD_FACE: Offsets = {
    "near corner": ((0, 0),),
    "each corner beside it": ((1, 0), (0, 1)),
    "far corner": ((1, 1),),
    "each across an edge": ((-1, 0), (0, -1), (-1, 1), (1, -1), (2, 0), (0, 2), (2, 1), (1, 2)),
    "each diagonally off": ((-1, -1), (2, -1), (-1, 2), (2, 2)),
}
# On quads, where an edge or face has a single new vertex in its middle.
_QUAD_EDGE_MIDDLE: Offsets = {
    "each end": ((0, 0), (1, 0)),
    "each beside an end": ((0, 1), (0, -1), (1, 1), (1, -1)),
    "each beyond an end": ((-1, 0), (2, 0)),
    "each diagonally off": _QUAD_EDGE["each diagonally off"],
}
_QUAD_FACE_MIDDLE: Offsets = {
    "each corner": ((0, 0), (1, 0), (0, 1), (1, 1)),
    "each across an edge": _QUAD_FACE["each across an edge"],
    "each diagonally off": _QUAD_FACE["each diagonally off"],
}


@dataclass(frozen=True)
class MaskRow:
    """One line of a description: the vertex, and its weights as `weight × count role`, or by valence or offset."""

    where: str
    weights: str


def describe(scheme: Scheme) -> Iterator[MaskRow]:
    """Describe the masks of a scheme: on regular meshes, at extraordinary vertices or faces, and along the boundary."""
    if isinstance(scheme, CurveScheme):
        yield from _curve_masks(scheme)
    elif isinstance(scheme, PolygonScheme):
        yield from _polygon_masks(scheme)
    else:
        yield from _triangle_masks(scheme)
    if scheme.alpha is not None:
        yield MaskRow("push-back", f"alpha = {_number(float(scheme.alpha))}: old E + αD, new O + αMD, D = I - E")


def _curve_masks(scheme: CurveScheme) -> Iterator[MaskRow]:
    """Describe the inside and the start of an open curve, whose end is the mirror image."""
    chain = Chains(_SIDE, np.arange(_SIDE), np.array([_SIDE]), np.array([False]))
    rows, num_inserted = assemble_curves(chain, scheme), len(scheme.mask.inserted)
    yield MaskRow("old vertex", _along(rows, _INNER, _INNER))
    for where, segment in {"inside": _INNER, "in an end segment": 0}.items():
        for i in range(num_inserted):
            name = "new vertex" if num_inserted == 1 else f"new vertex {i + 1} of {num_inserted}"
            yield MaskRow(f"{name}, {where}", _along(rows, _SIDE + num_inserted * segment + i, segment))
    yield MaskRow("end of an open curve", _along(rows, 0, 0))


def _triangle_masks(scheme: TriangleScheme) -> Iterator[MaskRow]:
    lattice = _triangles(closed=True)
    rows = assemble(lattice, scheme, divide(lattice, scheme.split, step=0))
    yield MaskRow("old vertex, valence 6", _by_role(rows, _ORIGIN, {"itself": ((0, 0),)}, "each neighbour"))
    if scheme.split is Split.QUADRISECT:
        edge = int(np.flatnonzero((lattice.edges == (_ORIGIN, _ORIGIN + 1)).all(axis=1))[0])
        weights = _by_role(rows, lattice.num_verts + edge, _TRIANGLE_EDGE, "other")
        yield MaskRow("new vertex in an edge, regular", weights)
    else:
        face = int(np.flatnonzero((lattice.faces == (_ORIGIN, _ORIGIN + 1, _ORIGIN + _SIDE)).all(axis=1))[0])
        weights = _by_role(rows, lattice.num_verts + face, _TRIANGLE_FACE, "other")
        yield MaskRow("new vertex in a face, regular", weights)
    if scheme.vert is not None:
        ring = ", ".join(f"n = {n}: {_number(scheme.vert.ring(n))}" for n in _VALENCES)
        yield MaskRow("old vertex, valence n", f"{_base(scheme)}1 - w itself, w / n each neighbour; w at {ring}")
    if scheme.spokes is not None:
        for n in _VALENCES[:3]:
            centre, *spokes = (_number(weight) for weight in scheme.spokes.weights(n))
            yield MaskRow(f"new vertex beside valence {n}", f"{centre} centre; spokes {', '.join(spokes)}")
    # In the second step, in which √3 schemes refine the boundary.
    patch = _triangles(closed=False)
    division = divide(patch, scheme.split, step=1)
    rows = assemble(patch, scheme, division)
    edge = int(np.flatnonzero((patch.tail[division.border] == _INNER) & (patch.head[division.border] == _INNER + 1))[0])
    yield MaskRow("boundary, old vertex", _along(rows, _INNER, _INNER))
    inserted = patch.num_verts + int(division.border_place[0][edge])
    yield MaskRow("boundary, new vertex", _along(rows, inserted, _INNER))


def _polygon_masks(scheme: PolygonScheme) -> Iterator[MaskRow]:
    rows = refine(_quads(closed=True), scheme).operators[0]
    keeps_verts = scheme.split is not PolygonSplit.DUAL
    if keeps_verts:
        yield MaskRow("old vertex, valence 4", _by_role(rows, _ORIGIN, _QUAD_VERT, "other"))
    middle = scheme.split in (PolygonSplit.QUADS, PolygonSplit.SQRT2)
    edge_roles, face_roles = (_QUAD_EDGE_MIDDLE, _QUAD_FACE_MIDDLE) if middle else (_QUAD_EDGE, _QUAD_FACE)
    for where, offsets, num_ends in (("an edge", edge_roles, 2), ("a face", face_roles, 4)):
        row = _nearest(rows, list(_roles(offsets))[:num_ends], _SIDE**2)
        if row is not None:
            yield MaskRow(f"new vertex in {where}, regular", _by_role(rows, row, offsets, "other"))
    yield from _extraordinary_polygon_masks(scheme)
    # In the second step, in which √2 schemes refine the boundary.
    rows = refine(_quads(closed=False), scheme, 2 if scheme.split is PolygonSplit.SQRT2 else 1).operators[-1]
    if keeps_verts:
        yield MaskRow("boundary, old vertex", _along(rows, _INNER, _INNER))
    row = _nearest(rows, [_INNER, _INNER + 1], _SIDE)
    if row is not None:
        yield MaskRow("boundary, new vertex", _along(rows, row, _INNER))


def _extraordinary_polygon_masks(scheme: PolygonScheme) -> Iterator[MaskRow]:
    mask = scheme.inserted
    if scheme.vert is not None and scheme.split is not PolygonSplit.TERNARY:
        by_valence = {n: ", ".join(str(weight) for weight in scheme.vert.weights(n)) for n in _VALENCES}
        same = len(set(by_valence.values())) == 1
        weights = by_valence[_VALENCES[0]] if same else "; ".join(f"n = {n}: {by_valence[n]}" for n in by_valence)
        roles = "itself, mean of neighbours, mean of faces' means"
        yield MaskRow("old vertex, valence n", f"{_base(scheme)}{roles}: {weights}")
    if isinstance(mask, CornerMask):
        for n in _VALENCES[:3]:
            weights = ", ".join(_number(float(weight)) for weight in mask.weights(n))
            yield MaskRow(f"new vertex in a face of {n}", f"{weights} around it, from its own corner on")
    if isinstance(mask, TensorProductMask) and mask.diagonal is not None:
        ring, far = "4/n Σl - (l_i-1 + l_i + l_i+1)", "(h_i-2 + h_i-1 + h_i + h_i+1 - 4/n Σh)"
        weights = f"{ring} + {mask.diagonal} {far}, h_i between l_i and l_i+1"
        yield MaskRow("beyond valence n, from neighbour l_i", weights)


def _base(scheme: TriangleScheme | PolygonScheme) -> str:
    return "" if scheme.alpha is None else "base: "


def _number(value: float) -> str:
    """Write a weight as a fraction if one of small denominator equals it, else to six digits."""
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return str(fraction) if abs(float(fraction) - value) < 1e-12 else f"{value:.6f}"


def _entries(rows: csr_array, row: int) -> list[tuple[int, float]]:
    """Return the columns and weights of a row, without those that are zero up to rounding."""
    line = coo_array(rows[[row]])
    pairs = zip(line.coords[1], line.data, strict=True)
    return [(int(column), float(weight)) for column, weight in pairs if abs(weight) > _ZERO]


def _roles(offsets: Offsets) -> dict[int, str]:
    return {_ORIGIN + i + j * _SIDE: role for role, places in offsets.items() for i, j in places}


def _by_role(rows: csr_array, row: int, offsets: Offsets, others: str) -> str:
    """Write a row's weights, with the number of vertices of each role that have them."""
    roles = _roles(offsets)
    counts: dict[tuple[str, str], int] = {}
    for column, weight in _entries(rows, row):
        key = (roles.get(column, others), _number(weight))
        counts[key] = counts.get(key, 0) + 1
    order = [*offsets, others]
    groups = sorted(counts.items(), key=lambda item: order.index(item[0][0]))
    return ", ".join(f"{weight} {role}" + (f" ({count})" if count > 1 else "") for (role, weight), count in groups)


def _along(rows: csr_array, row: int, origin: int) -> str:
    """Write a row's weights along a boundary or another curve, by offset from one of its vertices."""
    weights = {column - origin: weight for column, weight in _entries(rows, row)}
    listed = ", ".join(_number(weights[offset]) for offset in sorted(weights))
    return f"{listed} " + (f"at {min(weights)} … {max(weights)} along it" if len(weights) > 1 else "itself")


def _nearest(rows: csr_array, verts: list[int], num_allowed: int) -> int | None:
    """Return the row whose heaviest weights are those of some vertices, the first heaviest; of low columns alone."""
    for row in range(rows.shape[0]):
        weights = dict(_entries(rows, row))
        inside = max(weights) < num_allowed
        own = [weights.pop(vert, 0.0) for vert in verts]
        if inside and min(own) > max([0.0, *weights.values()]) + 1e-12 and own[0] > max(own) - 1e-12:
            return row
    return None


def _cells(*, closed: bool) -> np.ndarray:
    """(N, 4) the corners of the cells of a lattice, counter-clockwise; closed up, or with j = 0 on its boundary."""
    j, i = np.divmod(np.arange(_SIDE * _SIDE), _SIDE)
    cell = np.flatnonzero(closed | ((i < _SIDE - 1) & (j < _SIDE - 1)))
    right, up = (i + 1) % _SIDE, (j + 1) % _SIDE * _SIDE
    return np.stack([cell, (right + j * _SIDE)[cell], (right + up)[cell], (i + up)[cell]], axis=1)


def _quads(*, closed: bool) -> PolygonTopology:
    quads = _cells(closed=closed)
    return PolygonTopology(_SIDE**2, quads.reshape(-1), np.full(len(quads), 4))


def _triangles(*, closed: bool) -> Topology:
    corner, right, opposite, up = _cells(closed=closed).T
    faces = np.concatenate([np.stack([corner, right, up], 1), np.stack([right, opposite, up], 1)])
    return Topology(_SIDE**2, faces)
