"""Benches: the two connectivities that schemes are studied on, a regular patch and a wheel about one odd place.

Everything else in this package works on these, and never asks whether it is about triangles, polygons or curves.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex128, Float64, Int64
from scipy.sparse import csr_array

from meshfit.mesh.topology import NONE, Indices, Mask


@dataclass(frozen=True, eq=False)
class HalfEdges:
    """Faces of any size as their half-edges.

    Attributes:
        tail: (H,) vertex at which each starts.
        following: (H,) the one that follows in the same face.
    """

    tail: Indices
    following: Indices

    @classmethod
    def of_faces(cls, faces: Int64[np.ndarray, "F K"]) -> "HalfEdges":
        """Those of faces that all have K corners."""
        places = np.arange(faces.size).reshape(faces.shape)
        return cls(faces.reshape(-1), np.roll(places, -1, axis=1).reshape(-1))

    @cached_property
    def head(self) -> Indices:
        """(H,) vertex at which each ends."""
        return np.asarray(self.tail[self.following])

    def triangles(self) -> Int64[np.ndarray, "T 3"]:
        """(T, 3) verts of the faces cut into triangles, each into fans from one of its corners."""
        first = np.arange(len(self.tail))
        ahead = self.following.copy()
        while (going := ahead != np.arange(len(ahead))).any():
            first[going] = np.minimum(first[going], ahead[going])
            ahead[going] = self.following[ahead[going]]
        ends = (first != np.arange(len(first))) & (self.following != first)
        return np.asarray(np.stack([self.tail[first], self.tail, self.head], axis=1)[ends])

    @cached_property
    def twin(self) -> Indices:
        """(H,) the one on the other side of the edge; `NONE` on the boundary."""
        span = int(self.tail.max(initial=0)) + 1
        there, back = self.tail * span + self.head, self.head * span + self.tail
        order = np.argsort(there)
        place = np.searchsorted(there, back, sorter=order).clip(max=len(there) - 1)
        found = order[place]
        return np.where(there[found] == back, found, NONE)


@dataclass(frozen=True, eq=False)
class Finer:
    """What some steps make of a connectivity: an operator for each, coarsest first, and the finest half-edges."""

    operators: tuple[csr_array, ...]
    halfedges: HalfEdges

    def carry(self, values: np.ndarray) -> np.ndarray:
        """(V', …) values at the finest verts, of values at the coarse ones."""
        for operator in self.operators:
            values = operator @ values
        return values

    def rows(self, verts: Indices) -> Float64[np.ndarray, "N V"]:
        """(N, V) what these finest verts take of all coarse ones."""
        rows = self.operators[-1][verts]
        for operator in self.operators[-2::-1]:
            rows = rows @ operator
        return np.asarray(rows.toarray())


Refine = Callable[[int], Finer]
"""Number of steps → what they make of one connectivity."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A piece of the regular lattice, D-dimensional, with a border.

    Attributes:
        places: (V, D) integer coordinates in a basis of the lattice, the origin amid the patch; multiples of 1/2 where
            new verts do not lie on old ones.
        halfedges: of its faces; of its edges, on a line.
        inner: (V,) which verts are so far from the border that all rules there are the regular ones.
        refine: its refinement by the scheme.
    """

    places: Float64[np.ndarray, "V D"]
    halfedges: HalfEdges
    inner: Mask
    refine: Refine

    def regular(self, finer: Finer) -> Mask:
        """(V',) which fine verts follow from inner ones alone."""
        return np.asarray(np.isfinite(finer.carry(np.where(self.inner, 0.0, np.nan))))


@dataclass(frozen=True, eq=False)
class Wheel:
    """Rings of regular faces about one odd place: a vertex, the hub, or a face without one.

    Attributes:
        places: (V,) positions in the plane, which a turn by one spoke takes to each other.
        halfedges: of its faces.
        turns: (K, n) all verts but a hub, each row those that turns by one spoke take to each other, inner rings first.
        ring: (K,) the ring that each row lies in, from 1.
        refine: its refinement by the scheme.
        locate: number of steps → (V',) where linear interpolation on the same split puts the fine verts, which tells
            the spokes of the fine wheel apart whatever the scheme does to positions.
        hub: whether vertex 0 is the centre.
    """

    places: Complex128[np.ndarray, " V"]
    halfedges: HalfEdges
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
        halfedges: of its faces.
        ring: (V,) the ring that each vertex lies in, 0 for vertex 0, in rising order.
        refine: its refinement by the scheme.
        locate: as of a wheel.
    """

    halfedges: HalfEdges
    ring: Indices
    refine: Refine
    locate: Callable[[int], Complex128[np.ndarray, " W"]]


@dataclass(frozen=True)
class Bench:
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
