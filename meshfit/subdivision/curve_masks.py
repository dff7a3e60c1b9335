"""The rules along curves, each declared once: of the schemes on curves, and of the boundaries of those on surfaces."""

from fractions import Fraction

from meshfit.subdivision.masks import CurveMask, CurveWeights

KEPT: CurveWeights = {0: Fraction(1)}
LINEAR = CurveMask(KEPT, ({0: Fraction(1, 2), 1: Fraction(1, 2)},))
CUBIC_BSPLINE = CurveMask({-1: Fraction(1, 8), 0: Fraction(6, 8), 1: Fraction(1, 8)}, LINEAR.inserted)


def four_point(tension: Fraction) -> CurveMask:
    """Dyn, Levin and Gregory 1987, A 4-point interpolatory subdivision scheme for curve design."""
    near = Fraction(1, 2) + tension
    return CurveMask(KEPT, ({-1: -tension, 0: near, 1: near, 2: -tension},))


def _ternary(vert: CurveWeights, first: CurveWeights) -> CurveMask:
    """A curve rule with two vertices an edge, the second the mirror of the first."""
    return CurveMask(vert, (first, {1 - offset: weight for offset, weight in first.items()}))


TERNARY_BSPLINE = _ternary(
    {-1: Fraction(4, 27), 0: Fraction(19, 27), 1: Fraction(4, 27)},
    {-1: Fraction(1, 27), 0: Fraction(16, 27), 1: Fraction(10, 27)},
)
TERNARY_FOUR_POINT = _ternary(
    KEPT, {-1: Fraction(-5, 81), 0: Fraction(60, 81), 1: Fraction(30, 81), 2: Fraction(-4, 81)}
)
