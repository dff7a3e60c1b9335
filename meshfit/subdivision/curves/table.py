"""The schemes on curves. Adding one is adding an entry here."""

from fractions import Fraction
from math import sqrt

from meshfit.subdivision.curves.scheme import (
    CUBIC_BSPLINE,
    TERNARY_BSPLINE,
    TERNARY_FOUR_POINT,
    CurveScheme,
    four_point,
)
from meshfit.subdivision.scheme import Parameter, SchemeEntry
from meshfit.subdivision.triangles.scheme import PushBack


def _cubic_bspline() -> CurveScheme:
    return CurveScheme(CUBIC_BSPLINE)


def _four_point(tension: float) -> CurveScheme:
    return CurveScheme(four_point(Fraction(tension)))


def _interp_bspline(alpha: float) -> CurveScheme:
    return CurveScheme(CUBIC_BSPLINE, PushBack(alpha))


def _ternary_bspline() -> CurveScheme:
    return CurveScheme(TERNARY_BSPLINE)


def _ternary_four_point() -> CurveScheme:
    return CurveScheme(TERNARY_FOUR_POINT)


CURVE_SCHEMES: dict[str, SchemeEntry] = {
    "cubic-bspline": SchemeEntry(
        "cubic B-spline",
        "curves",
        "approximating",
        "C2",
        "Lane and Riesenfeld 1980; on boundaries of loop",
        _cubic_bspline,
        {},
    ),
    "four-point": SchemeEntry(
        "four-point",
        "curves",
        "interpolatory",
        "C1 for 0 < tension < (√5 - 1)/8 = 0.1545; at 0 the curve stays as it is",
        "Dyn, Levin and Gregory 1987; on boundaries of butterfly",
        _four_point,
        {"tension": Parameter(1 / 16, (0.0, (sqrt(5) - 1) / 8), "w; 1/16 is exact for cubics")},
    ),
    "interp-bspline": SchemeEntry(
        "interpolatory cubic B-spline",
        "curves",
        "interpolatory",
        "C2 for alpha < 1, C1 at 1",
        "cubic B-spline displaced back, after Li and Zheng 2012; on boundaries of interp-loop",
        _interp_bspline,
        {"alpha": Parameter(1.0, (0.0, 1.0), "from the cubic B-spline (0) to four-point (1)")},
    ),
    "ternary-bspline": SchemeEntry(
        "ternary cubic B-spline",
        "curves",
        "approximating",
        "C2",
        "Kobbelt 2000, on boundaries of sqrt3",
        _ternary_bspline,
        {},
    ),
    "ternary-four-point": SchemeEntry(
        "ternary four-point",
        "curves",
        "interpolatory",
        "C1",
        "Deslauriers and Dubuc 1989; Labsik and Greiner 2000, on boundaries of interp-sqrt3",
        _ternary_four_point,
        {},
    ),
}
