"""Masks of curves, the rules that schemes share along curves and boundaries, and the check that weights sum to one."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from meshfit.errors import SchemeError

Weight = Fraction | float
"""A weight: exact where it is rational."""
CurveWeights = Mapping[int, Fraction]
"""Weights by offset along a curve."""

CHECKED_VALENCES = range(3, 13)
"""Valences at which weights given by valence are checked."""
_TOLERANCE = 1e-12


def require_unit_sum(total: Weight, subject: str) -> None:
    """Refuse weights that do not sum to one: fractions exactly, floats up to rounding.

    Raises:
        SchemeError: naming the subject.
    """
    tolerance = 0.0 if isinstance(total, Fraction) else _TOLERANCE
    if abs(float(total - 1)) > tolerance:
        raise SchemeError(f"the weights of {subject} sum to {total}, not to 1")


@dataclass(frozen=True)
class CurveMask:
    """The rule along a curve, such as a boundary.

    Attributes:
        vert: weights by offset along the curve from the vertex itself (0), from -1 to 1.
        inserted: for each vertex inserted in an edge, weights by offset from the edge's first end (0); its second end
            is 1. Offsets go from -1 to 2.
    """

    vert: CurveWeights
    inserted: tuple[CurveWeights, ...]

    def __post_init__(self) -> None:
        require_unit_sum(sum(self.vert.values(), Fraction(0)), "the vertex mask of a curve")
        for weights in self.inserted:
            require_unit_sum(sum(weights.values(), Fraction(0)), "the edge mask of a curve")
        for rule, furthest in ((self.vert, 1), *((weights, 2) for weights in self.inserted)):
            if beyond := [offset for offset in rule if not -1 <= offset <= furthest]:
                raise SchemeError(f"a curve mask has a weight at offset {beyond[0]}; -1 to {furthest} are allowed")


def mirrored(weights: CurveWeights) -> CurveWeights:
    """Return the weights of the vertex that is inserted as far from the other end of an edge."""
    return {1 - offset: weight for offset, weight in weights.items()}


def _ternary(vert: CurveWeights, first: CurveWeights) -> CurveMask:
    """Rule with two vertices in each edge, the second the mirror image of the first."""
    return CurveMask(vert, (first, mirrored(first)))


KEPT: CurveWeights = {0: Fraction(1)}
"""An old vertex that stays where it is."""
LINEAR = CurveMask(KEPT, ({0: Fraction(1, 2), 1: Fraction(1, 2)},))
TERNARY_LINEAR = _ternary(KEPT, {0: Fraction(2, 3), 1: Fraction(1, 3)})
CUBIC_BSPLINE = CurveMask({-1: Fraction(1, 8), 0: Fraction(6, 8), 1: Fraction(1, 8)}, LINEAR.inserted)
TERNARY_BSPLINE = _ternary(
    {-1: Fraction(4, 27), 0: Fraction(19, 27), 1: Fraction(4, 27)},
    {-1: Fraction(1, 27), 0: Fraction(16, 27), 1: Fraction(10, 27)},
)
TERNARY_FOUR_POINT = _ternary(
    KEPT, {-1: Fraction(-5, 81), 0: Fraction(60, 81), 1: Fraction(30, 81), 2: Fraction(-4, 81)}
)


def four_point(tension: Fraction) -> CurveMask:
    """Dyn, Levin and Gregory 1987, A 4-point interpolatory subdivision scheme for curve design."""
    near = Fraction(1, 2) + tension
    return CurveMask(KEPT, ({-1: -tension, 0: near, 1: near, 2: -tension},))
