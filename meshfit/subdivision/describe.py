"""Rows of an operator as people write them: weights as fractions, by the roles that the verts play."""

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
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.triangles.assemble import assemble
from meshfit.subdivision.triangles.scheme import PushBack, Split, TriangleScheme
from meshfit.subdivision.triangles.splits import divide

_LARGEST_DENOMINATOR = 8192
_ZERO = 1e-14


@dataclass(frozen=True)
class MaskRow:
    """One line of a description: which vertex, and its weights as `weight × count role`, or by valence or offset."""

    where: str
    weights: str


def entries(rows: csr_array, row: int) -> list[tuple[int, float]]:
    """The columns and weights of a row, less those that are zero but for rounding."""
    line = coo_array(rows[[row]])
    pairs = zip(line.coords[1], line.data, strict=True)
    return [(int(column), float(weight)) for column, weight in pairs if abs(weight) > _ZERO]


def grouped(rows: csr_array, row: int, roles: dict[int, str], others: str) -> str:
    """A row's weights, with how many verts of each role have them."""
    groups: dict[tuple[str, str], int] = {}
    for column, weight in entries(rows, row):
        key = (roles.get(column, others), number(weight))
        groups[key] = groups.get(key, 0) + 1
    order = [*dict.fromkeys(roles.values()), others]
    found = sorted(groups.items(), key=lambda item: order.index(item[0][0]))
    return ", ".join(f"{weight} {role}" + (f" ({count})" if count > 1 else "") for (role, weight), count in found)


def along(rows: csr_array, row: int, origin: int) -> str:
    """A row's weights along a boundary or another curve, by offset from one of its verts."""
    weights = {column - origin: weight for column, weight in entries(rows, row)}
    listed = ", ".join(number(weights[offset]) for offset in sorted(weights))
    return f"{listed} " + (f"at {min(weights)} … {max(weights)} along it" if len(weights) > 1 else "itself")


def push_back_row(push_back: PushBack) -> MaskRow:
    """What a push-back by one α for all makes of the masks."""
    return MaskRow("push-back", f"alpha = {number(float(push_back.alpha))}: old E + αD, new O + αMD, D = I - E")


def number(value: float) -> str:
    """A weight as a fraction where it is one of small denominator, and to six digits where not."""
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return str(fraction) if abs(float(fraction) - value) < 1e-12 else f"{value:.6f}"


_LENGTH = 12
_AT = 5


def describe_curves(scheme: CurveScheme) -> Iterator[MaskRow]:
    """Inside a curve, and at the start of an open one; the other end is its mirror image."""
    chain = Chains(_LENGTH, np.arange(_LENGTH), np.array([_LENGTH]), np.array([False]))
    rows, inserted = assemble_curves(chain, scheme), len(scheme.mask.inserted)
    yield MaskRow("old vertex", along(rows, _AT, _AT))
    places = {"inside": _AT, "in an end segment": 0}
    for where, segment in places.items():
        for i in range(inserted):
            which = "new vertex" if inserted == 1 else f"new vertex {i + 1} of {inserted}"
            yield MaskRow(f"{which}, {where}", along(rows, _LENGTH + inserted * segment + i, segment))
    yield MaskRow("end of an open curve", along(rows, 0, 0))
    if scheme.push_back is not None:
        yield push_back_row(scheme.push_back)


_SIDE = 12
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
    if isinstance(mask, TensorProductMask) and mask.diagonal is not None:
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


def describe(scheme: Scheme) -> Iterator[MaskRow]:
    """The masks of a scheme, wherever they differ."""
    if isinstance(scheme, CurveScheme):
        return describe_curves(scheme)
    return describe_on_polygons(scheme) if isinstance(scheme, PolygonScheme) else _on_triangles(scheme)


