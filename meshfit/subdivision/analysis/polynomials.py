"""Polynomials on the regular lattice: up to which degree a scheme reproduces them, and generates them."""

from collections.abc import Iterator
from itertools import product

import numpy as np
from jaxtyping import Float64

from meshfit.subdivision.analysis.bench import Bench
from meshfit.subdivision.analysis.lattice import RegularMask

_REACH = 7
_HIGHEST = 11
_TOLERANCE = 1e-9


def reproduced_degree(bench: Bench) -> int:
    """The highest degree up to which values of every polynomial at old verts become its values at new ones, or -1."""
    patch = bench.patch(_REACH)
    finer = patch.refine(1)
    inner = patch.regular(finer)
    coarse, fine = patch.places / _REACH, finer.carry(patch.places)[inner] / _REACH
    for degree in range(_HIGHEST + 1):
        found = finer.carry(monomials(coarse, degree))[inner]
        if np.abs(found - monomials(fine, degree)).max() > _TOLERANCE:
            return degree - 1
    return _HIGHEST


def sum_rule_order(mask: RegularMask) -> int:
    """The order κ of the sum rules: polynomials below degree κ are generated, so that κ - 1 is the highest of them.

    Order κ: Σ_j a(m j + ε) p(m j + ε) is the same for every ε, for every polynomial p of degree below κ (Jia 1998,
    Characterization of smoothness of multivariate refinable functions in Sobolev spaces).
    """
    offsets = mask.whole_offsets
    _, coset = np.unique(offsets % mask.dilation, axis=0, return_inverse=True)
    scale = max(1, int(np.abs(offsets).max()))
    places = offsets / scale
    count = mask.dilation**mask.dimension
    for degree in range(_HIGHEST + 1):
        moments = np.zeros((count, len(list(_powers(mask.dimension, degree)))))
        np.add.at(moments, coset.reshape(-1), mask.weights[:, None] * monomials(places, degree))
        if np.abs(moments - moments[0]).max() > _TOLERANCE:
            return degree
    return _HIGHEST + 1


def monomials(places: Float64[np.ndarray, "N D"], degree: int) -> Float64[np.ndarray, "N M"]:
    """(N, M) values of every monomial of exactly that degree."""
    return np.stack([np.prod(places ** np.array(power), axis=1) for power in _powers(places.shape[1], degree)], axis=1)


def _powers(dimension: int, degree: int) -> Iterator[tuple[int, ...]]:
    return (power for power in product(range(degree + 1), repeat=dimension) if sum(power) == degree)
