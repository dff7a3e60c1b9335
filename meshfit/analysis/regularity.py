"""Finite sequences on a lattice: where they live, and which of them polynomials annihilate."""

from dataclasses import dataclass
from itertools import combinations, product
from math import ceil, inf, log

import numpy as np
from jaxtyping import Float64, Int64
from numpy.polynomial.chebyshev import chebvander
from scipy.signal import correlate
from scipy.spatial import ConvexHull

from meshfit.analysis.regular_lattice import RegularMask

_TOLERANCE = 1e-9
_HIGHEST = 24


def points_in_hull(offsets: Int64[np.ndarray, "B D"], part: int) -> Int64[np.ndarray, "P D"]:
    """(P, D) the integer points of the convex hull of some, made `part` times smaller; the hull holds the origin."""
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
    """(…) those of a sequence at other places, 0 where it has none."""
    low, span = offsets.min(axis=0), np.ptp(offsets, axis=0)
    dense = np.zeros(span + 1)
    dense[tuple((offsets - low).T)] = values
    there = wanted - low
    inside = ((there >= 0) & (there <= span)).all(axis=-1)
    return np.where(inside, dense[tuple(np.moveaxis(there.clip(0, span), -1, 0))], 0.0)


def moments(places: Int64[np.ndarray, "P D"], order: int) -> Float64[np.ndarray, "M P"]:
    """(M, P) the values of polynomials that span those of degree below `order`, as rows: products of Chebyshev's."""
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
    """(M, P) all monomials of degree below `order` times the cosine and the sine of a frequency, as rows.

    A sequence that they annihilate has a symbol that vanishes to that order at the frequency.
    """
    phase, powers = places @ frequency, moments(places, order)
    return np.concatenate([powers * np.cos(phase), powers * np.sin(phase)])


def order_of_zero(
    places: Int64[np.ndarray, "P D"], sequence: Float64[np.ndarray, " P"], frequency: Float64[np.ndarray, " D"]
) -> int:
    """The order to which the symbol of a sequence vanishes at a frequency, 0 where it does not."""
    size = np.abs(sequence).sum()
    for order in range(1, _HIGHEST + 1):
        if np.abs(waves(places, frequency, order) @ sequence).max() > _TOLERANCE * size:
            return order - 1
    return _HIGHEST


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
