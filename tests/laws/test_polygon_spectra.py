"""Eigenvalues around one extraordinary vertex in quads: against closed forms, and in the order for smoothness."""

from math import cos, pi, sqrt

import numpy as np
import pytest

from tests.laws.polygon_matrix import mode_block, moduli, quad_matrix
from tests.laws.polygon_variants import dense
from tests.loops import over
from tests.quads import prism

VALENCES = (3, 4, 5, 6, 7, 8, 9, 10, 11, 12)
RINGS = {"catmull-clark": 1, "sqrt2": 2, "kobbelt": 2, "interp-catmull-clark": 2, "interp-sqrt2": 4}


def split_by_mode(n, spec):
    """The leading pair, and the largest of all the rest but for the 1."""
    matrix = quad_matrix(n, spec, RINGS[spec.partition(":")[0]])
    first = moduli(mode_block(matrix, n, 1))
    radial = moduli(mode_block(matrix, n, 0))
    higher = [moduli(mode_block(matrix, n, mode))[0] for mode in range(2, n // 2 + 1)]
    assert np.isclose(radial[0], 1, atol=1e-12)
    return first[0], max([first[1], radial[1], *higher])


@over("n", (2, *VALENCES))
def test_catmull_clarks_leading_eigenvalue(n):
    c = cos(2 * pi / n)
    leading, _ = split_by_mode(n, "catmull-clark")
    assert np.isclose(leading, (5 + c + cos(pi / n) * sqrt(2 * (9 + c))) / 16, rtol=0, atol=1e-12)


# To the digits that an independent computation gave, of one step, or of two for √2 schemes.
TABLE = {
    "catmull-clark": {3: (0.4101, None), 4: (0.5, 0.25), 5: (0.55, None), 12: (0.6348, None)},
    "kobbelt": {3: (0.426, 0.25), 5: (0.538, 0.362), 6: (0.560, 0.426), 8: (0.582, 0.5), 12: (0.599, 0.560)},
    "sqrt2": {3: (0.408, 0.25), 4: (0.5, 0.25), 5: (0.551, 0.338), 8: (0.614, 0.5)},
    "interp-sqrt2": {3: (0.416, 0.364), 4: (0.5, 0.364), 5: (0.545, 0.364), 8: (0.597, 0.5)},
}


@pytest.mark.parametrize("spec", TABLE)
@over("n", lambda spec: TABLE[spec])
def test_eigenvalues(spec, n):
    leading, rest = split_by_mode(n, spec)
    expected, others = TABLE[spec][n]
    assert np.isclose(leading, expected, rtol=0, atol=6e-4)
    assert others is None or np.isclose(rest, others, rtol=0, atol=6e-4)


@pytest.mark.parametrize("spec", [*RINGS, "interp-catmull-clark:alpha=0.5", "interp-sqrt2:alpha=0.5"])
@over("n", VALENCES)
def test_a_leading_pair_alone_comes_after_the_one(spec, n):
    leading, rest = split_by_mode(n, spec)
    assert rest < leading < 1


@pytest.mark.parametrize("spec", [*RINGS, "interp-catmull-clark:alpha=0.5", "interp-sqrt2:alpha=0.5"])
def test_at_valence_2_the_surface_is_continuous_without_a_leading_pair(spec):
    """The modes around the vertex are 0 and 1 alone, and both are real, so that no tangent plane is spanned."""
    values = moduli(quad_matrix(2, spec, RINGS[spec.partition(":")[0]]))
    assert np.isclose(values[0], 1, atol=1e-12)
    assert values[1] < 0.4


@over("n", VALENCES)
def test_doo_sabin_around_a_face(n):
    """1, then 1/2 twice, then 1/4: the new corners of a face follow from its old ones alone."""
    rows = dense(prism(n), "doo-sabin")[n : 2 * n]
    face = rows[:, n:]
    assert not rows[:, :n].any()
    np.testing.assert_allclose(moduli(face), [1, 0.5, 0.5, *[0.25] * (n - 3)], rtol=0, atol=1e-12)
