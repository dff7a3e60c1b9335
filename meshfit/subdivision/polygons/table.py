"""Table of the schemes on polygons. To add a scheme, add an entry here."""

from dataclasses import replace
from fractions import Fraction
from math import cos, pi

from meshfit.subdivision.masks import CUBIC_BSPLINE, TERNARY_BSPLINE, TERNARY_FOUR_POINT, four_point
from meshfit.subdivision.polygons.scheme import (
    CornerMask,
    MeanMask,
    PolygonScheme,
    PolygonSplit,
    PolygonVertMask,
    TensorProductMask,
)
from meshfit.subdivision.scheme import Parameter, SchemeEntry

_FOUR_POINT = four_point(Fraction(1, 16))


def _catmull_clark_vert(n: int) -> tuple[Fraction, Fraction, Fraction]:
    """Catmull and Clark 1978; the midpoints of edges that they take count half as the vertex itself."""
    return Fraction(n - 2, n), Fraction(1, n), Fraction(1, n)


def _sqrt2_vert(_: int) -> tuple[Fraction, Fraction, Fraction]:
    return Fraction(1, 2), Fraction(1, 2), Fraction(0)


def _doo_sabin_corner(n: int) -> tuple[float, ...]:
    """Doo and Sabin 1978, in the form of Catmull and Clark."""
    return ((n + 5) / (4 * n), *((3 + 2 * cos(2 * pi * k / n)) / (4 * n) for k in range(1, n)))


def _catmull_clark() -> PolygonScheme:
    mask = MeanMask(Fraction(1, 4), Fraction(1, 4))
    return PolygonScheme(PolygonSplit.QUADS, mask, CUBIC_BSPLINE, PolygonVertMask(_catmull_clark_vert))


def _interp_catmull_clark(alpha: float) -> PolygonScheme:
    return replace(_catmull_clark(), alpha=alpha)


def _doo_sabin() -> PolygonScheme:
    """Towards a boundary, the biquadratic B-spline whose knots are doubled at its ends, so that corners stay."""
    mask = CornerMask(
        _doo_sabin_corner,
        on_edge={0: Fraction(3, 4), 1: Fraction(1, 4)},
        beside_kept={0: Fraction(1, 2), 1: Fraction(1, 2)},
        beside=(Fraction(1, 4), Fraction(1, 4), Fraction(1, 2)),
    )
    return PolygonScheme(PolygonSplit.DUAL, mask)


def _kobbelt() -> PolygonScheme:
    return PolygonScheme(PolygonSplit.QUADS, TensorProductMask(_FOUR_POINT, diagonal=Fraction(1, 9)), _FOUR_POINT)


def _sqrt2() -> PolygonScheme:
    return PolygonScheme(PolygonSplit.SQRT2, MeanMask(), CUBIC_BSPLINE, PolygonVertMask(_sqrt2_vert))


def _interp_sqrt2(alpha: float) -> PolygonScheme:
    return replace(_sqrt2(), alpha=alpha)


def _ternary() -> PolygonScheme:
    net = TensorProductMask(TERNARY_BSPLINE)
    return PolygonScheme(PolygonSplit.TERNARY, net, TERNARY_BSPLINE, net.vert_mask())


def _interp_ternary() -> PolygonScheme:
    return PolygonScheme(PolygonSplit.TERNARY, TensorProductMask(TERNARY_FOUR_POINT), TERNARY_FOUR_POINT)


POLYGON_SCHEMES: dict[str, SchemeEntry[PolygonScheme]] = {
    "catmull-clark": SchemeEntry(
        "Catmull–Clark",
        "polygons",
        "approximating",
        "C2, C1 at extraordinary vertices",
        "Catmull and Clark 1978; boundary: cubic B-spline",
        _catmull_clark,
        {},
    ),
    "interp-catmull-clark": SchemeEntry(
        "interpolatory Catmull–Clark",
        "polygons",
        "interpolatory",
        "C1",
        "Catmull–Clark displaced back, after Lin, You, Luo and Li 2008",
        _interp_catmull_clark,
        {"alpha": Parameter(1.0, (0.0, 1.0), "from Catmull–Clark (0) to interpolatory (1)")},
    ),
    "doo-sabin": SchemeEntry(
        "Doo–Sabin",
        "polygons",
        "approximating",
        "C1",
        "Doo and Sabin 1978; boundary: quadratic B-spline, ending at corners",
        _doo_sabin,
        {},
    ),
    "kobbelt": SchemeEntry(
        "Kobbelt's quads",
        "polygons",
        "interpolatory",
        "C1",
        "Kobbelt 1996, Interpolatory subdivision on open quadrilateral nets",
        _kobbelt,
        {},
    ),
    "sqrt2": SchemeEntry(
        "√2",
        "polygons",
        "approximating",
        "C4, C1 at extraordinary vertices",
        "Velho and Zorin 2001; Li, Ma and Bao 2004",
        _sqrt2,
        {},
    ),
    "interp-sqrt2": SchemeEntry(
        "interpolatory √2",
        "polygons",
        "interpolatory",
        "C1",
        "√2 displaced back, after Lin, You, Luo and Li 2008",
        _interp_sqrt2,
        {"alpha": Parameter(1.0, (0.0, 1.0), "from √2 (0) to interpolatory (1)")},
    ),
    "ternary": SchemeEntry(
        "ternary quads",
        "polygons",
        "approximating",
        "C2; regular meshes of quads only",
        "tensor product of the ternary cubic B-spline",
        _ternary,
        {},
    ),
    "interp-ternary": SchemeEntry(
        "interpolatory ternary quads",
        "polygons",
        "interpolatory",
        "C1; regular meshes of quads only",
        "tensor product of Labsik and Greiner's ternary four-point curve 2000",
        _interp_ternary,
        {},
    ),
}
