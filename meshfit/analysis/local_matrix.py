"""Local subdivision matrix: the rings around an extraordinary vertex, refined, from the same rings before.

The ring map tells which fine vertex takes the place of which coarse one; it walks both connectivities at once from the
centre outwards.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from meshfit.analysis.stencil_meshes import Fan, Wheel
from meshfit.errors import SchemeError
from meshfit.mesh.topology import NONE, Indices, Mask, PolygonTopology

Places = Complex128[np.ndarray, " V"]

PAD = 3
"""Rings around those of a local matrix that keep the border of the wheel away from it."""
MOST_RINGS = 9
"""The most rings that are tried for an invariant neighbourhood."""


def map_wheel(wheel: Wheel, fine: PolygonTopology, places: Places, rings: int) -> Indices:
    """Return the (V,) fine vertex in the place of each coarse one in the first rings; `NONE` for the others.

    Args:
        wheel: the coarse mesh.
        fine: the fine connectivity.
        places: positions of the fine vertices, from `wheel.locate`.
        rings: number of rings to map.
    """
    coarse_start = int(_around_centre(wheel.topology, wheel.places, hub=wheel.hub)[0])
    fine_starts = _around_centre(fine, places, hub=wheel.hub)
    direction = _midpoints(wheel.topology, wheel.places)[coarse_start]
    turn = np.abs(np.angle(_midpoints(fine, places)[fine_starts] / direction))
    inside = np.zeros(len(wheel.places), dtype=bool)
    inside[wheel.within(rings)] = True
    return _walk(wheel.topology, fine, inside, (coarse_start, int(fine_starts[np.argmin(turn)])))


def map_fan(fan: Fan, fine: PolygonTopology, places: Places, rings: int) -> Indices:
    """Return the same map around a vertex on the boundary, starting at the boundary half-edge out of it."""
    starts = []
    for topology, hub in ((fan.topology, 0), (fine, int(np.argmin(np.abs(places))))):
        starts.append(int(np.flatnonzero((topology.tail == hub) & (topology.twin == NONE))[0]))
    return _walk(fan.topology, fine, fan.ring <= rings, (starts[0], starts[1]))


def _walk(coarse: PolygonTopology, fine: PolygonTopology, inside: Mask, start: tuple[int, int]) -> Indices:
    """Walk along corresponding half-edges, as long as both ends of the coarse one are inside."""
    whole = inside[coarse.tail] & inside[coarse.head]
    matched = np.full(len(inside), NONE)
    seen, waiting = {start[0]}, [start]
    both = coarse, fine
    tails, twins = [topology.tail.tolist() for topology in both], [topology.twin.tolist() for topology in both]
    following = [topology.following(np.arange(len(topology.corners))).tolist() for topology in both]
    while waiting:
        halfedge, partner = waiting.pop()
        matched[tails[0][halfedge]] = tails[1][partner]
        for step, partner_step in (following, twins):
            reached, partner_reached = step[halfedge], partner_step[partner]
            if NONE not in (reached, partner_reached) and reached not in seen and whole[reached]:
                seen.add(reached)
                waiting.append((reached, partner_reached))
    return matched


def _around_centre(topology: PolygonTopology, places: Places, *, hub: bool) -> Indices:
    """Return the half-edges out of the hub or, without a hub, those of the central face."""
    if hub:
        return np.flatnonzero(topology.tail == int(np.argmin(np.abs(places))))
    middles = np.add.reduceat(places[topology.corners], topology.starts) / topology.sizes
    face = int(np.argmin(np.abs(middles)))
    return np.asarray(topology.starts[face] + np.arange(topology.sizes[face]))


def _midpoints(topology: PolygonTopology, places: Places) -> Complex128[np.ndarray, " C"]:
    return np.asarray((places[topology.tail] + places[topology.head]) / 2)


@dataclass(frozen=True, eq=False)
class LocalMatrix:
    """Rows of the first fine vertex of each row of `Wheel.turns`, over all coarse vertices of the rings.

    Attributes:
        rings: number of rings.
        hub: (1 or 0, L) the row of the hub, if it is a vertex, over the hub and the sum of each row of `turns`.
        from_hub: (K, 1 or 0) weights of the hub.
        turned: (K, K, n) weights of every vertex of every row.
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
        """Return the part that acts on values that turn by `mode` times 2π/n from spoke to spoke."""
        phase = np.exp(2j * np.pi * mode * np.arange(self.valence) / self.valence)
        block = np.asarray(self.turned @ phase)
        if mode % self.valence:
            return block
        return np.asarray(np.vstack([self.hub, np.hstack([self.from_hub, block])]))


def local_matrix(wheel: Wheel, steps: int, rings: int) -> LocalMatrix | None:
    """Return the matrix of some rings of a wheel with `PAD` more; None if these rings depend on further ones."""
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
    """Return the matrix of so many rings, or of the fewest more that depend on themselves alone.

    Raises:
        SchemeError: no number of rings up to `MOST_RINGS` does.
    """
    for number in range(max(1, rings), MOST_RINGS + 1):
        matrix = local_matrix(wheel_of(number + PAD), steps, number)
        if matrix is not None:
            return matrix
    raise SchemeError(f"this scheme cannot be analysed: {MOST_RINGS} rings around a vertex depend on further rings")
