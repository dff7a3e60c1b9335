"""The subdivision matrix around one odd place: how its first rings, refined, follow from the same rings before.

A turn by one spoke changes nothing, so that the matrix falls into one small block for each Fourier mode.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from meshfit.errors import SchemeError
from meshfit.mesh.topology import NONE, Indices
from meshfit.subdivision.analysis.bench import HalfEdges, Wheel

PAD = 3
"""Rings around those of a local matrix, so that the border of the wheel does not reach it."""

_MOST_RINGS = 9
_ZERO = 1e-14


@dataclass(frozen=True, eq=False)
class LocalMatrix:
    """The rows of one fine vertex of each row of `turns`, over all coarse verts of the rings.

    Attributes:
        rings: how many.
        hub: (1 or 0,) the row of the hub itself, if it is a vertex, over the hub and the mean of each row of `turns`.
        from_hub: (K, 1 or 0) what the first of each row takes of the hub.
        turned: (K, K, n) what the first of each row takes of every vertex of every row.
    """

    rings: int
    hub: Float64[np.ndarray, "H L"]
    from_hub: Float64[np.ndarray, "K H"]
    turned: Float64[np.ndarray, "K K N"]

    @property
    def valence(self) -> int:
        """The number of spokes."""
        return int(self.turned.shape[2])

    def block(self, mode: int) -> Complex128[np.ndarray, "L L"]:
        """The part that acts on values that turn by `mode` times 2π/n from spoke to spoke."""
        phase = np.exp(2j * np.pi * mode * np.arange(self.valence) / self.valence)
        block = np.asarray(self.turned @ phase)
        if mode % self.valence:
            return block
        return np.asarray(np.vstack([self.hub, np.hstack([self.from_hub, block])]))


def local_matrix(wheel: Wheel, steps: int, rings: int) -> LocalMatrix | None:
    """The matrix of so many rings of a wheel that has `PAD` more; None where these rings need more than themselves."""
    finer = wheel.refine(steps)
    kept = wheel.within(rings)
    matched = match(wheel, finer.halfedges, wheel.locate(steps), rings)
    rows = finer.operators[-1][matched[kept]]
    for operator in finer.operators[-2::-1]:
        rows = rows @ operator
    dense = rows.toarray()
    outside = np.ones(dense.shape[1], dtype=bool)
    outside[kept] = False
    if (np.abs(dense[:, outside]) > _ZERO).any():
        return None
    row_of = np.full(dense.shape[1], NONE)
    row_of[kept] = np.arange(len(kept))
    turns, hub = wheel.turns[wheel.ring <= rings], int(wheel.hub)
    first = dense[row_of[turns[:, 0]]]
    centre = dense[:hub]
    at_hub = np.hstack([centre[:, :hub], centre[:, turns].sum(axis=2)])
    return LocalMatrix(rings, at_hub, first[:, :hub], first[:, turns])


def invariant_matrix(wheel_of: Callable[[int], Wheel], steps: int, rings: int) -> LocalMatrix:
    """The matrix of so many rings, or of as few more as follow from themselves.

    Raises:
        SchemeError: no number of rings does.
    """
    for number in range(max(1, rings), _MOST_RINGS + 1):
        found = local_matrix(wheel_of(number + PAD), steps, number)
        if found is not None:
            return found
    raise SchemeError(f"this scheme cannot be analysed: {_MOST_RINGS} rings around a vertex do not follow from them")


def match(wheel: Wheel, fine: HalfEdges, places: Complex128[np.ndarray, " W"], rings: int) -> Indices:
    """(V,) the fine vertex in the place of each coarse one of the first rings; `NONE` for the others.

    Both connectivities are walked at once, from the centre outwards, along corresponding half-edges.

    Args:
        wheel: the coarse connectivity.
        fine: the fine one.
        places: where the wheel locates the fine verts.
        rings: how many are matched.
    """
    coarse = wheel.halfedges
    inside = np.zeros(len(wheel.places), dtype=bool)
    inside[wheel.within(rings)] = True
    whole = inside[coarse.tail] & inside[coarse.head]
    start, other = _starts(wheel, fine, places)
    matched = np.full(len(wheel.places), NONE)
    seen, waiting = {start}, [(start, other)]
    following, tails = (coarse.following.tolist(), fine.following.tolist()), (coarse.tail.tolist(), fine.tail.tolist())
    twins = coarse.twin.tolist(), fine.twin.tolist()
    while waiting:
        here, there = waiting.pop()
        matched[tails[0][here]] = tails[1][there]
        for mine, theirs in (following, twins):
            onward, beside = mine[here], theirs[there]
            if NONE not in (onward, beside) and onward not in seen and whole[onward]:
                seen.add(onward)
                waiting.append((onward, beside))
    return matched


def _starts(wheel: Wheel, fine: HalfEdges, places: Complex128[np.ndarray, " W"]) -> tuple[int, int]:
    """Half-edges about the centre of the coarse and of the fine faces, in the same direction from it."""
    mine = _about_centre(wheel.halfedges, wheel.places, hub=wheel.hub)
    theirs = _about_centre(fine, places, hub=wheel.hub)
    ahead = _middles(wheel.halfedges, wheel.places)[mine[0]]
    turned = _middles(fine, places)[theirs] / ahead
    return int(mine[0]), int(theirs[np.argmin(np.abs(np.angle(turned)))])


def _about_centre(halfedges: HalfEdges, places: Complex128[np.ndarray, " V"], *, hub: bool) -> Indices:
    """Those out of the hub; without one, those of the face in the middle."""
    if hub:
        return np.flatnonzero(halfedges.tail == int(np.argmin(np.abs(places))))
    here = int(np.argmin(np.abs(_face_centres(halfedges, places))))
    face = [here]
    while (here := int(halfedges.following[here])) != face[0]:
        face.append(here)
    return np.array(face)


def _middles(halfedges: HalfEdges, places: Complex128[np.ndarray, " V"]) -> Complex128[np.ndarray, " H"]:
    return np.asarray((places[halfedges.tail] + places[halfedges.head]) / 2)


def _face_centres(halfedges: HalfEdges, places: Complex128[np.ndarray, " V"]) -> Complex128[np.ndarray, " H"]:
    """(H,) the mean of the corners of the face of each half-edge, whatever the sizes of faces are."""
    total, corners = places[halfedges.tail].copy(), np.ones(len(halfedges.tail))
    ahead = halfedges.following.copy()
    going = ahead != np.arange(len(ahead))
    while going.any():
        total[going] += places[halfedges.tail[ahead[going]]]
        corners[going] += 1
        ahead[going] = halfedges.following[ahead[going]]
        going = ahead != np.arange(len(ahead))
    return np.asarray(total / corners)
