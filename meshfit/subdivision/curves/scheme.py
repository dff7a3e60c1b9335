"""The rules along curves, each declared once: of the schemes on curves, and of the boundaries of those on surfaces."""

from dataclasses import dataclass, replace
from enum import Enum
from fractions import Fraction
from typing import TYPE_CHECKING

from meshfit.errors import SchemeError
from meshfit.subdivision.masks import CurveMask, CurveWeights
from meshfit.subdivision.triangles.scheme import PushBack

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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


class CurveSplit(Enum):
    """How segments are divided; which way follows from the mask."""

    BISECT = "1-to-2: a vertex in every segment"
    TRISECT = "1-to-3: two vertices in every segment"


_SPLITS = {1: CurveSplit.BISECT, 2: CurveSplit.TRISECT}


@dataclass(frozen=True)
class CurveScheme:
    """One subdivision scheme on curves, every parameter fixed: declared data, which `assemble_curves` lays down.

    Attributes:
        mask: weights along the curve.
        push_back: a blend towards interpolation.
    """

    mask: CurveMask
    push_back: PushBack | None = None

    def __post_init__(self) -> None:
        if len(self.mask.inserted) not in _SPLITS:
            raise SchemeError(f"found a curve mask of {len(self.mask.inserted)} inserted verts; 1 or 2 are allowed")

    @property
    def split(self) -> CurveSplit:
        """How segments are divided."""
        return _SPLITS[len(self.mask.inserted)]

    def with_alpha(self, alpha: "float | NDArray[np.float64]") -> "CurveScheme":
        """The same scheme with another α of its push-back.

        Raises:
            SchemeError: the scheme has none.
        """
        if self.push_back is None:
            raise SchemeError("this scheme has no parameter alpha; interp-bspline has")
        return replace(self, push_back=replace(self.push_back, alpha=alpha))
