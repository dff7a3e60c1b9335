"""The meshes of schemes on polygons: quads, and wheels about a vertex of any valence, or about a face of any size."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Complex128, Int64

from meshfit.analysis.stencil_meshes import Fan, FinerMesh, Patch, Refine, StencilMeshes, Wheel
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.polygons.scheme import LINEAR, CornerMask, PolygonScheme
from meshfit.subdivision.refine import refine

_BORDER = 2
_AXES = ((1.0, 0.0), (0.0, 1.0))

Cells = dict[tuple[int, int], Int64[np.ndarray, " n"]]
"""Verts by their two coordinates between one spoke and the next, one for each spoke."""


def polygon_meshes(scheme: PolygonScheme) -> StencilMeshes:
    """Quads, of which four meet at a vertex; with dual schemes it is faces that may be extraordinary."""
    dual = isinstance(scheme.inserted, CornerMask)
    wheel = _dual_wheel if dual else _wheel
    return StencilMeshes(
        "polygons",
        2,
        "face" if dual else "vertex",
        4,
        lambda reach: _patch(scheme, reach),
        lambda valence, rings: wheel(scheme, valence, rings),
        None if dual else lambda neighbours, rings: _fan(scheme, neighbours, rings),
        lambda places: np.abs(places).max(axis=1),
        _AXES,
    )


def _refine(scheme: PolygonScheme, topology: PolygonTopology) -> Refine:
    def refined(steps: int) -> FinerMesh:
        found = refine(topology, scheme, steps)
        return FinerMesh(found.operators, found.finest)

    return refined


def _patch(scheme: PolygonScheme, reach: int) -> Patch:
    side = 2 * reach + 1
    rows, columns = np.divmod(np.arange(side**2), side)
    here = np.flatnonzero((rows < side - 1) & (columns < side - 1))
    topology = _of_quads(side**2, np.stack([here, here + 1, here + side + 1, here + side], axis=1))
    places = np.stack([columns, rows], axis=1) - float(reach)
    inner = np.asarray((np.abs(places) <= reach - _BORDER).all(axis=1))
    return Patch(places, topology, inner, _refine(scheme, topology))


def _of_quads(num_verts: int, quads: Int64[np.ndarray, "F 4"]) -> PolygonTopology:
    return PolygonTopology(num_verts, quads.reshape(-1), np.full(len(quads), 4))


def _wheel(scheme: PolygonScheme, valence: int, rings: int) -> Wheel:
    """Between two spokes lies a quadrant: vertex (i, j), i > 0, is i edges along the first and j along the second."""
    cells, turns, ring = _numbered(valence, 1, ((i, j) for i in range(1, rings + 1) for j in range(rings + 1)), max)
    hub = np.zeros(valence, dtype=np.int64)

    def at(i: int, j: int) -> Int64[np.ndarray, " n"]:
        if i:
            return cells[i, j]
        return np.roll(cells[j, 0], -1) if j else hub

    quads = np.concatenate(
        [
            np.stack([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], axis=1)
            for i in range(rings)
            for j in range(rings)
        ]
    )
    topology = _of_quads(1 + turns.size, quads)
    return _laid(scheme, topology, _places(cells, valence, 0.0, 1 + turns.size), turns, ring, hub=True)


def _dual_wheel(scheme: PolygonScheme, valence: int, rings: int) -> Wheel:
    """About a face of n corners; vertex (i, j), i and j from 0, is the middle of a quad of the other kind of wheel."""
    spans = ((i, j) for i in range(rings) for j in range(rings))
    cells, turns, ring = _numbered(valence, 0, spans, lambda i, j: max(i, j) + 1)
    quads = [
        np.stack([cells[i - 1, j - 1], cells[i, j - 1], cells[i, j], cells[i - 1, j]], axis=1)
        for i in range(1, rings)
        for j in range(1, rings)
    ]
    before = {place: np.roll(verts, 1) for place, verts in cells.items()}
    quads += [np.stack([cells[i, 0], cells[i - 1, 0], before[0, i - 1], before[0, i]], axis=1) for i in range(1, rings)]
    sizes = np.full(1 + valence * len(quads), 4)
    sizes[0] = valence
    corners = np.concatenate([cells[0, 0], *(rows.reshape(-1) for rows in quads)])
    topology = PolygonTopology(turns.size, corners, sizes)
    return _laid(scheme, topology, _places(cells, valence, 0.5, turns.size), turns, ring, hub=False)


def _fan(scheme: PolygonScheme, neighbours: int, rings: int) -> Fan:
    """Quadrants as of a wheel, between as many spokes as vertex 0 has neighbours."""
    last = neighbours - 1
    inner = [(s, i, j) for s in range(last) for i in range(1, rings + 1) for j in range(rings + 1)]
    order = sorted([*inner, *((last, i, 0) for i in range(1, rings + 1))], key=lambda at: (max(at[1:]), at))
    number = {place: 1 + index for index, place in enumerate(order)}

    def at(s: int, i: int, j: int) -> int:
        if i:
            return number[s, i, j]
        return number[s + 1, j, 0] if j else 0

    quads = [
        (at(s, i, j), at(s, i + 1, j), at(s, i + 1, j + 1), at(s, i, j + 1))
        for s in range(last)
        for i in range(rings)
        for j in range(rings)
    ]
    topology = _of_quads(1 + len(order), np.array(quads))
    ring = np.array([0, *(max(place[1:]) for place in order)])
    # Linear interpolation keeps the boundary in its place, so that any places tell vertex 0 from the others.
    return Fan(topology, ring, _refine(scheme, topology), _locate(scheme, topology, ring.astype(np.complex128)))


def _numbered(
    valence: int, first: int, spans: Iterator[tuple[int, int]], ring_of: Callable[[int, int], int]
) -> tuple[Cells, Int64[np.ndarray, "K N"], Int64[np.ndarray, " K"]]:
    """Numbers for the verts at these coordinates between all spokes, ring by ring; the rows and their rings."""
    order = sorted(spans, key=lambda place: (ring_of(*place), place))
    turns = first + np.arange(len(order) * valence).reshape(-1, valence)
    return dict(zip(order, turns, strict=True)), turns, np.array([ring_of(*place) for place in order])


def _places(cells: Cells, valence: int, shift: float, count: int) -> Complex128[np.ndarray, " V"]:
    places = np.zeros(count, dtype=np.complex128)
    spokes = np.exp(2j * np.pi * np.arange(valence + 1) / valence)
    for (i, j), verts in cells.items():
        places[verts] = (i + shift) * spokes[:-1] + (j + shift) * spokes[1:]
    return places


def _laid(
    scheme: PolygonScheme,
    topology: PolygonTopology,
    places: Complex128[np.ndarray, " V"],
    turns: Int64[np.ndarray, "K N"],
    ring: Int64[np.ndarray, " K"],
    *,
    hub: bool,
) -> Wheel:
    return Wheel(places, topology, turns, ring, _refine(scheme, topology), _locate(scheme, topology, places), hub=hub)


def _locate(
    scheme: PolygonScheme, topology: PolygonTopology, places: Complex128[np.ndarray, " V"]
) -> Callable[[int], Complex128[np.ndarray, " W"]]:
    linear = _linear(scheme)
    return lambda steps: np.asarray(refine(topology, linear, steps)(places))


def _linear(scheme: PolygonScheme) -> PolygonScheme:
    """Linear interpolation on the split; of corners, half way to the middle of the face."""
    if isinstance(scheme.inserted, CornerMask):
        halved = replace(scheme.inserted, weights=_half_way)
        return replace(scheme, inserted=halved)
    return LINEAR[scheme.split]


def _half_way(size: int) -> tuple[float, ...]:
    return (1 / 2 + 1 / (2 * size), *[1 / (2 * size)] * (size - 1))
