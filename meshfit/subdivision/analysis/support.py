"""How far a control vertex reaches on the regular lattice, and how many of them play a part."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.subdivision.analysis.bench import Bench
from meshfit.subdivision.analysis.lattice import RegularMask

_ZERO = 1e-14
_REACH = 9


@dataclass(frozen=True)
class Support:
    """The support of the basis function, the limit of the data that are 1 at one vertex and 0 at all others.

    Attributes:
        radius: rings of faces around its vertex that its convex hull reaches over; edges, on a curve.
        stencils: the least and the most coarse verts that a new vertex of one level is made of.
        mask: number of fine verts that a coarse one contributes to, in as many steps as make a scalar dilation.
    """

    radius: float
    stencils: tuple[int, int]
    mask: int


def support_of(bench: Bench, mask: RegularMask) -> Support:
    """The support: a mask on the points Ω gives a limit on Ω / m + Ω / m² + …, whose hull is that of Ω / (m - 1)."""
    radius = float(bench.distance(mask.offsets).max()) / (mask.dilation - 1)
    sizes = _stencil_sizes(bench)
    return Support(radius, (int(sizes.min()), int(sizes.max())), len(mask.weights))


def _stencil_sizes(bench: Bench) -> Float64[np.ndarray, " N"]:
    patch = bench.patch(_REACH)
    finer = patch.refine(1)
    inner = patch.regular(finer)
    used = abs(finer.operators[0]) > _ZERO
    return np.asarray(used.sum(axis=1)[inner], dtype=np.float64)
