"""The subdivision matrix around one odd place: how its first rings, refined, follow from the same rings before.

A turn by one spoke changes nothing, so that the matrix falls into one small block for each Fourier mode.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from meshfit.errors import SchemeError
from meshfit.mesh.halfedges import NONE
from meshfit.subdivision.analysis.bench import Wheel
from meshfit.subdivision.analysis.matching import match_wheel

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
    matched = match_wheel(wheel, finer.topology, wheel.locate(steps), rings)
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