def _on_triangles(scheme: TriangleScheme) -> Iterator[MaskRow]:
    """On a regular mesh, at extraordinary vertices, and along the boundary."""
    lattice = _torus()
    division = divide(lattice, scheme.split, step=0)
    rows = assemble(lattice, scheme, division)
    origin = _AT * _SIDE + _AT
    yield MaskRow("old vertex, valence 6", grouped(rows, origin, {origin: "itself"}, "each neighbour"))
    if scheme.split is Split.QUADRISECT:
        inserted = lattice.num_verts + int(np.flatnonzero((lattice.edges == (origin, origin + 1)).all(axis=1))[0])
        roles = _edge_roles(origin)
        yield MaskRow("new vertex in an edge, regular", grouped(rows, inserted, roles, "other"))
    else:
        face = int(np.flatnonzero((lattice.faces == (origin, origin + 1, origin + _SIDE)).all(axis=1))[0])
        roles = _face_roles(origin)
        yield MaskRow("new vertex in a face, regular", grouped(rows, lattice.num_verts + face, roles, "other"))
    yield from _extraordinary_describe(scheme)
    yield from _boundary_describe(scheme)
    if scheme.push_back is not None:
        yield push_back_row(scheme.push_back)


def _extraordinary_describe(scheme: TriangleScheme) -> Iterator[MaskRow]:
    if scheme.vert is not None:
        ring = ", ".join(f"n = {n}: {number(scheme.vert.ring(n))}" for n in _VALENCES)
        base = "base: " if scheme.push_back is not None else ""
        yield MaskRow("old vertex, valence n", f"{base}1 - w itself, w / n each neighbour; w at {ring}")
    if scheme.spokes is not None:
        for n in _VALENCES[:3]:
            centre, *spokes = (number(weight) for weight in scheme.spokes.weights(n))
            yield MaskRow(f"new vertex beside valence {n}", f"{centre} centre; spokes {', '.join(spokes)}")


def _boundary_describe(scheme: TriangleScheme) -> Iterator[MaskRow]:
    """Read off in the second step, the one in which √3 schemes refine the boundary."""
    patch = _patch()
    division = divide(patch, scheme.split, step=1)
    rows = assemble(patch, scheme, division)
    edge = int(np.flatnonzero((patch.tail[division.border] == _AT) & (patch.head[division.border] == _AT + 1))[0])
    places = {"old vertex": _AT, "new vertex": patch.num_verts + int(division.border_place[0][edge])}
    for what, row in places.items():
        yield MaskRow(f"boundary, {what}", along(rows, row, _AT))


def _patch() -> Topology:
    """A regular lattice with a boundary, of which verts 0 to side - 1 are one edge."""
    here = (np.arange(_SIDE - 1)[:, None] * _SIDE + np.arange(_SIDE - 1)).reshape(-1)
    right, up, corner = here + 1, here + _SIDE, here + _SIDE + 1
    return Topology(_SIDE**2, np.concatenate([np.stack([here, right, up], 1), np.stack([right, corner, up], 1)]))


def _torus() -> Topology:
    """A regular lattice, closed up: vertex (i, j) is i + j·side, its neighbours (±1, 0), (0, ±1), (1, -1), (-1, 1)."""
    j, i = np.divmod(np.arange(_SIDE * _SIDE), _SIDE)
    right, up = (i + 1) % _SIDE + j * _SIDE, i + (j + 1) % _SIDE * _SIDE
    corner = (i + 1) % _SIDE + (j + 1) % _SIDE * _SIDE
    here = i + j * _SIDE
    return Topology(_SIDE**2, np.concatenate([np.stack([here, right, up], 1), np.stack([right, corner, up], 1)]))


def _at(origin: int, *offsets: tuple[int, int]) -> list[int]:
    return [origin + i + j * _SIDE for i, j in offsets]


def _edge_roles(origin: int) -> dict[int, str]:
    named = {
        "each end": _at(origin, (0, 0), (1, 0)),
        "each opposite": _at(origin, (0, 1), (1, -1)),
        "each wing": _at(origin, (-1, 1), (1, 1), (0, -1), (2, -1)),
        "each in line": _at(origin, (-1, 0), (2, 0)),
    }
    return {vert: role for role, verts in named.items() for vert in verts}


def _face_roles(origin: int) -> dict[int, str]:
    named = {
        "each corner": _at(origin, (0, 0), (1, 0), (0, 1)),
        "each across an edge": _at(origin, (1, -1), (1, 1), (-1, 1)),
        "each wing": _at(origin, (0, -1), (2, -1), (2, 0), (0, 2), (-1, 2), (-1, 0)),
    }
    return {vert: role for role, verts in named.items() for vert in verts}
