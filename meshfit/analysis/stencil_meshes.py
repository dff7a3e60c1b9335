"""Benches: the two connectivities that schemes are studied on, a regular patch and a wheel about one odd place.

Everything else in this package works on these, and never asks whether it is about triangles, polygons or curves.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Int64
from scipy.sparse import csr_array

from meshfit.mesh.topology import Indices, Mask, PolygonTopology

_ZERO = 1e-14


@dataclass(frozen=True, eq=False)
class FinerMesh:
    """What some steps make of a connectivity: an operator for each, coarsest first, and the finest connectivity."""

    operators: tuple[csr_array, ...]
    topology: PolygonTopology

    def carry(self, values: np.ndarray) -> np.ndarray:
        """(V', …) values at the finest verts, of values at the coarse ones."""
        for operator in self.operators:
            values = operator @ values
        return values

    def rows(self, verts: Indices) -> Float64[np.ndarray, "N V"]:
        """(N, V) what these finest verts take of all coarse ones; what is rounding, or next to nothing, is 0."""
        rows = self.operators[-1][verts]
        for operator in self.operators[-2::-1]:
            rows = rows @ operator
        dense = rows.toarray()
        return np.where(np.abs(dense) > _ZERO, dense, 0.0)


Refine = Callable[[int], FinerMesh]
"""Number of steps → what they make of one connectivity."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A piece of the regular lattice, D-dimensional, with a border.

    Attributes:
        places: (V, D) integer coordinates in a basis of the lattice, the origin amid the patch; multiples of 1/2 where
            new verts do not lie on old ones.
        topology: of its faces; on a line each segment is a face of two corners.
        inner: (V,) which verts are so far from the border that all rules there are the regular ones.
        refine: its refinement by the scheme.
    """

    places: Float64[np.ndarray, "V D"]
    topology: PolygonTopology
    inner: Mask
    refine: Refine

    def regular(self, finer: FinerMesh) -> Mask:
        """(V',) which fine verts follow from inner ones alone."""
        return np.asarray(np.isfinite(finer.carry(np.where(self.inner, 0.0, np.nan))))


@dataclass(frozen=True, eq=False)
class Wheel:
    """Rings of regular faces about one odd place: a vertex, the hub, or a face without one.

    Attributes:
        places: (V,) positions in the plane, which a turn by one spoke takes to each other.
        topology: of its faces.
        turns: (K, n) all verts but a hub, each row those that turns by one spoke take to each other, inner rings first.
        ring: (K,) the ring that each row lies in, from 1.
        refine: its refinement by the scheme.
        locate: number of steps → (V',) where linear interpolation on the same split puts the fine verts, which tells
            the spokes of the fine wheel apart whatever the scheme does to positions.
        hub: whether vertex 0 is the centre.
    """

    places: Complex128[np.ndarray, " V"]
    topology: PolygonTopology
    turns: Int64[np.ndarray, "K N"]
    ring: Int64[np.ndarray, " K"]
    refine: Refine
    locate: Callable[[int], Complex128[np.ndarray, " W"]]
    hub: bool

    def within(self, rings: int) -> Indices:
        """The verts of the first rings, the hub first."""
        around = self.turns[self.ring <= rings].reshape(-1)
        return np.concatenate([np.zeros(int(self.hub), dtype=np.int64), around])


@dataclass(frozen=True, eq=False)
class Fan:
    """Rings of regular faces about vertex 0, which is on the boundary.

    Attributes:
        topology: of its faces.
        ring: (V,) the ring that each vertex lies in, 0 for vertex 0, in rising order.
        refine: its refinement by the scheme.
        locate: as of a wheel.
    """

    topology: PolygonTopology
    ring: Indices
    refine: Refine
    locate: Callable[[int], Complex128[np.ndarray, " W"]]


@dataclass(frozen=True)
class StencilMeshes:
    """What a scheme of one domain is studied on, laid down by that scheme.

    Attributes:
        name: of the domain, as in the table of schemes.
        dimension: of the lattice, 2 or 1.
        odd: what may be extraordinary: `vertex`, or `face` for dual schemes; empty on curves, where nothing is.
        regular: the valence of what is not extraordinary.
        patch: number of edges from the origin to the border → a patch.
        wheel: valence and number of rings → a wheel; None on curves.
        fan: number of neighbours of a boundary vertex and of rings → a fan; None where there is no boundary surface.
        distance: coordinates in the lattice → (K,) how many rings they lie away from the origin.
        axes: (D, D) where the basis of the lattice lies when it is drawn, edges of length 1.
    """

    name: str
    dimension: int
    odd: str
    regular: int
    patch: Callable[[int], Patch]
    wheel: Callable[[int, int], Wheel] | None
    fan: Callable[[int, int], Fan] | None
    distance: Callable[[np.ndarray], np.ndarray]
    axes: tuple[tuple[float, ...], ...]
