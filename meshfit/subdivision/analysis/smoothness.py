"""Smoothness on the regular lattice: the L2-Sobolev exponent of the basis function, from the mask alone."""

from dataclasses import dataclass
from itertools import product
from math import inf, log

import numpy as np
from jaxtyping import Float64, Int64
from scipy.signal import correlate

from meshfit.subdivision.analysis.lattice import RegularMask
from meshfit.subdivision.analysis.sequences import (
    moments,
    null_space,
    order_of_zero,
    points_in_hull,
    values_at,
    waves,
)
from meshfit.subdivision.analysis.stability import Zero, zeros_of_periodisation

_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Regularity:
    """How smooth the basis function is.

    Attributes:
        s2: its exponent: it has s derivatives in L2 for every s < s2.
        accuracy: the order up to which polynomials are combinations of its shifts; if these are stable, that of the sum
            rules.
        stable: whether its shifts are stable, so that no bounded combination of them is zero.
    """

    s2: float
    accuracy: int
    stable: bool


def regularity_of(mask: RegularMask) -> Regularity:
    """Compute the exponent.

    With b the autocorrelation of the mask over m^D, the transition operator (T v)(i) = Σ_j b(m i - j) v(j) maps
    finite sequences that all polynomials below degree 2κ annihilate to such sequences; s2 = -log_m(ρ) / 2, where ρ is
    its spectral radius there (Jia 1999, Characterization of smoothness of multivariate refinable functions in Sobolev
    spaces). The largest eigenvalue has an eigenvector with all symmetries of the mask (Han 2003, Computing the
    smoothness exponent of a symmetric multivariate refinable function), so that T is restricted to those, which makes
    it small and leaves few multiple eigenvalues: s2 is right to about 1e-6.

    Where the shifts are unstable, only sequences count whose symbol vanishes where Σ_k |φ^(ξ + 2πk)|² does, and to its
    order (Ron and Shen 2000, The Sobolev regularity of refinable functions).

    Args:
        mask: on the regular lattice.
    """
    offsets, values = _autocorrelation(mask)
    places = points_in_hull(offsets, mask.dilation - 1)
    orbits = _orbits(places, _symmetries(offsets, values))
    transition = values_at(offsets, values, mask.dilation * places[:, None] - places[None])
    symmetric = orbits.T @ transition @ orbits
    zeros = zeros_of_periodisation(symmetric, orbits, places)
    accuracy = _accuracy(offsets, values, mask.dilation, zeros)
    conditions = [moments(places, 2 * accuracy), *(waves(places, *zero) for zero in zeros)]
    free = null_space(np.concatenate(conditions) @ orbits)
    radius = float(np.abs(np.linalg.eigvals(free.T @ symmetric @ free)).max(initial=0.0))
    s2 = -log(radius) / (2 * log(mask.dilation)) if radius > 0 else inf
    return Regularity(s2, accuracy, stable=not zeros)


def _accuracy(
    offsets: Int64[np.ndarray, "B D"], values: Float64[np.ndarray, " B"], dilation: int, zeros: list[Zero]
) -> int:
    """Half the least order to which b and the periodisation together vanish at the frequencies 2πk / m but 0.

    So much of a zero at 0 does T leave of a symbol there. Without zeros of the periodisation, it is the order of the
    sum rules.
    """
    turns = 2 * np.pi / dilation * np.arange(dilation)
    frequencies = np.array(list(product(turns, repeat=offsets.shape[1])))[1:]
    orders = []
    for frequency in frequencies:
        own = [order for zero, order in zeros if np.allclose(zero, frequency)]
        orders.append(order_of_zero(offsets, values, frequency) + sum(own))
    return min(orders) // 2


def _autocorrelation(mask: RegularMask) -> tuple[Int64[np.ndarray, "B D"], Float64[np.ndarray, " B"]]:
    """Offsets and values of b."""
    whole = mask.whole_offsets
    corner = whole - whole.min(axis=0)
    dense = np.zeros(corner.max(axis=0) + 1)
    dense[tuple(corner.T)] = mask.weights
    both = correlate(dense, dense, method="direct") / mask.dilation**mask.dimension
    kept = np.abs(both) > _TOLERANCE * np.abs(both).max()
    return np.argwhere(kept) - np.array(dense.shape) + 1, both[kept]


def _symmetries(offsets: Int64[np.ndarray, "B D"], values: Float64[np.ndarray, " B"]) -> list[Int64[np.ndarray, "D D"]]:
    """The linear maps of the lattice to itself, with entries -1, 0 and 1, that leave b as it is."""
    dimension = offsets.shape[1]
    maps = (np.array(entries).reshape(dimension, dimension) for entries in product((-1, 0, 1), repeat=dimension**2))
    return [
        each
        for each in maps
        if abs(round(np.linalg.det(each))) == 1
        and np.abs(values_at(offsets, values, offsets @ each.T) - values).max() < _TOLERANCE
    ]


def _orbits(places: Int64[np.ndarray, "P D"], symmetries: list[Int64[np.ndarray, "D D"]]) -> Float64[np.ndarray, "P O"]:
    """(P, O) an orthonormal basis of the sequences on these places that all symmetries leave as they are."""
    images = np.stack([places @ each.T for each in symmetries], axis=1)
    span = 2 * np.abs(places).max() + 1
    keys = (images * span ** np.arange(places.shape[1])).sum(axis=2).min(axis=1)
    _, orbit = np.unique(keys, return_inverse=True)
    member = (orbit.reshape(-1)[:, None] == np.arange(orbit.max() + 1)).astype(np.float64)
    return np.asarray(member / np.linalg.norm(member, axis=0))
