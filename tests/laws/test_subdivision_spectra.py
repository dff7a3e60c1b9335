"""Spectra of the subdivision matrix around one extraordinary vertex, against closed forms and tabulated values.

Smoothness there requires 1 > λ1 = λ2 > all others, with λ1 in the Fourier mode 1.
"""

from math import cos, pi

import numpy as np
import pytest

from tests.laws.local_matrix import boundary_matrix, local_matrix
from tests.loops import over

VALENCES = range(3, 13)


def moduli(matrix: np.ndarray) -> np.ndarray:
    return np.sort(np.abs(np.linalg.eigvals(matrix)))[::-1]


def mode_block(matrix: np.ndarray, n: int, mode: int, rings: int = 2) -> np.ndarray:
    """The part of a local matrix that acts on values that turn by `mode` times 2π/n from spoke to spoke.

    The rings are invariant under a turn by one spoke, so that the matrix falls into one small block for each mode.
    """
    starts = [1 + n * ring * (ring - 1) // 2 for ring in range(1, rings + 1)]
    first_spoke = np.concatenate([start + np.arange(ring) for ring, start in enumerate(starts, start=1)])
    step = np.concatenate([np.full(ring, ring) for ring in range(1, rings + 1)])
    phase = np.exp(2j * pi * mode * np.arange(n) / n)
    columns = first_spoke[:, None] + step[:, None] * np.arange(n)
    block = np.einsum("rcs,s->rc", matrix[first_spoke][:, columns], phase)
    if mode:
        return block
    top = np.concatenate([[matrix[0, 0]], matrix[0][columns].sum(axis=1)])
    return np.vstack([top, np.column_stack([matrix[first_spoke, 0], block])])


def loop_ring(n: int) -> float:
    """n β(n) of Loop."""
    return 5 / 8 - (3 / 8 + cos(2 * pi / n) / 4) ** 2


def warren_ring(n: int) -> float:
    return 9 / 16 if n == 3 else 3 / 8


@over("n", VALENCES)
@over("weights, ring", [("loop", loop_ring), ("warren", warren_ring)])
def test_characteristic_polynomials_of_interpolatory_loop(n, weights, ring):
    matrix = local_matrix(n, f"interp-loop:weights={weights}")
    g = ring(n)
    radial = np.polymul([1, -1], np.array([256, 128 * g - 192, 24, -1]) / 256)
    np.testing.assert_allclose(np.poly(mode_block(matrix, n, 0)), radial, rtol=0, atol=1e-12)
    for mode in range(1, n):
        c = cos(2 * pi * mode / n)
        cubic = np.array([256, -(160 + 32 * c), 26 + 2 * c - 4 * c**2, -1]) / 256
        np.testing.assert_allclose(np.poly(mode_block(matrix, n, mode)), cubic, rtol=0, atol=1e-12)


@over("n", VALENCES)
def test_loops_closed_forms(n):
    for weights, ring in (("loop", loop_ring), ("warren", warren_ring)):
        matrix = local_matrix(n, f"loop:weights={weights}")
        for mode in range(1, n):
            assert np.isclose(moduli(mode_block(matrix, n, mode))[0], 3 / 8 + cos(2 * pi * mode / n) / 4, atol=1e-12)
        radial = np.linalg.eigvals(mode_block(matrix, n, 0))
        for value in (1, 5 / 8 - ring(n)):
            assert np.abs(radial - value).min() < 1e-12


# n: λ1 (twice), and the largest of the rest.
INTERP_LOOP = {
    4: (0.39057, 0.2604),
    5: (0.45882, 0.2547),
    6: (0.5, 0.25),
    7: (0.52637, 0.3390),
    8: (0.54414, 0.3906),
    9: (0.55662, 0.4292),
    10: (0.56571, 0.4588),
    11: (0.57251, 0.4818),
    12: (0.57774, 0.5),
}
TABLES = {
    "loop": {
        3: (0.25, 0.125),
        4: (0.375, 0.1406),
        5: (0.4523, 0.2045),
        6: (0.5, 0.25),
        7: (0.5309, 0.3194),
        8: (0.5518, 0.3750),
        9: (0.5665, 0.4184),
        10: (0.5773, 0.4523),
        11: (0.5853, 0.4789),
        12: (0.5915, 0.5),
    },
    "interp-loop": INTERP_LOOP,
    "interp-loop:valence3=zorin": {3: (0.5, 0.25)} | INTERP_LOOP,
    "interp-loop:weights=warren": {4: (0.39057, 0.25), 5: (0.45882, 0.25), 6: (0.5, 0.25), 7: (0.5264, 0.3390)},
    "interp-loop:alpha=0.25": {
        3: (0.25, 0.156),
        4: (0.378, 0.175),
        5: (0.454, 0.189),
        8: (0.55, 0.378),
        12: (0.588, 0.5),
    },
    "interp-loop:alpha=0.5": {
        3: (0.25, 0.2),
        4: (0.382, 0.207),
        5: (0.455, 0.213),
        8: (0.548, 0.382),
        12: (0.584, 0.5),
    },
    "interp-loop:alpha=0.75": {3: (0.25, 0.235), 4: (0.386, 0.235), 8: (0.546, 0.386), 12: (0.581, 0.5)},
    "interp-loop:alpha=0.25,valence3=zorin": {3: (0.3125, 0.112)},
    "interp-loop:alpha=0.5,valence3=zorin": {3: (0.375, 0.156)},
    "interp-loop:alpha=0.75,valence3=zorin": {3: (0.4375, 0.203)},
    "modified-butterfly": dict.fromkeys(VALENCES, (0.5, 0.25)),
    "butterfly": {4: (0.4690, 0.25), 5: (0.5067, 0.25), 6: (0.5, 0.25), 7: (0.4819, 0.4061)},
    "sqrt3": {
        3: (0.111, 0.041),
        4: (0.222, 0.049),
        5: (0.291, 0.085),
        6: (0.333, 0.111),
        7: (0.361, 0.173),
        8: (0.379, 0.222),
        12: (0.415, 0.333),
    },
    "lin-luo-sqrt3": {
        4: (0.240, 0.133),
        5: (0.301, 0.134),
        6: (0.333, 0.160),
        7: (0.352, 0.192),
        8: (0.363, 0.240),
        12: (0.383, 0.333),
    },
    "lin-luo-sqrt3:alpha=0.5": {
        3: (0.111, 0.078),
        4: (0.231, 0.089),
        5: (0.296, 0.096),
        7: (0.356, 0.180),
        12: (0.399, 0.333),
    },
    "interp-sqrt3": {3: (0.111, 0.020), 5: (0.291, 0.085), 6: (0.333, 0.180), 7: (0.361, 0.130), 12: (0.415, 0.172)},
}


@pytest.mark.parametrize("spec", TABLES)
@over("n", lambda spec: TABLES[spec])
def test_leading_eigenvalues(spec, n):
    leading, rest = TABLES[spec][n]
    rings = 3 if spec == "interp-sqrt3" or "lin-luo" in spec else 2
    matrix = local_matrix(n, spec, rings)
    found = moduli(matrix)
    np.testing.assert_allclose(found[:4], [1, leading, leading, rest], rtol=0, atol=6e-4)
    assert 1 > found[2] > found[3] + 0.01
    assert np.isclose(moduli(mode_block(matrix, n, 1, rings))[0], found[1], atol=1e-9)


@over("n", VALENCES)
def test_sqrt3_two_steps_in_closed_form(n):
    """Both schemes share Kobbelt's subdominant eigenvalue."""
    for spec, rings in (("sqrt3", 2), ("interp-sqrt3", 3)):
        assert np.isclose(moduli(local_matrix(n, spec, rings))[1], (2 + 2 * cos(2 * pi / n)) / 9, atol=1e-10)


@over("n", VALENCES)
def test_modified_butterfly_was_made_for_these_eigenvalues(n):
    found = moduli(local_matrix(n, "modified-butterfly"))
    # An eigenvalue of a Jordan block is found to the root of the rounding, which differs between processors.
    np.testing.assert_allclose(found[:4], [1, 1 / 2, 1 / 2, 1 / 4], rtol=0, atol=1e-5)
    assert found[4] < 0.25 + 1e-4


@over("n", [3, 8, 9, 10, 12])
def test_plain_butterfly_is_not_smooth_at_valence_3_and_from_8(n):
    """The leading pair is of mode 2 or more from 8 on; at 3 all leading eigenvalues are 1/4."""
    matrix = local_matrix(n, "butterfly")
    by_mode = [moduli(mode_block(matrix, n, mode))[0] for mode in range(1, n // 2 + 1)]
    if n == 3:
        np.testing.assert_allclose(moduli(matrix)[1:5], 0.25, rtol=0, atol=1e-5)
    else:
        assert max(by_mode[1:]) > by_mode[0]
        assert np.isclose(max(by_mode[1:]), {8: 0.4690, 9: 0.4973, 12: 0.5}.get(n, max(by_mode)), atol=1e-4)


def test_interpolatory_loop_fails_at_valence_3_from_alpha_0_8636_on():
    """The radial mode has a complex pair, 0.2069 ± 0.168i at α = 1, that outgrows the leading 1/4."""
    radial = np.linalg.eigvals(mode_block(local_matrix(3, "interp-loop"), 3, 0))
    pair = radial[np.abs(radial.imag) > 1e-3]
    assert len(pair) == 2
    np.testing.assert_allclose(pair.real + 1j * np.abs(pair.imag), 0.2069 + 0.168j, atol=6e-4)
    for alpha, smooth in ((0.5, True), (0.863, True), (0.8636, True), (0.8637, False), (0.9, False), (1, False)):
        matrix = local_matrix(3, f"interp-loop:alpha={alpha}")
        leading, second = moduli(mode_block(matrix, 3, 1))[0], moduli(mode_block(matrix, 3, 0))[1]
        assert np.isclose(leading, 0.25, atol=1e-6)
        assert (second < 0.25) == smooth


def test_unified_sqrt3_fails_at_valence_3_from_alpha_0_7992_on():
    """Of two steps: a pair of the radial mode outgrows the leading 1/9, which α leaves alone."""
    for alpha, smooth in ((0, True), (0.5, True), (0.799, True), (0.7995, False), (0.9, False), (1, False)):
        matrix = local_matrix(3, f"lin-luo-sqrt3:alpha={alpha}", 3)
        leading, second = moduli(mode_block(matrix, 3, 1, 3))[0], moduli(mode_block(matrix, 3, 0, 3))[1]
        assert np.isclose(leading, 1 / 9, atol=1e-9)
        assert (second < 1 / 9) == smooth


@pytest.mark.parametrize(
    ("spec", "neighbours", "expected"),
    [
        ("interp-loop", 2, [1, 0.5, 0.25, 0.25]),
        ("interp-loop", 3, [1, 0.5, 0.391, 0.25]),
        ("interp-loop", 4, [1, 0.5, 0.5, 0.25]),
        ("interp-loop", 5, [1, 0.544, 0.5, 0.391]),
        ("interp-loop", 6, [1, 0.566, 0.5, 0.459]),
        ("interp-loop", 7, [1, 0.578, 0.5, 0.5]),
        ("loop", 7, [1, 0.592, 0.5, 0.5]),
        *[("loop", k, sorted([1, 0.5, 3 / 8 + cos(pi / (k - 1)) / 4], reverse=True)) for k in (3, 4, 5, 6)],
    ],
)
def test_boundary_vertex(spec, neighbours, expected):
    np.testing.assert_allclose(moduli(boundary_matrix(neighbours, spec))[: len(expected)], expected, atol=6e-4)
