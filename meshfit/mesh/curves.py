"""Curves: verts, and chains of them, open or closed; and the chains alone, as the topology of a mesh is its faces."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Int64
from numpy.typing import ArrayLike, DTypeLike

from meshfit.errors import MeshError
from meshfit.mesh.mesh import Verts
from meshfit.mesh.topology import NONE, Indices, Mask


@dataclass(frozen=True, eq=False, init=False)
class Curves:
    """Polylines. All arrays are copies, and read-only.

    Attributes:
        verts: (V, 3) float64, positions.
        corners: (C,) int64, vertex indices of the chains, one chain after another; no vertex stands twice.
        sizes: (N,) int64, how many of these belong to each chain.
        closed: (N,) bool, whether a last segment leads from the end of each chain back to its start.

    Raises:
        MeshError: an array that has no such shape, or sizes that do not add up.
    """

    verts: Verts
    corners: Indices
    sizes: Indices
    closed: Mask

    def __init__(self, verts: ArrayLike, corners: ArrayLike, sizes: ArrayLike, closed: ArrayLike) -> None:
        points = _frozen(verts, np.float64)
        points = points.reshape(0, 3) if points.size == 0 else points
        if points.ndim != 2 or points.shape[1] != 3:
            raise MeshError(f"verts has shape {points.shape}; rows of three are needed")
        rows = {"corners": _frozen(corners, np.int64), "sizes": _frozen(sizes, np.int64)}
        rows["closed"] = _frozen(closed, np.bool_)
        for name, array in rows.items():
            if array.ndim != 1:
                raise MeshError(f"{name} has shape {array.shape}; a plain list is needed")
        if len(rows["sizes"]) != len(rows["closed"]):
            raise MeshError(f"found {len(rows['sizes'])} sizes and {len(rows['closed'])} closed; one each a chain")
        total, smallest = rows["sizes"].sum(), rows["sizes"].min(initial=0)
        if total != len(rows["corners"]) or smallest < 0:
            negative = f", one of them {smallest}" if smallest < 0 else ""
            raise MeshError(f"found {len(rows['corners'])} corners, and sizes that add up to {total}{negative}")
        for name, array in {"verts": points, **rows}.items():
            object.__setattr__(self, name, array)

    @classmethod
    def through(cls, verts: ArrayLike, *, closed: bool = False) -> "Curves":
        """One curve through all verts, in their order.

        Example:
            >>> Curves.through([[0, 0, 0], [1, 0, 0], [1, 1, 0]], closed=True).num_segments
            3
        """
        count = len(np.asarray(verts))
        return cls(verts, np.arange(count), [count], [closed])

    @property
    def num_verts(self) -> int:
        """V, the number of vertices."""
        return len(self.verts)

    @property
    def num_segments(self) -> int:
        """S, the number of segments, over all chains."""
        return int(self.sizes.sum() - (~self.closed).sum())


@dataclass(frozen=True, eq=False)
class Chains:
    """The connectivity of curves. Segments are numbered along the chains, one chain after another.

    Attributes:
        num_verts: V; verts that no chain uses are allowed.
        corners: (C,) int64, as in `Curves`.
        sizes: (N,) int64.
        closed: (N,) bool.
    """

    num_verts: int
    corners: Indices
    sizes: Indices
    closed: Mask

    @classmethod
    def of(cls, curves: Curves) -> "Chains":
        """The connectivity of curves."""
        return cls(curves.num_verts, curves.corners, curves.sizes, curves.closed)

    @cached_property
    def following(self) -> Indices:
        """(C,) the corner that comes after each corner; `NONE` at the end of an open chain."""
        following = np.arange(1, len(self.corners) + 1)
        ends = np.cumsum(self.sizes)
        full = self.sizes > 0
        following[ends[full] - 1] = np.where(self.closed[full], (ends - self.sizes)[full], NONE)
        return following

    @cached_property
    def neighbours(self) -> Int64[np.ndarray, "V 2"]:
        """(V, 2) the vertex before and the one after along the chain; `NONE` beyond its ends and off the chains."""
        neighbours = np.full((self.num_verts, 2), NONE, dtype=np.int64)
        neighbours[self.tail, 1], neighbours[self.head, 0] = self.head, self.tail
        return neighbours

    @property
    def tail(self) -> Indices:
        """(S,) vertex at which each segment starts."""
        return np.asarray(self.corners[self.following != NONE])

    @property
    def head(self) -> Indices:
        """(S,) vertex at which each segment ends."""
        return np.asarray(self.corners[self.following[self.following != NONE]])

    def split(self, inserted: int) -> "Chains":
        """The chains with so many new verts in every segment, numbered along the chains after the old ones."""
        leads_on = self.following != NONE
        segment = np.cumsum(leads_on) - 1
        new = self.num_verts + inserted * segment[:, None] + np.arange(inserted)
        corners = np.column_stack([self.corners, new])
        present = np.column_stack([np.ones_like(leads_on), *[leads_on] * inserted])
        return Chains(
            self.num_verts + inserted * int(leads_on.sum()),
            corners[present],
            self.sizes * (inserted + 1) - inserted * ~self.closed,
            self.closed,
        )


def require_chains(chains: Chains, purpose: str) -> None:
    """Refuse chains that are none.

    Raises:
        MeshError: one indexes outside, has too few verts, or meets itself or another one; it is named.
    """
    corners, last = chains.corners, chains.num_verts - 1
    chain_of = np.repeat(np.arange(len(chains.sizes)), chains.sizes)
    outside = np.flatnonzero((corners < 0) | (corners > last))
    if len(outside):
        at = outside[0]
        raise MeshError(
            f"{purpose} needs proper chains: chain {chain_of[at]} has vertex {corners[at]}: "
            f"verts are numbered 0 to {last}"
        )
    short = np.flatnonzero(chains.sizes < 2)
    if len(short):
        raise MeshError(f"{purpose} needs proper chains: chain {short[0]} has {chains.sizes[short[0]]} verts, not 2")
    twice = np.flatnonzero(np.bincount(corners, minlength=chains.num_verts) > 1)
    if len(twice):
        raise MeshError(f"{purpose} needs curves that do not branch: vertex {twice[0]} stands twice in the chains")


def _frozen(given: ArrayLike, dtype: DTypeLike) -> np.ndarray:
    array = np.array(given, dtype=dtype)
    array.setflags(write=False)
    return array
