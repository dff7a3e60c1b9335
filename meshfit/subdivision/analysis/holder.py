"""Continuous derivatives of the basis function on the regular lattice: a proof that they exist, or that they do not.

Both look at the matrices A_ε, (A_ε v)(i) = Σ_j a(m i - j + ε) v(j), on the finite sequences that polynomials below the
order of the sum rules annihilate: the limit is C^k if products of L of them shrink faster than m^(-k L), and if its
scheme is stable it is not if some product shrinks slower (Daubechies and Lagarias 1992; Jia 1995, Subdivision schemes
in L_p spaces).
"""

from itertools import combinations, product
from math import ceil, inf, log

import numpy as np
from jaxtyping import Float64

from meshfit.subdivision.analysis.lattice import RegularMask
from meshfit.subdivision.analysis.sequences import moments, null_space, points_in_hull, values_at
from meshfit.subdivision.analysis.smoothness import Regularity

Digits = Float64[np.ndarray, "E N N"]

_MOST_WORDS = 40_000
_LONGEST = 8
_SAME = 1e-6
_SMOOTHING = 60


def continuity(mask: RegularMask, order: int, regularity: Regularity, bound: float) -> int:
    """The largest k for which the basis function is shown to be C^k; -1 where not even continuity is shown.

    By Sobolev's embedding s2 > k + D/2 suffices; beyond that, products of the matrices above are followed until each
    has shrunk, or there are too many.

    Args:
        mask: on the regular lattice.
        order: κ, the order of its sum rules.
        regularity: what is known of it in L2.
        bound: of its Hölder exponent, beyond which nothing is tried.
    """
    shown = ceil(min(regularity.s2, 99.0) - mask.dimension / 2 - _SAME) - 1
    digits = _digit_matrices(mask, order)
    while shown + 1 < bound - _SAME and _shrink(digits, mask.dilation ** -float(shown + 1)):
        shown += 1
    return max(shown, -1)


def holder_bound(mask: RegularMask, order: int) -> float:
    """No larger than this is the Hölder exponent of the basis function of a stable scheme: from products of two."""
    digits = _digit_matrices(mask, order)
    if not digits.shape[1]:
        return inf
    # Turned round, a product has the same eigenvalues.
    pairs = np.stack([first @ second for first, second in combinations(digits, 2)])
    radius = max(_radius(digits), _radius(pairs) ** 0.5)
    return -log(radius) / log(mask.dilation) if radius else inf


def _radius(matrices: Digits) -> float:
    return float(np.abs(np.linalg.eigvals(matrices)).max())


def _digit_matrices(mask: RegularMask, order: int) -> Digits:
    """(m^D, N, N) the matrices A_ε in an orthonormal basis of the sequences that polynomials annihilate."""
    digits = np.array(list(product(range(mask.dilation), repeat=mask.dimension)), dtype=np.int64)
    offsets = mask.whole_offsets
    shifted = (offsets[:, None] - digits[None]).reshape(-1, mask.dimension)
    places = points_in_hull(shifted, mask.dilation - 1)
    free = null_space(moments(places, order))
    wanted = mask.dilation * places[:, None] - places[None]
    return np.stack([free.T @ values_at(offsets, mask.weights, wanted + digit) @ free for digit in digits])


def _shrink(digits: Digits, rate: float) -> bool:
    """Whether every long product of the matrices shrinks faster than `rate` a factor.

    Words of digits are followed only until they have: a product of any length falls into such words.
    """
    fair = _evened(digits)
    words = fair
    for length in range(1, _LONGEST + 1):
        norms = np.linalg.norm(words, ord=2, axis=(1, 2))
        words = words[norms >= (1 - _SAME) * rate**length]
        if not len(words):
            return True
        if len(words) * len(fair) > _MOST_WORDS:
            return False
        words = (words[:, None] @ fair[None]).reshape(-1, *fair.shape[1:])
    return False


def _evened(digits: Digits) -> Digits:
    """The matrices in a basis in which the Euclidean norm is nearly as small as the sum of their squares allows."""
    squares = _growth(digits)
    gram, term = np.eye(digits.shape[1]), np.eye(digits.shape[1])
    for _ in range(_SMOOTHING):
        term = np.einsum("eki,kl,elj->ij", digits, term, digits, optimize=True) / (1.05 * squares)
        gram += term
    root = np.linalg.cholesky(gram).T
    return np.asarray(root @ digits @ np.linalg.inv(root))


def _growth(digits: Digits) -> float:
    """The spectral radius of P → Σ A_ε' P A_ε, by its powers."""
    gram, rate = np.eye(digits.shape[1]), 1.0
    for _ in range(_SMOOTHING):
        gram = np.einsum("eki,kl,elj->ij", digits, gram, digits, optimize=True)
        rate = float(np.trace(gram))
        gram /= rate
    return rate
