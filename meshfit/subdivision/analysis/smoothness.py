"""Smoothness on the regular lattice: the L2-Sobolev exponent of the basis function, from the mask alone."""

from itertools import product
from math import inf, log

import numpy as np
from jaxtyping import Float64, Int64
from scipy.signal import correlate

from meshfit.subdivision.analysis.lattice import RegularMask
from meshfit.subdivision.analysis.sequences import moments, null_space, points_in_hull, values_at

_TOLERANCE = 1e-9


def sobolev_exponent(mask: RegularMask, order: int) -> float:
    """The exponent s2: the basis function has s derivatives in L2 for every s < s2 (exact for stable schemes).

    With b the autocorrelation of the mask over m^D, the transition operator (T v)(i) = Σ_j b(m i - j) v(j) maps
    finite sequences that all polynomials below degree 2κ annihilate to such sequences; s2 = -log_m(ρ) / 2, where ρ is
    its spectral radius there (Jia 1998). The largest eigenvalue has an eigenvector with all symmetries of the mask
    (Han 2003, Computing the smoothness exponent of a symmetric multivariate refinable function), so that T is
    restricted to those, which makes it small and leaves few multiple eigenvalues: s2 is right to about 1e-6.

    Args:
        mask: on the regular lattice.
        order: κ, the order of its sum rules.
    """
    offsets, values = _autocorrelation(mask)
    places = points_in_hull(offsets, mask.dilation - 1)
    orbits = _orbits(places, _symmetries(offsets, values))
    transition = values_at(offsets, values, mask.dilation * places[:, None] - places[None])
    symmetric = orbits.T @ transition @ orbits
    free = null_space(moments(places, 2 * order) @ orbits)
    if not free.size:
        return inf
    radius = float(np.abs(np.linalg.eigvals(free.T @ symmetric @ free)).max())
    return -log(radius) / (2 * log(mask.dilation)) if radius > 0 else inf


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
