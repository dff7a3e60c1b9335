"""Stencil meshes: the small connectivities on which a scheme is analysed, for every domain.

They are a patch of the regular lattice, wheels of regular faces around an extraordinary vertex or face, and fans around
a vertex on the boundary. The rest of this package works on them whatever the domain.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from jaxtyping import Complex128, Float64, Int64
from scipy.sparse import csr_array

from meshfit.mesh.curves import Chains
from meshfit.mesh.topology import Indices, Mask, PolygonTopology, Topology
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import LINEAR_SCHEMES as LINEAR_POLYGON_SCHEMES
from meshfit.subdivision.polygons.scheme import CornerMask, PolygonScheme
from meshfit.subdivision.refine import CurveRefinement, Refinement, refine
from meshfit.subdivision.registry import Scheme
from meshfit.subdivision.triangles.scheme import LINEAR_SCHEMES as LINEAR_TRIANGLE_SCHEMES
from meshfit.subdivision.triangles.scheme import TriangleScheme

_ZERO = 1e-14
_BORDER = 2  # edges from the border of a patch to where every rule is a regular one


@dataclass(frozen=True, eq=False)
class FinerMesh:
    """A refined stencil mesh: one operator for each step, coarsest first, and the finest connectivity."""

    operators: tuple[csr_array, ...]
    topology: PolygonTopology

    def carry(self, values: np.ndarray) -> np.ndarray:
        """Refine (V, …) values at the coarse vertices to (V', …) values at the finest ones."""
        for operator in self.operators:
            values = operator @ values
        return values

    def rows(self, verts: Indices) -> Float64[np.ndarray, "N V"]:
        """(N, V) the weights of all coarse vertices in these finest ones; tiny weights are set to 0."""
        rows = self.operators[-1][verts]
        for operator in self.operators[-2::-1]:
            rows = rows @ operator
        dense = rows.toarray()
        return np.where(np.abs(dense) > _ZERO, dense, 0.0)


Refine = Callable[[int], FinerMesh]
"""Number of steps → one stencil mesh, refined so many times."""
Locate = Callable[[int], Complex128[np.ndarray, " W"]]
"""Number of steps → (V',) positions of the finest vertices by linear interpolation on the same split.

They tell the spokes of the fine mesh apart, whatever the scheme does to positions.
"""


@dataclass(frozen=True, eq=False)
class Patch:
    """A piece of the regular lattice, D-dimensional, with a border.

    Attributes:
        places: (V, D) integer coordinates in a basis of the lattice, with the origin in the middle.
        topology: of its faces; on a line, each segment is a face of two corners.
        inner: (V,) vertices so far from the border that every rule there is a regular one.
        refine: its refinement by the scheme.
    """

    places: Float64[np.ndarray, "V D"]
    topology: PolygonTopology
    inner: Mask
    refine: Refine

    def regular(self, finer: FinerMesh) -> Mask:
        """(V',) fine vertices that depend on inner ones alone."""
        return np.asarray(np.isfinite(finer.carry(np.where(self.inner, 0.0, np.nan))))


@dataclass(frozen=True, eq=False)
class Wheel:
    """Rings of regular faces around an extraordinary vertex, the hub, or around an extraordinary face.

    Attributes:
        places: (V,) positions in the plane, with n-fold rotational symmetry.
        topology: of its faces.
        turns: (K, n) all vertices but a hub; each row holds those that a turn by one spoke maps to each other, inner
            rings first.
        ring: (K,) the ring of each row, from 1.
        refine: its refinement by the scheme.
        locate: linear positions of fine vertices.
        hub: whether vertex 0 is the centre.
    """

    places: Complex128[np.ndarray, " V"]
    topology: PolygonTopology
    turns: Int64[np.ndarray, "K N"]
    ring: Int64[np.ndarray, " K"]
    refine: Refine
    locate: Locate
    hub: bool

    def within(self, rings: int) -> Indices:
        """Return the vertices of the first rings, the hub first."""
        around = self.turns[self.ring <= rings].reshape(-1)
        return np.concatenate([np.zeros(int(self.hub), dtype=np.int64), around])


@dataclass(frozen=True, eq=False)
class Fan:
    """Rings of regular faces around vertex 0, which is on the boundary.

    Attributes:
        topology: of its faces.
        ring: (V,) the ring of each vertex, 0 for vertex 0, in rising order.
        refine: its refinement by the scheme.
        locate: positions of fine vertices that tell vertex 0 from the others.
    """

    topology: PolygonTopology
    ring: Indices
    refine: Refine
    locate: Locate


@dataclass(frozen=True)
class StencilMeshes:
    """The stencil meshes of one scheme.

    Attributes:
        domain: as in the registry of schemes.
        dimension: of the lattice, 2 or 1.
        irregular: the element that may be extraordinary: `vertex`, or `face` for dual schemes; empty on curves.
        regular: the valence of a regular element.
        patch: number of edges from the origin to the border → a patch.
        wheel: valence and number of rings → a wheel; None on curves.
        fan: number of neighbours of the boundary vertex, and of rings → a fan; None on curves and for dual schemes.
        distance: (K, D) coordinates in the lattice → (K,) distance from the origin in rings.
        axes: (D, D) the basis of the lattice as it is drawn, with edges of length 1.
    """

    domain: str
    dimension: int
    irregular: str
    regular: int
    patch: Callable[[int], Patch]
    wheel: Callable[[int, int], Wheel] | None
    fan: Callable[[int, int], Fan] | None
    distance: Callable[[np.ndarray], np.ndarray]
    axes: tuple[tuple[float, ...], ...]


def stencil_meshes(scheme: Scheme) -> StencilMeshes:
    """Return the stencil meshes of a scheme."""
    if isinstance(scheme, CurveScheme):
        return _of_curves(scheme)
    return _of_polygons(scheme) if isinstance(scheme, PolygonScheme) else _of_triangles(scheme)


def _of_curves(scheme: CurveScheme) -> StencilMeshes:
    return StencilMeshes(
        domain="curves",
        dimension=1,
        irregular="",
        regular=2,
        patch=lambda reach: _curve_patch(scheme, reach),
        wheel=None,
        fan=None,
        distance=lambda places: np.abs(places[:, 0]),
        axes=((1.0,),),
    )


def _of_triangles(scheme: TriangleScheme) -> StencilMeshes:
    return StencilMeshes(
        domain="triangles",
        dimension=2,
        irregular="vertex",
        regular=6,
        patch=lambda reach: _triangle_patch(scheme, reach),
        wheel=lambda valence, rings: _triangle_wheel(scheme, valence, rings),
        fan=lambda neighbours, rings: _triangle_fan(scheme, neighbours, rings),
        distance=_hexagonal_distance,
        axes=((1.0, 0.0), (1 / 2, sqrt(3) / 2)),
    )


def _of_polygons(scheme: PolygonScheme) -> StencilMeshes:
    dual = isinstance(scheme.inserted, CornerMask)
    wheel = _dual_wheel if dual else _quad_wheel
    return StencilMeshes(
        domain="polygons",
        dimension=2,
        irregular="face" if dual else "vertex",
        regular=4,
        patch=lambda reach: _quad_patch(scheme, reach),
        wheel=lambda valence, rings: wheel(scheme, valence, rings),
        fan=None if dual else lambda neighbours, rings: _quad_fan(scheme, neighbours, rings),
        distance=lambda places: np.abs(places).max(axis=1),
        axes=((1.0, 0.0), (0.0, 1.0)),
    )


def _refine(scheme: Scheme, topology: Topology | PolygonTopology | Chains) -> Refine:
    def refined(steps: int) -> FinerMesh:
        refinement = refine(topology, scheme, steps)
        if isinstance(refinement, Refinement):
            finest = PolygonTopology.of(Topology(refinement.num_fine, refinement.faces))
        elif isinstance(refinement, CurveRefinement):
            finest = _segments(refinement.chains)
        else:
            finest = refinement.finest
        return FinerMesh(refinement.operators, finest)

    return refined


def _locate(scheme: Scheme, topology: Topology | PolygonTopology, places: Complex128[np.ndarray, " V"]) -> Locate:
    linear: Scheme
    if isinstance(scheme, TriangleScheme):
        linear = LINEAR_TRIANGLE_SCHEMES[scheme.split]
    elif isinstance(scheme, PolygonScheme) and isinstance(scheme.inserted, CornerMask):
        linear = replace(scheme, inserted=replace(scheme.inserted, weights=_half_way))
    else:
        assert isinstance(scheme, PolygonScheme)  # noqa: S101  nothing is located on curves
        linear = LINEAR_POLYGON_SCHEMES[scheme.split]
    return lambda steps: np.asarray(refine(topology, linear, steps)(places))


def _half_way(size: int) -> tuple[float, ...]:
    """Corner weights that put the new vertex half way from the corner to the middle of the face."""
    return (1 / 2 + 1 / (2 * size), *[1 / (2 * size)] * (size - 1))


def _curve_patch(scheme: CurveScheme, reach: int) -> Patch:
    count = 2 * reach + 1
    chains = Chains(count, np.arange(count), np.array([count]), np.array([False]))
    places = np.arange(count)[:, None] - float(reach)
    return Patch(places, _segments(chains), np.abs(places[:, 0]) <= reach - _BORDER, _refine(scheme, chains))


def _segments(chains: Chains) -> PolygonTopology:
    """Take each segment as a face of two corners."""
    ends = np.stack([chains.tail, chains.head], axis=1)
    return PolygonTopology(chains.num_verts, ends.reshape(-1), np.full(len(ends), 2))


def _lattice(reach: int) -> tuple[Float64[np.ndarray, "V 2"], Mask, Int64[np.ndarray, "4 F"]]:
    """Return the coordinates of a square lattice, its inner vertices, and the corners of its cells."""
    side = 2 * reach + 1
    rows, columns = np.divmod(np.arange(side**2), side)
    cell = np.flatnonzero((rows < side - 1) & (columns < side - 1))
    places = np.stack([columns, rows], axis=1) - float(reach)
    inner = np.asarray((np.abs(places) <= reach - _BORDER).all(axis=1))
    return places, inner, np.stack([cell, cell + 1, cell + side + 1, cell + side])


def _hexagonal_distance(places: np.ndarray) -> np.ndarray:
    i, j = places.T
    return np.asarray(np.maximum(np.maximum(np.abs(i), np.abs(j)), np.abs(i + j)))


def _triangle_patch(scheme: TriangleScheme, reach: int) -> Patch:
    """Vertex (i, j) has the neighbours (±1, 0), (0, ±1), (1, -1) and (-1, 1)."""
    places, inner, (corner, right, opposite, up) = _lattice(reach)
    faces = np.concatenate([np.stack([corner, right, up], 1), np.stack([right, opposite, up], 1)])
    topology = Topology(len(places), faces)
    return Patch(places, PolygonTopology.of(topology), inner, _refine(scheme, topology))


def _triangle_wheel(scheme: TriangleScheme, valence: int, rings: int) -> Wheel:
    """Number the vertices of a ring counter-clockwise from the first spoke."""
    spoke = np.arange(valence)
    parts = [(ring, part) for ring in range(1, rings + 1) for part in range(ring)]
    turns = np.array([_first_of_ring(valence, ring) + ring * spoke + part for ring, part in parts])
    topology = Topology(1 + turns.size, _triangle_faces(valence, rings, closed=True))
    turn = np.exp(2j * np.pi / valence)
    places = np.zeros(1 + turns.size, dtype=np.complex128)
    places[turns] = np.array([(ring - part) + part * turn for ring, part in parts])[:, None] * turn**spoke
    ring = np.array([ring for ring, _ in parts])
    return _wheel(scheme, topology, places, turns, ring, hub=True)


def _triangle_fan(scheme: TriangleScheme, neighbours: int, rings: int) -> Fan:
    sectors = neighbours - 1
    ring = np.repeat(np.arange(rings + 1), [1, *(sectors * r + 1 for r in range(1, rings + 1))])
    return _fan(scheme, Topology(len(ring), _triangle_faces(sectors, rings, closed=False)), ring)


def _first_of_ring(sectors: int, ring: int, *, closed: bool = True) -> int:
    return 1 + sectors * ring * (ring - 1) // 2 + (0 if closed else ring - 1)


def _triangle_faces(sectors: int, rings: int, *, closed: bool) -> Int64[np.ndarray, "F 3"]:
    """Between ring r - 1 and ring r, r faces in each sector point inwards and r - 1 outwards."""
    spoke = np.arange(sectors)

    def at(ring: int, part: int) -> np.ndarray:
        place = ring * spoke + part
        return _first_of_ring(sectors, ring, closed=closed) + (place % (ring * sectors) if closed else place)

    faces = []
    for ring in range(1, rings + 1):
        for part in range(ring):
            inner = at(ring - 1, part) if ring > 1 else 0 * spoke
            faces.append((inner, at(ring, part), at(ring, part + 1)))
            if part < ring - 1:
                faces.append((inner, at(ring, part + 1), at(ring - 1, part + 1)))
    return np.concatenate([np.stack(face, axis=1) for face in faces])


Cells = dict[tuple[int, int], Int64[np.ndarray, " n"]]
"""Vertices by their two coordinates between one spoke and the next, one for each spoke."""


def _quad_patch(scheme: PolygonScheme, reach: int) -> Patch:
    places, inner, cells = _lattice(reach)
    topology = _of_quads(len(places), cells.T)
    return Patch(places, topology, inner, _refine(scheme, topology))


def _of_quads(num_verts: int, quads: Int64[np.ndarray, "F 4"]) -> PolygonTopology:
    return PolygonTopology(num_verts, quads.reshape(-1), np.full(len(quads), 4))


def _quad_wheel(scheme: PolygonScheme, valence: int, rings: int) -> Wheel:
    """Between two spokes lies a quadrant: vertex (i, j), i > 0, is i edges along the first and j along the second."""
    cells, turns, ring = _numbered(valence, 1, ((i, j) for i in range(1, rings + 1) for j in range(rings + 1)), max)
    hub = np.zeros(valence, dtype=np.int64)

    def at(i: int, j: int) -> Int64[np.ndarray, " n"]:
        if i:
            return cells[i, j]
        return np.roll(cells[j, 0], -1) if j else hub

    quads = [
        np.stack([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], axis=1)
        for i in range(rings)
        for j in range(rings)
    ]
    topology = _of_quads(1 + turns.size, np.concatenate(quads))
    return _wheel(scheme, topology, _quad_places(cells, valence, 0.0, 1 + turns.size), turns, ring, hub=True)


def _dual_wheel(scheme: PolygonScheme, valence: int, rings: int) -> Wheel:
    """Around a face of n corners; vertex (i, j), i and j from 0, is the middle of a quad of the other kind of wheel."""
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
    return _wheel(scheme, topology, _quad_places(cells, valence, 0.5, turns.size), turns, ring, hub=False)


def _quad_fan(scheme: PolygonScheme, neighbours: int, rings: int) -> Fan:
    """Quadrants as in a wheel, between as many spokes as vertex 0 has neighbours."""
    last = neighbours - 1
    inner = [(s, i, j) for s in range(last) for i in range(1, rings + 1) for j in range(rings + 1)]
    order = sorted([*inner, *((last, i, 0) for i in range(1, rings + 1))], key=lambda place: (max(place[1:]), place))
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
    ring = np.array([0, *(max(place[1:]) for place in order)])
    return _fan(scheme, _of_quads(1 + len(order), np.array(quads)), ring)


def _numbered(
    valence: int, first: int, spans: Iterator[tuple[int, int]], ring_of: Callable[[int, int], int]
) -> tuple[Cells, Int64[np.ndarray, "K N"], Int64[np.ndarray, " K"]]:
    """Number the vertices at these coordinates between all spokes, ring by ring; return also the rows and rings."""
    order = sorted(spans, key=lambda place: (ring_of(*place), place))
    turns = first + np.arange(len(order) * valence).reshape(-1, valence)
    return dict(zip(order, turns, strict=True)), turns, np.array([ring_of(*place) for place in order])


def _quad_places(cells: Cells, valence: int, shift: float, count: int) -> Complex128[np.ndarray, " V"]:
    places = np.zeros(count, dtype=np.complex128)
    spokes = np.exp(2j * np.pi * np.arange(valence + 1) / valence)
    for (i, j), verts in cells.items():
        places[verts] = (i + shift) * spokes[:-1] + (j + shift) * spokes[1:]
    return places


def _wheel(
    scheme: TriangleScheme | PolygonScheme,
    topology: Topology | PolygonTopology,
    places: Complex128[np.ndarray, " V"],
    turns: Int64[np.ndarray, "K N"],
    ring: Int64[np.ndarray, " K"],
    *,
    hub: bool,
) -> Wheel:
    refined, located = _refine(scheme, topology), _locate(scheme, topology, places)
    return Wheel(places, _polygons(topology), turns, ring, refined, located, hub=hub)


def _fan(scheme: TriangleScheme | PolygonScheme, topology: Topology | PolygonTopology, ring: Indices) -> Fan:
    # Linear interpolation keeps the boundary in place, so any positions tell vertex 0 from the others.
    located = _locate(scheme, topology, ring.astype(np.complex128))
    return Fan(_polygons(topology), ring, _refine(scheme, topology), located)


def _polygons(topology: Topology | PolygonTopology) -> PolygonTopology:
    return PolygonTopology.of(topology) if isinstance(topology, Topology) else topology
