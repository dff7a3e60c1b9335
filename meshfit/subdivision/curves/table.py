"""Table of the schemes on curves. To add a scheme, add an entry here."""

from fractions import Fraction
from math import sqrt

from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.masks import CUBIC_BSPLINE, TERNARY_BSPLINE, TERNARY_FOUR_POINT, four_point
from meshfit.subdivision.scheme import Parameter, SchemeEntry

CURVE_SCHEMES: dict[str, SchemeEntry[CurveScheme]] = {
    "cubic-bspline": SchemeEntry(
        "cubic B-spline",
        "curves",
        "approximating",
        "C2",
        "Lane and Riesenfeld 1980; on boundaries of loop",
        lambda: CurveScheme(CUBIC_BSPLINE),
        {},
    ),
    "four-point": SchemeEntry(
        "four-point",
        "curves",
        "interpolatory",
        "C1 for 0 < tension < (√5 - 1)/8 = 0.1545; at 0 the curve stays as it is",
        "Dyn, Levin and Gregory 1987; on boundaries of butterfly",
        lambda tension: CurveScheme(four_point(Fraction(tension))),
        {"tension": Parameter(1 / 16, (0.0, (sqrt(5) - 1) / 8), "w; 1/16 is exact for cubics")},
    ),
    "interp-bspline": SchemeEntry(
        "interpolatory cubic B-spline",
        "curves",
        "interpolatory",
        "C2 for alpha < 1, C1 at 1",
        "cubic B-spline displaced back, after Li and Zheng 2012; on boundaries of interp-loop",
        lambda alpha: CurveScheme(CUBIC_BSPLINE, alpha=alpha),
        {"alpha": Parameter(1.0, (0.0, 1.0), "from the cubic B-spline (0) to four-point (1)")},
    ),
    "ternary-bspline": SchemeEntry(
        "ternary cubic B-spline",
        "curves",
        "approximating",
        "C2",
        "Kobbelt 2000, on boundaries of sqrt3",
        lambda: CurveScheme(TERNARY_BSPLINE),
        {},
    ),
    "ternary-four-point": SchemeEntry(
        "ternary four-point",
        "curves",
        "interpolatory",
        "C1",
        "Deslauriers and Dubuc 1989; Labsik and Greiner 2000, on boundaries of interp-sqrt3",
        lambda: CurveScheme(TERNARY_FOUR_POINT),
        {},
    ),
}
