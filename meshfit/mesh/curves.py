"""Curves: vertices joined to open or closed chains, and the connectivity of the chains alone."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Int64
from numpy.typing import ArrayLike

from meshfit.errors import MeshError
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.topology import NONE, Indices, Mask
from meshfit.units import count_text

Segments = Int64[np.ndarray, "S 2"]


@dataclass(frozen=True, eq=False, init=False)
class Curves:
    """Polylines. All arrays are read-only copies.

    Attributes:
        verts: (V, 3) float64, positions.
        corners: (C,) int64, vertex indices of the chains, one chain after another, without duplicates.
        sizes: (N,) int64, the number of corners of each chain.
        closed: (N,) bool, whether a last segment joins the end of each chain to its start.

    Example:
        >>> import meshfit
        >>> meshfit.Curves([[0, 0, 0], [1, 0, 0], [1, 1, 0]], corners=[0, 1, 2], sizes=[3], closed=[True])
        Curves(3 verts, 1 chain, 3 segments)

    Raises:
        MeshError: an array of another shape, or sizes that do not add up.
    """

    verts: Verts
    corners: Indices
    sizes: Indices
    closed: Mask

    def __init__(self, verts: ArrayLike, corners: ArrayLike, sizes: ArrayLike, closed: ArrayLike) -> None:
        object.__setattr__(self, "verts", Mesh(verts, []).verts)
        for name, values, dtype in (
            ("corners", corners, np.int64),
            ("sizes", sizes, np.int64),
            ("closed", closed, bool),
        ):
            array = np.array(values, dtype=dtype)
            if array.ndim != 1:
                raise MeshError(f"{name}: expected a flat list, got an array of shape {array.shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if len(self.sizes) != len(self.closed):
            raise MeshError(f"expected one size and one closed per chain, got {len(self.sizes)} and {len(self.closed)}")
        total, smallest = self.sizes.sum(), self.sizes.min(initial=0)
        if total != len(self.corners) or smallest < 0:
            negative = f", one of them {smallest}" if smallest < 0 else ""
            raise MeshError(f"got {len(self.corners)} corners, and sizes that add up to {total}{negative}")

    def __repr__(self) -> str:
        """Return the numbers of vertices, chains and segments."""
        counts = ((self.num_verts, "vert"), (len(self.sizes), "chain"), (self.num_segments, "segment"))
        return f"Curves({', '.join(count_text(number, noun) for number, noun in counts)})"

    @classmethod
    def through(cls, verts: ArrayLike, *, closed: bool = False) -> "Curves":
        """Return one curve through all vertices, in their order.

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
    """Connectivity of curves. Segments are numbered along the chains, one chain after another.

    Attributes:
        num_verts: V; vertices that no chain uses are allowed.
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
        """Return the connectivity of curves."""
        return cls(curves.num_verts, curves.corners, curves.sizes, curves.closed)

    @cached_property
    def following(self) -> Indices:
        """(C,) the next corner of each corner; `NONE` at the end of an open chain."""
        following = np.arange(1, len(self.corners) + 1)
        ends = np.cumsum(self.sizes)
        full = self.sizes > 0
        following[ends[full] - 1] = np.where(self.closed[full], (ends - self.sizes)[full], NONE)
        return following

    @cached_property
    def neighbours(self) -> Int64[np.ndarray, "V 2"]:
        """(V, 2) the previous and the next vertex along the chain; `NONE` beyond its ends and off the chains."""
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
        """Return the chains with new vertices in every segment, numbered along the chains after the old ones."""
        has_segment = self.following != NONE
        segment = np.cumsum(has_segment) - 1
        new = self.num_verts + inserted * segment[:, None] + np.arange(inserted)
        corners = np.column_stack([self.corners, new])
        present = np.column_stack([np.ones_like(has_segment), *[has_segment] * inserted])
        return Chains(
            self.num_verts + inserted * int(has_segment.sum()),
            corners[present],
            self.sizes * (inserted + 1) - inserted * ~self.closed,
            self.closed,
        )


def require_chains(chains: Chains, purpose: str) -> None:
    """Refuse invalid chains.

    Raises:
        MeshError: a chain has an index out of range or too few vertices, or meets itself or another one.
    """
    corners, last = chains.corners, chains.num_verts - 1
    chain_of = np.repeat(np.arange(len(chains.sizes)), chains.sizes)
    outside = np.flatnonzero((corners < 0) | (corners > last))
    if len(outside):
        at = outside[0]
        raise MeshError(
            f"{purpose} needs valid chains: chain {chain_of[at]} has vertex {corners[at]}: "
            f"vertices are numbered 0 to {last}"
        )
    short = np.flatnonzero(chains.sizes < 2)
    if len(short):
        raise MeshError(f"{purpose} needs chains of 2 or more vertices: chain {short[0]} has {chains.sizes[short[0]]}")
    twice = np.flatnonzero(np.bincount(corners, minlength=chains.num_verts) > 1)
    if len(twice):
        raise MeshError(f"{purpose} needs curves that do not branch: vertex {twice[0]} is in the chains twice")


def join_segments(num_verts: int, segments: Segments, origin: str) -> Chains:
    """Join segments to chains, each as long as possible.

    A chain has the direction of the first of its segments; a closed one starts with it. Chains are in the order of
    their first segments, so that segments listed along chains give these chains again.

    Args:
        num_verts: V.
        segments: (S, 2) vertex indices.
        origin: name of the curves in messages, usually a path.

    Raises:
        MeshError: a segment with an index out of range or from a vertex to itself, or a vertex of three segments.
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
    """Return the half-segment that a chain starts at: the open end behind the first one, or the first one itself."""
    half = first
    while partner[half] != NONE:
        half = partner[half] ^ 1
        if half == first:
            break
    return half


def _partners(segments: Segments) -> Indices:
    """Return (2S,) the other half-segment at the same vertex, or `NONE`; half 2s + k is end k of segment s."""
    ends = segments.reshape(-1)
    order = np.argsort(ends, kind="stable")
    same = np.flatnonzero(ends[order][:-1] == ends[order][1:])
    partner = np.full(len(ends), NONE, dtype=np.int64)
    partner[order[same]], partner[order[same + 1]] = order[same + 1], order[same]
    return partner


def _require_segments(num_verts: int, segments: Segments, origin: str) -> None:
    outside = np.flatnonzero(((segments < 0) | (segments >= num_verts)).any(axis=1))
    for bad, fault in (
        (outside, f"but vertices are numbered 0 to {num_verts - 1}"),
        (np.flatnonzero(segments[:, 0] == segments[:, 1]), "from a vertex to itself"),
    ):
        if len(bad):
            raise MeshError(f"{origin}: segment {bad[0]} is {segments[bad[0]].tolist()}, {fault}")
    meeting = np.bincount(segments.reshape(-1), minlength=num_verts)
    branching = np.flatnonzero(meeting > 2)
    if len(branching):
        raise MeshError(
            f"{origin}: the curves branch: vertex {branching[0]} has {meeting[branching[0]]} segments, "
            f"allowed: 1 or 2 ({count_text(len(branching), 'such vertex')}); split the curves there"
        )
