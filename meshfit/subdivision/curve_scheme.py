"""Schemes on curves: a mask along the curve, declared as data."""

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from meshfit.errors import SchemeError
from meshfit.subdivision.masks import CurveMask
from meshfit.subdivision.triangle_scheme import PushBack

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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
