"""Which fine vertex is in the place of which coarse one: both connectivities are walked at once, from the centre on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from meshfit.analysis.stencil_meshes import Fan, Wheel
from meshfit.errors import SchemeError
from meshfit.mesh.topology import NONE, Indices, Mask, PolygonTopology

Places = Complex128[np.ndarray, " V"]


def map_wheel(wheel: Wheel, fine: PolygonTopology, places: Places, rings: int) -> Indices:
    """(V,) the fine vertex in the place of each coarse one of the first rings; `NONE` for the others.

    Args:
        wheel: the coarse connectivity.
        fine: the fine one.
        places: where the wheel locates the fine verts.
        rings: how many are matched.
    """
    mine = _about_centre(wheel.topology, wheel.places, hub=wheel.hub)
    theirs = _about_centre(fine, places, hub=wheel.hub)
    ahead = _middles(wheel.topology, wheel.places)[mine[0]]
    turned = np.abs(np.angle(_middles(fine, places)[theirs] / ahead))
    inside = np.zeros(len(wheel.places), dtype=bool)
    inside[wheel.within(rings)] = True
    return _walk(wheel.topology, fine, inside, (int(mine[0]), int(theirs[np.argmin(turned)])))


def map_fan(fan: Fan, fine: PolygonTopology, places: Places, rings: int) -> Indices:
    """The same around a vertex on the boundary, from the half-edge out of it that lies there."""
    starts = []
    for topology, hub in ((fan.topology, 0), (fine, int(np.argmin(np.abs(places))))):
        starts.append(int(np.flatnonzero((topology.tail == hub) & (topology.twin == NONE))[0]))
    return _walk(fan.topology, fine, fan.ring <= rings, (starts[0], starts[1]))


def _walk(coarse: PolygonTopology, fine: PolygonTopology, inside: Mask, start: tuple[int, int]) -> Indices:
    """Along corresponding half-edges, as long as both ends of the coarse one are inside."""
    whole = inside[coarse.tail] & inside[coarse.head]
    matched = np.full(len(inside), NONE)
    seen, waiting = {start[0]}, [start]
    both = coarse, fine
    tails, twins = ([each.tail.tolist() for each in both], [each.twin.tolist() for each in both])
    following = [each.following(np.arange(len(each.corners))).tolist() for each in both]
    while waiting:
        here, there = waiting.pop()
        matched[tails[0][here]] = tails[1][there]
        for mine, theirs in (following, twins):
            onward, beside = mine[here], theirs[there]
            if NONE not in (onward, beside) and onward not in seen and whole[onward]:
                seen.add(onward)
                waiting.append((onward, beside))
    return matched


def _about_centre(topology: PolygonTopology, places: Places, *, hub: bool) -> Indices:
    """The half-edges out of the hub; without one, those of the face in the middle."""
    if hub:
        return np.flatnonzero(topology.tail == int(np.argmin(np.abs(places))))
    middles = np.add.reduceat(places[topology.corners], topology.starts) / topology.sizes
    face = int(np.argmin(np.abs(middles)))
    return np.asarray(topology.starts[face] + np.arange(topology.sizes[face]))


def _middles(topology: PolygonTopology, places: Places) -> Complex128[np.ndarray, " C"]:
    return np.asarray((places[topology.tail] + places[topology.head]) / 2)


PAD = 3
"""Rings around those of a local matrix, so that the border of the wheel does not reach it."""

MOST_RINGS = 9
"""Where the search for rings that follow from themselves ends."""


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
    matched = map_wheel(wheel, finer.topology, wheel.locate(steps), rings)
    dense = finer.rows(matched[kept])
    outside = np.ones(dense.shape[1], dtype=bool)
    outside[kept] = False
    if dense[:, outside].any():
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
    for number in range(max(1, rings), MOST_RINGS + 1):
        found = local_matrix(wheel_of(number + PAD), steps, number)
        if found is not None:
            return found
    raise SchemeError(f"this scheme cannot be analysed: {MOST_RINGS} rings around a vertex do not follow from them")
