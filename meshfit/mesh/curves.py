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


Segments = Int64[np.ndarray, "S 2"]


def join_segments(num_verts: int, segments: Segments, origin: str) -> Chains:
    """Chains of all segments, each as long as can be.

    A chain runs the way of the first of its segments; a closed one starts with it. Chains come in the order of their
    first segments, so that segments that are listed along chains come back as these chains.

    Args:
        num_verts: V.
        segments: (S, 2) vertex indices.
        origin: what to call them in messages, usually a path.

    Raises:
        MeshError: a segment that indexes outside or leads from a vertex to itself, or a vertex of three segments.
    """
    _require_segments(num_verts, segments, origin)
    partner, ends = _partners(segments).tolist(), segments.reshape(-1).tolist()
    used = np.zeros(len(segments), dtype=bool)
    corners: list[int] = []
    sizes: list[int] = []
    closed: list[bool] = []
    for first in range(len(segments)):
        if used[first]:
            continue
        half = start = _start(partner, 2 * first)
        before = len(corners)
        while True:
            used[half // 2] = True
            corners.append(ends[half])
            other = half ^ 1
            half = partner[other]
            if half == NONE:
                corners.append(ends[other])
            if half in (NONE, start):
                break
        sizes.append(len(corners) - before)
        closed.append(half == start)
    return Chains(num_verts, np.array(corners, np.int64), np.array(sizes, np.int64), np.array(closed, np.bool_))


def _start(partner: list[int], first: int) -> int:
    """The half-segment that a chain starts at: the open end behind the first one, or that one itself."""
    half = first
    while partner[half] != NONE:
        half = partner[half] ^ 1
        if half == first:
            break
    return half


def _partners(segments: Segments) -> Indices:
    """(2S,) where half 2s + k is end k of segment s: the other half at the same vertex, or `NONE`."""
    ends = segments.reshape(-1)
    order = np.argsort(ends, kind="stable")
    same = np.flatnonzero(ends[order][:-1] == ends[order][1:])
    partner = np.full(len(ends), NONE, dtype=np.int64)
    partner[order[same]], partner[order[same + 1]] = order[same + 1], order[same]
    return partner


def _require_segments(num_verts: int, segments: Segments, origin: str) -> None:
    outside = np.flatnonzero(((segments < 0) | (segments >= num_verts)).any(axis=1))
    for bad, fault in (
        (outside, f"but verts are numbered 0 to {num_verts - 1}"),
        (np.flatnonzero(segments[:, 0] == segments[:, 1]), "from a vertex to itself"),
    ):
        if len(bad):
            raise MeshError(f"{origin}: segment {bad[0]} is {segments[bad[0]].tolist()}, {fault}")
    meeting = np.bincount(segments.reshape(-1), minlength=num_verts)
    branching = np.flatnonzero(meeting > 2)
    if len(branching):
        raise MeshError(
            f"{origin}: the curves branch: vertex {branching[0]} has {meeting[branching[0]]} segments, "
            f"1 or 2 are allowed ({len(branching)} such verts); split them there"
        )
