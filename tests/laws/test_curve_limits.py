"""Smoothness of curves: polynomials reproduced, spectra in closed form, and differences that contract."""

from math import sqrt

import numpy as np
import pytest

from tests.curve_shapes import arity, rows_along

DEGREE = {
    "cubic-bspline": 1,
    "four-point": 3,
    "four-point:tension=0": 1,
    "four-point:tension=0.05": 1,
    "four-point:tension=0.125": 1,
    "interp-bspline": 3,
    "interp-bspline:alpha=0": 1,
    "interp-bspline:alpha=0.5": 1,
    "ternary-bspline": 1,
    "ternary-four-point": 3,
}
SIZE = 14


@pytest.mark.parametrize(("spec", "highest"), DEGREE.items())
def test_reproduction_of_polynomials(spec, highest):
    rows = rows_along(spec, SIZE, closed=False)
    coarse = np.arange(SIZE) - 6.5
    fine = np.linspace(coarse[0], coarse[-1], len(rows))
    inside = np.abs(fine) < 5
    for degree in range(highest + 2):
        error = np.abs(rows @ coarse**degree - fine**degree)[inside].max()
        assert error < 1e-11 if degree <= highest else error > 1e-3


def local(spec: str, reach: int) -> np.ndarray:
    """How the fine verts nearest to a vertex follow from as many coarse ones, so many to each side."""
    rows = rows_along(spec, SIZE, closed=False)
    at = SIZE // 2
    near = rows[at * arity(spec) - reach : at * arity(spec) + reach + 1]
    columns = np.arange(at - reach, at + reach + 1)
    assert not np.delete(near, columns, axis=1).any(), "the reach does not suffice"
    return near[:, columns]


def four_point_spectrum(w: float) -> list[complex]:
    root = complex(1 - 16 * w) ** 0.5
    return [1, 1 / 2, 2 * w, (1 + root) / 4, (1 - root) / 4]


SPECTRA = {
    "cubic-bspline": (1, [1, 1 / 2, 1 / 4]),
    "four-point": (2, [1, 1 / 2, 1 / 4, 1 / 4, 1 / 8]),
    **{f"four-point:tension={w}": (2, four_point_spectrum(w)) for w in (0.0, 0.01, 0.05, 0.1, 0.15)},
    **{f"interp-bspline:alpha={a}": (2, [1, 1 / 2, 1 / 4, 1 / 8, (1 + a) / 8]) for a in (0.0, 0.3, 0.5, 0.9, 1.0)},
    "ternary-bspline": (1, [1, 1 / 3, 1 / 9]),
    "ternary-four-point": (2, [1, 1 / 3, 11 / 81, 1 / 9, 1 / 27]),
}


@pytest.mark.parametrize("spec", SPECTRA)
def test_spectra(spec):
    """By the characteristic polynomial, since a double eigenvalue is found to the root of the rounding only."""
    reach, expected = SPECTRA[spec]
    np.testing.assert_allclose(np.poly(local(spec, reach)), np.poly(expected), rtol=0, atol=1e-14)


def symbol(spec: str) -> np.ndarray:
    """What one vertex gives to the fine verts around it, in their order."""
    column = rows_along(spec, SIZE, closed=False)[:, SIZE // 2]
    touched = np.flatnonzero(np.abs(column) > 1e-15)
    return column[touched[0] : touched[-1] + 1]


def spread(mask: np.ndarray, step: int) -> np.ndarray:
    """The coefficients of the symbol at z to that power."""
    out = np.zeros((len(mask) - 1) * step + 1)
    out[::step] = mask
    return out


def contracts(spec: str, order: int, most: int = 9) -> bool:
    """Whether some levels shrink the differences of the divided differences of that order, so that limits are C^order.

    Dyn 1992, Subdivision schemes in computer-aided geometric design: with p parts and σ = 1 + … + z^(p-1), the
    differences are refined by p^order a(z) / σ^(order + 1).
    """
    parts = arity(spec)
    mask = symbol(spec) * parts**order
    for _ in range(order + 1):
        mask, rest = np.polydiv(mask, np.ones(parts))
        assert np.abs(rest).max() < 1e-14
    level, step = mask, parts
    for _ in range(most):
        if max(np.abs(level[start::step]).sum() for start in range(step)) < 1 - 1e-12:
            return True
        level, step = np.convolve(spread(level, parts), mask), step * parts
    return False


GOLDEN = (sqrt(5) - 1) / 8
SMOOTH = {
    "cubic-bspline": 2,
    **{f"four-point:tension={w}": 1 for w in (0.005, 0.03, 0.0625, 0.1, 0.15, 0.999 * GOLDEN)},
    **{f"interp-bspline:alpha={a}": 2 for a in (0.0, 0.25, 0.5, 0.75, 0.99)},
    "interp-bspline": 1,
    "ternary-bspline": 2,
    "ternary-four-point": 1,
}


@pytest.mark.parametrize("spec", SMOOTH)
def test_limits_are_as_smooth_as_the_table_says(spec):
    for order in range(SMOOTH[spec] + 1):
        assert contracts(spec, order)


@pytest.mark.parametrize("spec", SMOOTH)
def test_and_no_smoother(spec):
    """A limit is C2 only if second differences shrink as those of x², by 1/p², and all else shrinks faster."""
    parts = arity(spec)
    found = np.sort(np.abs(np.linalg.eigvals(local(spec, 2))))[::-1]
    like_polynomials = np.allclose(found[:3], [1, 1 / parts, 1 / parts**2], rtol=0, atol=1e-6)
    assert (like_polynomials and found[3] < 1 / parts**2 - 1e-4) == (SMOOTH[spec] == 2)


def test_without_tension_there_are_corners():
    assert contracts("four-point:tension=0", 0)
    assert not contracts("four-point:tension=0", 1)
