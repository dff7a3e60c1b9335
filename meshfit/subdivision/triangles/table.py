"""Table of the schemes on triangles. To add a scheme, add an entry here."""

from dataclasses import replace
from fractions import Fraction
from math import cos, pi

from meshfit.subdivision.masks import CUBIC_BSPLINE, TERNARY_BSPLINE, TERNARY_FOUR_POINT, four_point
from meshfit.subdivision.scheme import Parameter, SchemeEntry
from meshfit.subdivision.triangles.scheme import (
    MIDPOINT,
    EdgeMask,
    FaceMask,
    Split,
    SpokeMask,
    TriangleScheme,
    VertMask,
)


def _loop_ring(n: int) -> float:
    return 5 / 8 - (3 / 8 + cos(2 * pi / n) / 4) ** 2


def _warren_ring(n: int) -> float:
    return 9 / 16 if n == 3 else 3 / 8


def _sqrt3_ring(n: int) -> float:
    return (4 - 2 * cos(2 * pi / n)) / 9


def _zorin_spokes(n: int) -> tuple[float, ...]:
    """Zorin, Schröder and Sweldens 1996, section 4."""
    if n == 3:
        return (3 / 4, 5 / 12, -1 / 12, -1 / 12)
    if n == 4:
        return (3 / 4, 3 / 8, 0.0, -1 / 8, 0.0)
    return (3 / 4, *((1 / 4 + cos(2 * pi * j / n) + cos(4 * pi * j / n) / 2) / n for j in range(n)))


def _labsik_greiner_spokes(n: int) -> tuple[float, ...]:
    """Labsik and Greiner 2000; spokes 0 and 1 are the two other corners of the face."""
    if n == 3:
        return (8 / 9, 4 / 27, 4 / 27, -5 / 27)
    if n == 4:
        return (7 / 9, 2 / 9, 2 / 9, -1 / 9, -1 / 9)
    a = 2 * cos(pi / n) / 3
    angles = [(2 * j - 1) * pi / n for j in range(n)]
    return (1 - a * a, *((a * a + 2 * a * cos(t) + 2 * a * a * cos(2 * t)) / n for t in angles))


def _loop(weights: str) -> TriangleScheme:
    ring = _warren_ring if weights == "warren" else _loop_ring
    return TriangleScheme(
        Split.QUADRISECT, EdgeMask(Fraction(3, 8), opposite=Fraction(1, 8)), CUBIC_BSPLINE, vert=VertMask(ring)
    )


def _interp_loop(alpha: float, weights: str, valence3: str) -> TriangleScheme:
    safeguard = _modified_butterfly() if valence3 == "zorin" else None
    return replace(_loop(weights), alpha=alpha, at_valence3=safeguard)


def _butterfly(tension: float) -> TriangleScheme:
    w = Fraction(tension)
    return TriangleScheme(Split.QUADRISECT, EdgeMask(Fraction(1, 2), opposite=2 * w, wing=-w), four_point(w))


def _modified_butterfly() -> TriangleScheme:
    return replace(_butterfly(1 / 16), spokes=SpokeMask(_zorin_spokes))


def _sqrt3() -> TriangleScheme:
    return TriangleScheme(Split.SQRT3, FaceMask(Fraction(1, 3)), TERNARY_BSPLINE, vert=VertMask(_sqrt3_ring))


def _lin_luo_sqrt3(alpha: float) -> TriangleScheme:
    return replace(_sqrt3(), alpha=alpha)


def _interp_sqrt3() -> TriangleScheme:
    mask = FaceMask(Fraction(32, 81), across=Fraction(-1, 81), wing=Fraction(-2, 81))
    return TriangleScheme(Split.SQRT3, mask, TERNARY_FOUR_POINT, spokes=SpokeMask(_labsik_greiner_spokes))


LOOP = _loop("loop")
"""Loop 1987, with its own weights."""

_WEIGHTS = Parameter("loop", ("loop", "warren"), "vertex weights: Loop's own, or Warren's simpler ones")

TRIANGLE_SCHEMES: dict[str, SchemeEntry[TriangleScheme]] = {
    "midpoint": SchemeEntry(
        "midpoint",
        "triangles",
        "interpolatory",
        "C0: the surface stays as it is",
        "linear interpolation",
        lambda: MIDPOINT,
        {},
    ),
    "loop": SchemeEntry(
        "Loop",
        "triangles",
        "approximating",
        "C2, C1 at extraordinary vertices",
        "Loop 1987; Warren's weights: Warren and Weimer 2001; boundary: Hoppe et al. 1994",
        _loop,
        {"weights": _WEIGHTS},
    ),
    "interp-loop": SchemeEntry(
        "interpolatory Loop",
        "triangles",
        "interpolatory",
        "C1, on regular meshes C2 for alpha < 1; C1 at valence 3 only for alpha < 0.864, or with valence3=zorin",
        "Loop displaced back, after Lin, You, Luo and Li 2008 and Li and Zheng 2012",
        _interp_loop,
        {
            "alpha": Parameter(1.0, (0.0, 1.0), "from Loop (0) to interpolatory (1)"),
            "weights": _WEIGHTS,
            "valence3": Parameter(
                "displacement", ("displacement", "zorin"), "rule at edges of valence-3 vertices; zorin keeps them C1"
            ),
        },
    ),
    "butterfly": SchemeEntry(
        "Butterfly",
        "triangles",
        "interpolatory",
        "C1, but only C0 at valence 3 and from 8",
        "Dyn, Levin and Gregory 1990",
        _butterfly,
        {"tension": Parameter(1 / 16, (0.0, 1 / 8), "w; 0 is midpoint")},
    ),
    "modified-butterfly": SchemeEntry(
        "modified Butterfly",
        "triangles",
        "interpolatory",
        "C1",
        "Zorin, Schröder and Sweldens 1996",
        _modified_butterfly,
        {},
    ),
    "sqrt3": SchemeEntry(
        "√3", "triangles", "approximating", "C2, C1 at extraordinary vertices", "Kobbelt 2000", _sqrt3, {}
    ),
    "lin-luo-sqrt3": SchemeEntry(
        "unified √3",
        "triangles",
        "interpolatory",
        "C1 for 0 < alpha <= 1; at valence 3 only for alpha < 0.799",
        "√3 displaced back, after Lin and Luo 2007",
        _lin_luo_sqrt3,
        {"alpha": Parameter(1.0, (0.0, 1.0), "from Kobbelt's √3 (0) to interpolatory (1)")},
    ),
    "interp-sqrt3": SchemeEntry(
        "interpolatory √3",
        "triangles",
        "interpolatory",
        "C1",
        "Labsik and Greiner 2000",
        _interp_sqrt3,
        {},
    ),
}
