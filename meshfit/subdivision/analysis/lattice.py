"""The mask of a scheme on the regular lattice, read off a column of its operator."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.errors import SchemeError
from meshfit.subdivision.analysis.bench import Bench, Patch

_REACH = 9
_MOST_STEPS = 4
_WHOLE = 1e-8
_ZERO = 1e-14


@dataclass(frozen=True, eq=False)
class RegularMask:
    """The weights a(k) that one coarse value contributes to the fine lattice: fine(k) = Σ_j a(k - m j) coarse(j).

    Attributes:
        offsets: (K, D) k, in units of the fine lattice and in its basis, from where the coarse value lies; multiples
            of 1/2 for dual schemes, whose new verts do not lie on old ones.
        weights: (K,) a(k).
        dilation: m, the number of fine edges along a coarse one.
        steps: levels of the scheme that it takes until the fine lattice lies as the coarse one does: 2 for √3 and √2.
    """

    offsets: Float64[np.ndarray, "K D"]
    weights: Float64[np.ndarray, " K"]
    dilation: int
    steps: int

    @property
    def dimension(self) -> int:
        """D, of the lattice."""
        return int(self.offsets.shape[1])

    @property
    def whole_offsets(self) -> Int64[np.ndarray, "K D"]:
        """(K, D) the offsets moved to integers; the same ones where they are integers."""
        return np.asarray(np.rint(self.offsets - _part(self.offsets)), dtype=np.int64)


def regular_mask(bench: Bench) -> RegularMask:
    """Read the mask off a patch.

    New verts are located by refining the lattice's coordinates, which every scheme of symmetric masks reproduces.

    Raises:
        SchemeError: the fine lattice never lies as the coarse one does.
    """
    patch = bench.patch(_REACH)
    for steps in range(1, _MOST_STEPS + 1):
        found = _mask_after(patch, steps)
        if found is not None:
            return found
    raise SchemeError(
        f"this scheme cannot be analysed: after {_MOST_STEPS} steps its new verts are no finer copy of the lattice"
    )


def _mask_after(patch: Patch, steps: int) -> RegularMask | None:
    finer = patch.refine(steps)
    inner = patch.regular(finer)
    places = finer.carry(patch.places)[inner]
    dimension = patch.places.shape[1]
    density = int(((places > -0.5 - _WHOLE) & (places < 0.5 - _WHOLE)).all(axis=1).sum())
    dilation = round(density ** (1 / dimension))
    if dilation < 2 or dilation**dimension != density:
        return None
    offsets = dilation * places
    if np.abs(offsets - _part(offsets) - np.rint(offsets - _part(offsets))).max() > _WHOLE:
        return None
    origin = (patch.places == 0).all(axis=1) * 1.0
    weights = finer.carry(origin)[inner]
    kept = np.abs(weights) > _ZERO
    part = _part(offsets)
    return RegularMask(np.rint(offsets[kept] - part) + part, weights[kept], dilation, steps)


def _part(offsets: Float64[np.ndarray, "K D"]) -> Float64[np.ndarray, " D"]:
    """What the offsets have in common beyond integers: 0, or 1/2 for dual schemes."""
    return np.asarray(np.rint(2 * offsets[0]) % 2 / 2)
