"""Schemes on curves: a mask along the curve, declared as data."""

from dataclasses import dataclass
from enum import Enum

from meshfit.errors import SchemeError
from meshfit.subdivision.masks import CurveMask
from meshfit.subdivision.scheme import BaseScheme


class CurveSplit(Enum):
    """Division of segments, which follows from the mask."""

    BISECT = "1-to-2: a vertex in every segment"
    TRISECT = "1-to-3: two vertices in every segment"


_SPLITS = {1: CurveSplit.BISECT, 2: CurveSplit.TRISECT}


@dataclass(frozen=True)
class CurveScheme(BaseScheme):
    """A subdivision scheme on curves.

    Attributes:
        mask: weights along the curve.
    """

    mask: CurveMask

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.mask.inserted) not in _SPLITS:
            raise SchemeError(f"found a curve mask of {len(self.mask.inserted)} inserted vertices; 1 or 2 are allowed")

    @property
    def split(self) -> CurveSplit:
        """Division of segments."""
        return _SPLITS[len(self.mask.inserted)]
