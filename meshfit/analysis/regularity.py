"""Regularity of the basis function on the regular lattice: Sobolev exponent, stability, Hölder bound, continuity.

All are computed from operators on finite sequences on a lattice that annihilate polynomials.
"""

from dataclasses import dataclass
from itertools import combinations, product
from math import ceil, inf, log

import numpy as np
from jaxtyping import Float64, Int64
from numpy.polynomial.chebyshev import chebvander
from scipy.signal import correlate
from scipy.spatial import ConvexHull

from meshfit.analysis.regular_lattice import RegularMask

Digits = Float64[np.ndarray, "E N N"]
Zero = tuple[Float64[np.ndarray, " D"], int]
"""A frequency, and the order to which the periodisation vanishes there."""

_TOLERANCE = 1e-9
_ZERO = 1e-9
_SAME = 1e-6
_HIGHEST = 24
_GRID = 72
_MOST_WORDS = 40_000
_LONGEST = 8
_SMOOTHING = 60


def points_in_hull(offsets: Int64[np.ndarray, "B D"], part: int) -> Int64[np.ndarray, "P D"]:
    """Return the (P, D) integer points in the convex hull of offsets, shrunk by `part`; it contains the origin."""
    low, high = offsets.min(axis=0), offsets.max(axis=0)
    spans = (range(-(-int(a) // part), int(b) // part + 1) for a, b in zip(low, high, strict=True))
    box = np.array(list(product(*spans)), dtype=np.int64)
    if offsets.shape[1] == 1:
        return box
    walls = ConvexHull(offsets).equations
    beyond = box * part @ walls[:, :-1].T + walls[:, -1]
    return np.asarray(box[(beyond < _TOLERANCE * np.abs(offsets).max()).all(axis=1)])


def values_at(
    offsets: Int64[np.ndarray, "B D"], values: Float64[np.ndarray, " B"], wanted: Int64[np.ndarray, "*N D"]
) -> Float64[np.ndarray, "*N"]:
    """Return the values of a sequence at other places, 0 outside its offsets."""
    low, span = offsets.min(axis=0), np.ptp(offsets, axis=0)
    dense = np.zeros(span + 1)
    dense[tuple((offsets - low).T)] = values
    index = wanted - low
    inside = ((index >= 0) & (index <= span)).all(axis=-1)
    return np.where(inside, dense[tuple(np.moveaxis(index.clip(0, span), -1, 0))], 0.0)


def moments(places: Int64[np.ndarray, "P D"], order: int) -> Float64[np.ndarray, "M P"]:
    """Return the (M, P) values of products of Chebyshev polynomials that span polynomials of degree below `order`."""
    scaled = places / max(1, int(np.abs(places).max()))
    along = chebvander(scaled, max(0, order - 1))
    powers = [power for power in product(range(order), repeat=places.shape[1]) if sum(power) < order]
    rows = [np.prod([along[:, axis, degree] for axis, degree in enumerate(power)], axis=0) for power in powers]
    return np.array(rows).reshape(-1, len(places))


def null_space(rows: Float64[np.ndarray, "M O"]) -> Float64[np.ndarray, "O N"]:
    """(O, N) an orthonormal basis, as columns, of what all rows annihilate."""
    _, singular, right = np.linalg.svd(rows)
    rank = int((singular > _TOLERANCE * max(1.0, singular[0])).sum())
    return right[rank:].T


def waves(
    places: Int64[np.ndarray, "P D"], frequency: Float64[np.ndarray, " D"], order: int
) -> Float64[np.ndarray, "M P"]:
    """Return the (M, P) values of polynomials of degree below `order` times cosine and sine of a frequency.

    The symbol of a sequence that they annihilate vanishes to that order at the frequency.
    """
    phase, powers = places @ frequency, moments(places, order)
    return np.concatenate([powers * np.cos(phase), powers * np.sin(phase)])


def order_of_zero(
    places: Int64[np.ndarray, "P D"], sequence: Float64[np.ndarray, " P"], frequency: Float64[np.ndarray, " D"]
) -> int:
    """Return the order to which the symbol of a sequence vanishes at a frequency, 0 if it does not."""
    size = np.abs(sequence).sum()
    for order in range(1, _HIGHEST + 1):
        if np.abs(waves(places, frequency, order) @ sequence).max() > _TOLERANCE * size:
            return order - 1
    return _HIGHEST


def zeros_of_periodisation(
    transition: Float64[np.ndarray, "O O"], orbits: Float64[np.ndarray, "P O"], places: Int64[np.ndarray, "P D"]
) -> list[Zero]:
    """Return the zeros of the periodisation among the frequencies 2π k / 72.

    These include the zeros of all masks that are products of differences.

    Args:
        transition: the operator on symmetric sequences; if it has eigenvalues larger than 1, no zeros are returned.
        orbits: the basis of these sequences.
        places: of the sequences.
    """
    values, vectors = np.linalg.eig(transition)
    if np.abs(values).max() > 1 + _ZERO:
        return []
    sequence = np.real(orbits @ vectors[:, np.argmin(np.abs(values - 1))])
    sequence /= sequence.sum()
    turns = np.arange(_GRID) * (2 * np.pi / _GRID)
    grid = np.array(list(product(turns, repeat=places.shape[1])))
    zeros = grid[np.abs(np.cos(grid @ places.T) @ sequence) < _ZERO]
    return [(frequency, order_of_zero(places, sequence, frequency)) for frequency in zeros]


@dataclass(frozen=True)
class Regularity:
    """Regularity of the basis function in L2.

    Attributes:
        s2: its exponent: it has s derivatives in L2 for every s < s2.
        accuracy: the order up to which polynomials are combinations of its shifts; the order of the sum rules if these
            are stable.
        stable: whether its shifts are stable: no bounded combination of them is zero.
    """

    s2: float
    accuracy: int
    stable: bool


def regularity_of(mask: RegularMask) -> Regularity:
    """Compute the Sobolev exponent, the accuracy and the stability.

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
    """Return half the smallest order to which b and the periodisation together vanish at 2πk / m, k not 0.

    T preserves a zero of a symbol at 0 up to that order. Without zeros of the periodisation it is the order of the sum
    rules.
    """
    turns = 2 * np.pi / dilation * np.arange(dilation)
    frequencies = np.array(list(product(turns, repeat=offsets.shape[1])))[1:]
    orders = []
    for frequency in frequencies:
        own = [order for zero, order in zeros if np.allclose(zero, frequency)]
        orders.append(order_of_zero(offsets, values, frequency) + sum(own))
    return min(orders) // 2


def _autocorrelation(mask: RegularMask) -> tuple[Int64[np.ndarray, "B D"], Float64[np.ndarray, " B"]]:
    """Return the offsets and values of b."""
    whole = mask.whole_offsets
    corner = whole - whole.min(axis=0)
    dense = np.zeros(corner.max(axis=0) + 1)
    dense[tuple(corner.T)] = mask.weights
    both = correlate(dense, dense, method="direct") / mask.dilation**mask.dimension
    kept = np.abs(both) > _TOLERANCE * np.abs(both).max()
    return np.argwhere(kept) - np.array(dense.shape) + 1, both[kept]


def _symmetries(offsets: Int64[np.ndarray, "B D"], values: Float64[np.ndarray, " B"]) -> list[Int64[np.ndarray, "D D"]]:
    """Return the linear maps of the lattice, with entries -1, 0 and 1, under which b is invariant."""
    dimension = offsets.shape[1]
    maps = (np.array(entries).reshape(dimension, dimension) for entries in product((-1, 0, 1), repeat=dimension**2))
    return [
        linear
        for linear in maps
        if abs(round(np.linalg.det(linear))) == 1
        and np.abs(values_at(offsets, values, offsets @ linear.T) - values).max() < _TOLERANCE
    ]


def _orbits(places: Int64[np.ndarray, "P D"], symmetries: list[Int64[np.ndarray, "D D"]]) -> Float64[np.ndarray, "P O"]:
    """Return a (P, O) orthonormal basis of the sequences on these places that all symmetries leave invariant."""
    images = np.stack([places @ symmetry.T for symmetry in symmetries], axis=1)
    span = 2 * np.abs(places).max() + 1
    keys = (images * span ** np.arange(places.shape[1])).sum(axis=2).min(axis=1)
    _, orbit = np.unique(keys, return_inverse=True)
    member = (orbit.reshape(-1)[:, None] == np.arange(orbit.max() + 1)).astype(np.float64)
    return np.asarray(member / np.linalg.norm(member, axis=0))


def continuity(mask: RegularMask, order: int, regularity: Regularity, bound: float) -> int:
    """Return the largest k for which the basis function is shown to be C^k; -1 if not even continuity is.

    By Sobolev embedding s2 > k + D/2 suffices. Beyond that, products of the digit matrices are followed until each has
    shrunk, or there are too many.

    Args:
        mask: on the regular lattice.
        order: κ, the order of its sum rules.
        regularity: in L2.
        bound: of its Hölder exponent; larger k are not tried.
    """
    shown = ceil(min(regularity.s2, 99.0) - mask.dimension / 2 - _SAME) - 1
    digits = _digit_matrices(mask, order)
    while shown + 1 < bound - _SAME and _shrink(digits, mask.dilation ** -float(shown + 1)):
        shown += 1
    return max(shown, -1)


def holder_bound(mask: RegularMask, order: int) -> float:
    """Return an upper bound of the Hölder exponent of a stable scheme, from products of two digit matrices."""
    digits = _digit_matrices(mask, order)
    if not digits.shape[1]:
        return inf
    # AB and BA have the same eigenvalues.
    pairs = np.stack([first @ second for first, second in combinations(digits, 2)])
    radius = max(_radius(digits), _radius(pairs) ** 0.5)
    return -log(radius) / log(mask.dilation) if radius else inf


def _radius(matrices: Digits) -> float:
    return float(np.abs(np.linalg.eigvals(matrices)).max())


def _digit_matrices(mask: RegularMask, order: int) -> Digits:
    """Return the (m^D, N, N) matrices A_ε in an orthonormal basis of the sequences that annihilate polynomials."""
    digits = np.array(list(product(range(mask.dilation), repeat=mask.dimension)), dtype=np.int64)
    offsets = mask.whole_offsets
    shifted = (offsets[:, None] - digits[None]).reshape(-1, mask.dimension)
    places = points_in_hull(shifted, mask.dilation - 1)
    free = null_space(moments(places, order))
    wanted = mask.dilation * places[:, None] - places[None]
    return np.stack([free.T @ values_at(offsets, mask.weights, wanted + digit) @ free for digit in digits])


def _shrink(digits: Digits, rate: float) -> bool:
    """Return whether every long product of the matrices shrinks faster than by `rate` per factor.

    Words of digits are followed only until they have shrunk, since any longer product consists of such words.
    """
    balanced = _balanced(digits)
    words = balanced
    for length in range(1, _LONGEST + 1):
        norms = np.linalg.norm(words, ord=2, axis=(1, 2))
        words = words[norms >= (1 - _SAME) * rate**length]
        if not len(words):
            return True
        if len(words) * len(balanced) > _MOST_WORDS:
            return False
        words = (words[:, None] @ balanced[None]).reshape(-1, *balanced.shape[1:])
    return False


def _balanced(digits: Digits) -> Digits:
    """Return the matrices in a basis in which their Euclidean norms are nearly minimal for the sum of their squares."""
    squares = _growth(digits)
    gram, term = np.eye(digits.shape[1]), np.eye(digits.shape[1])
    for _ in range(_SMOOTHING):
        term = np.einsum("eki,kl,elj->ij", digits, term, digits, optimize=True) / (1.05 * squares)
        gram += term
    root = np.linalg.cholesky(gram).T
    return np.asarray(root @ digits @ np.linalg.inv(root))


def _growth(digits: Digits) -> float:
    """Return the spectral radius of P → Σ A_ε' P A_ε, by power iteration."""
    gram, rate = np.eye(digits.shape[1]), 1.0
    for _ in range(_SMOOTHING):
        gram = np.einsum("eki,kl,elj->ij", digits, gram, digits, optimize=True)
        rate = float(np.trace(gram))
        gram /= rate
    return rate
