"""The meshes of schemes on triangles: lattice and wheels."""

from collections.abc import Callable
from fractions import Fraction
from math import sqrt

import numpy as np
from jaxtyping import Complex128, Int64

from meshfit.analysis.stencil_meshes import Fan, FinerMesh, Patch, Refine, StencilMeshes, Wheel
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.masks import CurveMask, EdgeMask, FaceMask
from meshfit.subdivision.refine import refine
from meshfit.subdivision.triangles.scheme import Split, TriangleScheme

_BORDER = 2


def triangle_meshes(scheme: TriangleScheme) -> StencilMeshes:
    """Triangles, of which six meet at a regular vertex."""
    return StencilMeshes(
        "triangles",
        2,
        "vertex",
        6,
        lambda reach: _patch(scheme, reach),
        lambda valence, rings: _wheel(scheme, valence, rings),
        lambda neighbours, rings: _fan(scheme, neighbours, rings),
        _distance,
        ((1.0, 0.0), (1 / 2, sqrt(3) / 2)),
    )


def _distance(places: np.ndarray) -> np.ndarray:
    i, j = places.T
    return np.asarray(np.maximum(np.maximum(np.abs(i), np.abs(j)), np.abs(i + j)))


def _refine(scheme: TriangleScheme, topology: Topology) -> Refine:
    def refined(steps: int) -> FinerMesh:
        found = refine(topology, scheme, steps)
        return FinerMesh(found.operators, PolygonTopology.of(Topology(found.operators[-1].shape[0], found.faces)))

    return refined


def _patch(scheme: TriangleScheme, reach: int) -> Patch:
    """Vertex (i, j) has the neighbours (±1, 0), (0, ±1), (1, -1) and (-1, 1)."""
    side = 2 * reach + 1
    rows, columns = np.divmod(np.arange(side**2), side)
    here = np.flatnonzero((rows < side - 1) & (columns < side - 1))
    right, up, corner = here + 1, here + side, here + side + 1
    faces = np.concatenate([np.stack([here, right, up], 1), np.stack([right, corner, up], 1)])
    places = np.stack([columns, rows], axis=1) - float(reach)
    inner = np.asarray((np.abs(places) <= reach - _BORDER).all(axis=1))
    topology = Topology(side**2, faces)
    return Patch(places, PolygonTopology.of(topology), inner, _refine(scheme, topology))


def _wheel(scheme: TriangleScheme, valence: int, rings: int) -> Wheel:
    turns = _turns(valence, rings)
    ring = np.repeat(np.arange(1, rings + 1), np.arange(1, rings + 1))
    faces = _faces(valence, rings, closed=True)
    topology = Topology(1 + turns.size, faces)
    places, polygons = _places(valence, rings, turns), PolygonTopology.of(topology)
    return Wheel(places, polygons, turns, ring, _refine(scheme, topology), _locate(scheme, topology, places), hub=True)


def _fan(scheme: TriangleScheme, neighbours: int, rings: int) -> Fan:
    sectors = neighbours - 1
    faces = _faces(sectors, rings, closed=False)
    ring = np.repeat(np.arange(rings + 1), [1, *(sectors * r + 1 for r in range(1, rings + 1))])
    topology = Topology(len(ring), faces)
    # Linear interpolation keeps the boundary in its place, so that any places tell vertex 0 from the others.
    locate = _locate(scheme, topology, ring.astype(np.complex128))
    return Fan(PolygonTopology.of(topology), ring, _refine(scheme, topology), locate)


def _locate(
    scheme: TriangleScheme, topology: Topology, places: Complex128[np.ndarray, " V"]
) -> Callable[[int], Complex128[np.ndarray, " W"]]:
    linear = _linear(scheme.split)
    return lambda steps: np.asarray(refine(topology, linear, steps)(places))


def _linear(split: Split) -> TriangleScheme:
    """Linear interpolation on a split."""
    half, third, kept = Fraction(1, 2), Fraction(1, 3), {0: Fraction(1)}
    if split is Split.QUADRISECT:
        return TriangleScheme(split, EdgeMask(half), CurveMask(kept, ({0: half, 1: half},)))
    parts = ({0: 2 * third, 1: third}, {0: third, 1: 2 * third})
    return TriangleScheme(split, FaceMask(third), CurveMask(kept, parts))


def _turns(valence: int, rings: int) -> Int64[np.ndarray, "K N"]:
    """The verts of a ring are numbered on counter-clockwise from the first spoke."""
    spoke = np.arange(valence)
    rows = [_first(valence, r) + r * spoke + part for r in range(1, rings + 1) for part in range(r)]
    return np.array(rows)


def _first(sectors: int, ring: int, *, closed: bool = True) -> int:
    return 1 + sectors * ring * (ring - 1) // 2 + (0 if closed else ring - 1)


def _places(valence: int, rings: int, turns: Int64[np.ndarray, "K N"]) -> Complex128[np.ndarray, " V"]:
    """Every sector between two spokes is a piece of a lattice."""
    places = np.zeros(1 + turns.size, dtype=np.complex128)
    turn = np.exp(2j * np.pi / valence)
    parts = [(ring - part) + part * turn for ring in range(1, rings + 1) for part in range(ring)]
    places[turns] = np.array(parts)[:, None] * turn ** np.arange(valence)
    return places


def _faces(sectors: int, rings: int, *, closed: bool) -> Int64[np.ndarray, "F 3"]:
    """Between ring r - 1 and ring r, r faces in each sector point inwards and r - 1 outwards."""
    spoke = np.arange(sectors)

    def at(ring: int, part: int) -> np.ndarray:
        place = ring * spoke + part
        return _first(sectors, ring, closed=closed) + (place % (ring * sectors) if closed else place)

    corners = []
    for ring in range(1, rings + 1):
        for part in range(ring):
            inner = at(ring - 1, part) if ring > 1 else 0 * spoke
            corners.append((inner, at(ring, part), at(ring, part + 1)))
            if part < ring - 1:
                corners.append((inner, at(ring, part + 1), at(ring - 1, part + 1)))
    return np.concatenate([np.stack(face, axis=1) for face in corners])
