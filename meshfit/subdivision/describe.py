"""A scheme's masks as people write them, read off the operator that they were laid down as."""

from collections.abc import Iterator

import numpy as np

from meshfit.mesh.topology import Topology
from meshfit.subdivision.assemble import assemble
from meshfit.subdivision.curve_scheme import CurveScheme
from meshfit.subdivision.describe_curves import describe_curves
from meshfit.subdivision.mask_rows import MaskRow, along, grouped, number, push_back_row
from meshfit.subdivision.polygon_describe import describe_on_polygons
from meshfit.subdivision.polygon_scheme import PolygonScheme
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.splits import divide
from meshfit.subdivision.triangle_scheme import Split, TriangleScheme

_SIDE = 12
_AT = 5
_VALENCES = (3, 4, 5, 7, 8)


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
    yield from _extraordinary(scheme)
    yield from _boundary(scheme)
    if scheme.push_back is not None:
        yield push_back_row(scheme.push_back)


def _extraordinary(scheme: TriangleScheme) -> Iterator[MaskRow]:
    if scheme.vert is not None:
        ring = ", ".join(f"n = {n}: {number(scheme.vert.ring(n))}" for n in _VALENCES)
        base = "base: " if scheme.push_back is not None else ""
        yield MaskRow("old vertex, valence n", f"{base}1 - w itself, w / n each neighbour; w at {ring}")
    if scheme.spokes is not None:
        for n in _VALENCES[:3]:
            centre, *spokes = (number(weight) for weight in scheme.spokes.weights(n))
            yield MaskRow(f"new vertex beside valence {n}", f"{centre} centre; spokes {', '.join(spokes)}")


def _boundary(scheme: TriangleScheme) -> Iterator[MaskRow]:
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
