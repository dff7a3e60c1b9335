"""Finite sequences on a lattice: where they live, and which of them polynomials annihilate."""

from itertools import product

import numpy as np
from jaxtyping import Float64, Int64
from numpy.polynomial.chebyshev import chebvander
from scipy.spatial import ConvexHull

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
