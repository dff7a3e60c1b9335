"""Stability of the shifts of the basis function φ: where Σ_k |φ^(ξ + 2πk)|², their periodisation, is zero.

It is a trigonometric polynomial, whose coefficients are the eigenvector of the transition operator to the eigenvalue 1.
"""

from itertools import product

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.subdivision.analysis.sequences import order_of_zero

_GRID = 72
_ZERO = 1e-9

Zero = tuple[Float64[np.ndarray, " D"], int]
"""A frequency, and the order to which the periodisation vanishes there."""


def zeros_of_periodisation(
    transition: Float64[np.ndarray, "O O"], orbits: Float64[np.ndarray, "P O"], places: Int64[np.ndarray, "P D"]
) -> list[Zero]:
    """Its zeros among the frequencies 2π k / 72, which hold those of all masks that are products of differences.

    Args:
        transition: the operator, on symmetric sequences; where it has larger eigenvalues than 1, nothing is found.
        orbits: the basis of these sequences.
        places: where they live.
    """
    values, vectors = np.linalg.eig(transition)
    if np.abs(values).max() > 1 + _ZERO:
        return []
    sequence = np.real(orbits @ vectors[:, np.argmin(np.abs(values - 1))])
    sequence /= sequence.sum()
    turns = np.arange(_GRID) * (2 * np.pi / _GRID)
    grid = np.array(list(product(turns, repeat=places.shape[1])))
    found = grid[np.abs(np.cos(grid @ places.T) @ sequence) < _ZERO]
    return [(frequency, order_of_zero(places, sequence, frequency)) for frequency in found]
