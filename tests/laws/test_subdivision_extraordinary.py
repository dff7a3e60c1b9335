"""The weights at interior vertices of valence other than 6, from the published formulas, on disks around one."""

from math import cos, pi

import numpy as np
import pytest

from tests.laws.variants import dense
from tests.loops import over
from tests.shapes import wheel

VALENCES = (3, 4, 5, 7, 8, 12)
by_valence = over("n", VALENCES)


def spokes_of(n: int) -> np.ndarray:
    """Verts around the centre of a wheel, counter-clockwise."""
    return np.arange(1, n + 1)


def row_from(n: int, size: int, centre: float, ring) -> np.ndarray:
    row = np.zeros(size)
    row[0], row[spokes_of(n)] = centre, ring
    return row


def loop_beta(n: int) -> float:
    """The weight of each neighbour."""
    return (5 / 8 - (3 / 8 + cos(2 * pi / n) / 4) ** 2) / n


def warren_beta(n: int) -> float:
    return 3 / 16 if n == 3 else 3 / (8 * n)


def kobbelt_beta(n: int) -> float:
    return (4 - 2 * cos(2 * pi / n)) / (9 * n)


@pytest.mark.parametrize(
    ("spec", "beta"),
    [
        ("loop", loop_beta),
        ("loop:weights=warren", warren_beta),
        ("sqrt3", kobbelt_beta),
        ("lin-luo-sqrt3:alpha=0.25", lambda n: 0.75 * kobbelt_beta(n)),
        ("interp-loop:alpha=0.25", lambda n: 0.75 * loop_beta(n)),
        ("interp-loop:alpha=0.5,weights=warren", lambda n: 0.5 * warren_beta(n)),
    ],
)
@by_valence
def test_vertex_rule(n, spec, beta):
    matrix = dense(wheel(n), spec)
    expected = row_from(n, matrix.shape[1], 1 - n * beta(n), beta(n))
    np.testing.assert_allclose(matrix[0], expected, rtol=0, atol=1e-15)


def zorin_weights(n: int) -> list[float]:
    """Zorin, Schröder and Sweldens; the first goes to the other end of the edge."""
    special = {3: [5 / 12, -1 / 12, -1 / 12], 4: [3 / 8, 0, -1 / 8, 0]}
    return special.get(n) or [(1 / 4 + cos(2 * pi * j / n) + cos(4 * pi * j / n) / 2) / n for j in range(n)]


def labsik_greiner_weights(n: int) -> tuple[float, list[float]]:
    """Centre, then the ring; the first two go to the other corners of the face."""
    if n == 3:
        return 8 / 9, [4 / 27, 4 / 27, -5 / 27]
    if n == 4:
        return 7 / 9, [2 / 9, 2 / 9, -1 / 9, -1 / 9]
    a = 2 * cos(pi / n) / 3
    angles = [2 * pi * i / n - pi / n for i in range(n)]
    return 1 - a**2, [(a**2 + 2 * a * cos(t) + 2 * a**2 * cos(2 * t)) / n for t in angles]


def count_of_row(matrix: np.ndarray, row: np.ndarray) -> int:
    return int((np.abs(matrix - row).max(axis=1) < 1e-14).sum())


@by_valence
def test_modified_butterfly_spokes(n):
    matrix = dense(wheel(n), "modified-butterfly")
    for spoke in range(n):
        expected = row_from(n, matrix.shape[1], 3 / 4, np.roll(zorin_weights(n), spoke))
        assert count_of_row(matrix, expected) == 1


@by_valence
def test_interpolatory_sqrt3_spokes(n):
    matrix = dense(wheel(n), "interp-sqrt3")
    centre, ring = labsik_greiner_weights(n)
    for spoke in range(n):
        expected = row_from(n, matrix.shape[1], centre, np.roll(ring, spoke))
        assert count_of_row(matrix, expected) == 1


def loop_edge_row(n: int, size: int, spoke: int) -> np.ndarray:
    """Loop's edge rule at the edge from the centre to a neighbour."""
    ring = np.zeros(n)
    ring[spoke], ring[[spoke - 1, (spoke + 1) % n]] = 3 / 8, 1 / 8
    return row_from(n, size, 3 / 8, ring)


def displacement_row(matrix_of_loop: np.ndarray, vert: int) -> np.ndarray:
    return np.eye(matrix_of_loop.shape[1])[vert] - matrix_of_loop[vert]


@over("alpha", [0.25, 0.5, 1])
@over("weights", ["loop", "warren"])
@by_valence
def test_interpolatory_loop_spokes(n, alpha, weights):
    """Loop's edge vertex plus half of α times the displacement of both ends."""
    loop = dense(wheel(n), f"loop:weights={weights}")
    matrix = dense(wheel(n), f"interp-loop:alpha={alpha},weights={weights}")
    for spoke in range(n):
        displaced = displacement_row(loop, 0) + displacement_row(loop, 1 + spoke)
        expected = loop_edge_row(n, matrix.shape[1], spoke) + alpha / 2 * displaced
        assert count_of_row(matrix, expected) == 1


@over("alpha", [0.5, 1])
@by_valence
def test_valence_3_safeguard_blends_towards_modified_butterfly_there_and_only_there(n, alpha):
    pure = dense(wheel(n), f"interp-loop:alpha={alpha}")
    safe = dense(wheel(n), f"interp-loop:alpha={alpha},valence3=zorin")
    changed = np.flatnonzero(np.abs(pure - safe).max(axis=1) > 1e-14)
    assert len(changed) == (3 if n == 3 else 0)
    for spoke in range(3 if n == 3 else 0):
        towards = row_from(3, safe.shape[1], 3 / 4, np.roll(zorin_weights(3), spoke))
        expected = (1 - alpha) * loop_edge_row(3, safe.shape[1], spoke) + alpha * towards
        assert count_of_row(safe[changed], expected) == 1


@pytest.mark.parametrize(("spec", "end", "opposite"), [("loop", 3 / 8, 1 / 8), ("midpoint", 1 / 2, 0)])
@by_valence
def test_schemes_of_one_edge_rule_use_it_at_any_valence(n, spec, end, opposite):
    matrix = dense(wheel(n), spec)
    for spoke in range(n):
        ring = np.zeros(n)
        ring[spoke], ring[[spoke - 1, (spoke + 1) % n]] = end, opposite
        assert count_of_row(matrix, row_from(n, matrix.shape[1], end, ring)) == 1


@by_valence
def test_plain_butterfly_wings_coincide_at_small_valences(n):
    """Entries for the same vertex add up: at valence 3 both near wings are the third neighbour, at 4 the far one."""
    matrix = dense(wheel(n), "butterfly")
    ring = np.zeros(n)
    for step, weight in ((0, 1 / 2), (1, 1 / 8), (-1, 1 / 8), (2, -1 / 16), (-2, -1 / 16)):
        ring[step % n] += weight
    spokes = [np.roll(ring, spoke) for spoke in range(n)]
    inner = np.r_[0 : n + 1]
    for spoke in spokes:
        part = np.concatenate([[1 / 2], spoke])
        assert (np.abs(matrix[:, inner] - part).max(axis=1) < 1e-14).sum() == 1
