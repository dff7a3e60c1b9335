"""The schemes on polygons. Adding one is adding an entry here."""

from fractions import Fraction
from math import cos, pi

from meshfit.subdivision.masks import CurveMask, CurveWeights
from meshfit.subdivision.polygons.scheme import (
    CornerMask,
    MeanMask,
    PolygonScheme,
    PolygonSplit,
    PolygonVertMask,
    TensorProductMask,
    mirrored,
)
from meshfit.subdivision.scheme import Parameter, SchemeEntry
from meshfit.subdivision.triangles.scheme import PushBack

_KEPT = {0: Fraction(1)}


def _sixteenths(*weights: int) -> CurveWeights:
    return {offset: Fraction(weight, 16) for offset, weight in enumerate(weights, -1) if weight}


def _ternary_curve(vert: CurveWeights, first: CurveWeights) -> CurveMask:
    return CurveMask(vert, (first, mirrored(first)))


_CUBIC_BSPLINE = CurveMask(_sixteenths(2, 12, 2), (_sixteenths(0, 8, 8),))
_FOUR_POINT = CurveMask(_KEPT, (_sixteenths(-1, 9, 9, -1),))
_TERNARY_BSPLINE = _ternary_curve(
    {-1: Fraction(4, 27), 0: Fraction(19, 27), 1: Fraction(4, 27)},
    {-1: Fraction(1, 27), 0: Fraction(16, 27), 1: Fraction(10, 27)},
)
_TERNARY_FOUR_POINT = _ternary_curve(
    _KEPT, {-1: Fraction(-5, 81), 0: Fraction(60, 81), 1: Fraction(30, 81), 2: Fraction(-4, 81)}
)


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
    return PolygonScheme(PolygonSplit.QUADS, mask, _CUBIC_BSPLINE, PolygonVertMask(_catmull_clark_vert))


def _interp_catmull_clark(alpha: float) -> PolygonScheme:
    base = _catmull_clark()
    return PolygonScheme(base.split, base.inserted, base.boundary, base.vert, PushBack(alpha))


def _doo_sabin() -> PolygonScheme:
    """Towards a boundary, the biquadratic B-spline whose knots are doubled at its ends, so that corners stay."""
    mask = CornerMask(
        _doo_sabin_corner,
        on_edge=_sixteenths(0, 12, 4),
        beside_kept=_sixteenths(0, 8, 8),
        beside=(Fraction(1, 4), Fraction(1, 4), Fraction(1, 2)),
    )
    return PolygonScheme(PolygonSplit.DUAL, mask)


def _kobbelt() -> PolygonScheme:
    return PolygonScheme(PolygonSplit.QUADS, TensorProductMask(_FOUR_POINT, diagonal=Fraction(1, 9)), _FOUR_POINT)


def _sqrt2() -> PolygonScheme:
    return PolygonScheme(PolygonSplit.SQRT2, MeanMask(), _CUBIC_BSPLINE, PolygonVertMask(_sqrt2_vert))


def _interp_sqrt2(alpha: float) -> PolygonScheme:
    base = _sqrt2()
    return PolygonScheme(base.split, base.inserted, base.boundary, base.vert, PushBack(alpha))


def _ternary() -> PolygonScheme:
    net = TensorProductMask(_TERNARY_BSPLINE)
    return PolygonScheme(PolygonSplit.TERNARY, net, _TERNARY_BSPLINE, net.vert_mask())


def _interp_ternary() -> PolygonScheme:
    return PolygonScheme(PolygonSplit.TERNARY, TensorProductMask(_TERNARY_FOUR_POINT), _TERNARY_FOUR_POINT)


POLYGON_SCHEMES: dict[str, SchemeEntry] = {
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
