"""From segments in any order to chains as long as can be."""

import numpy as np
from jaxtyping import Int64

from meshfit.errors import MeshError
from meshfit.mesh.curves import Chains
from meshfit.mesh.topology import NONE, Indices

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
