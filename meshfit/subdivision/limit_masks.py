"""Limit masks of Loop subdivision at one vertex: weights of itself, then of its neighbours counter-clockwise.

All are left eigenvectors of the matrix that refines a vertex and its ring: of eigenvalue 1 for the limit position, of
the two that follow for a pair of tangents.
"""

from math import cos, pi

import numpy as np
from jaxtyping import Float64

Tangents = Float64[np.ndarray, "2 K"]


def smooth_tangents(n: int) -> Tangents:
    """At an inner vertex of valence n: cosines and sines of its spokes (Hoppe et al. 1994)."""
    angles = 2 * pi * np.arange(n) / n
    return np.stack([np.append(0.0, np.cos(angles)), np.append(0.0, np.sin(angles))])


def open_tangents(k: int) -> Tangents:
    """Along and across a boundary or crease, on the side of k neighbours of which the first and last lie on it.

    With θ = π / (k - 1) and the eigenvalue λ = 3/8 + cos(θ) / 4, the neighbours between have sin(iθ) across, their sum
    being s; the two on the curve have w = ((3/4 - λ) sin θ - 3/8 s) / (8 (λ - 1/2) (3/4 - λ) + 1), and the vertex
    8 (λ - 1/2) w - sin θ.
    """
    along, across = np.zeros(k + 1), np.zeros(k + 1)
    along[[1, -1]] = 1.0, -1.0
    if k == 2:
        across[:] = -2.0, 1.0, 1.0
        return np.stack([along, across])
    turn = pi / (k - 1)
    eigenvalue = 3 / 8 + cos(turn) / 4
    between = np.sin(turn * np.arange(1, k - 1))
    end = ((3 / 4 - eigenvalue) * between[0] - 3 / 8 * between.sum()) / (
        8 * (eigenvalue - 1 / 2) * (3 / 4 - eigenvalue) + 1
    )
    across[:] = 8 * (eigenvalue - 1 / 2) * end - between[0], end, *between, end
    return np.stack([along, across])


def dart_masks(n: int, ring: float) -> Float64[np.ndarray, "3 K"]:
    """Of an inner vertex at which one crease ends, along its first spoke: limit position, and two tangents.

    The midpoint on the sharp edge moves the limit from where it would be if all spokes were smooth. The tangent across
    stays that of sines; the position and the tangent along are even in the spokes, and found among the eigenvectors
    that are.

    Args:
        n: its valence.
        ring: what the vertex rule gives to the ring's mean.
    """
    even = np.zeros((n + 1, n // 2 + 2))
    even[0, 0] = 1.0
    for spoke in range(n):
        even[1 + spoke, 1 + min(spoke, n - spoke)] = 1.0
    even /= np.linalg.norm(even, axis=0)
    values, vectors = np.linalg.eig(even.T @ _dart_matrix(n, ring).T @ even)
    position, along = (even @ vectors.T[np.argsort(-values.real)[:2]].real.T).T
    _, across = smooth_tangents(n)
    return np.stack([position / position.sum(), along * np.sign(along[1]), across])


def _dart_matrix(n: int, ring: float) -> Float64[np.ndarray, "K K"]:
    """What one level makes of the vertex and its ring."""
    matrix = np.zeros((n + 1, n + 1))
    matrix[0] = 1 - ring, *[ring / n] * n
    for spoke in range(1, n):
        matrix[1 + spoke, [0, 1 + spoke]] = 3 / 8
        for wing in (spoke - 1, (spoke + 1) % n):
            matrix[1 + spoke, 1 + wing] += 1 / 8
    matrix[1, :2] = 1 / 2
    return matrix
