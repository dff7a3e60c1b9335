"""Schemes on polygons: masks on a split, declared as data."""

from dataclasses import dataclass, replace
from enum import Enum
from fractions import Fraction
from typing import TYPE_CHECKING

from meshfit.errors import SchemeError
from meshfit.subdivision.masks import CurveMask
from meshfit.subdivision.polygon_masks import CornerMask, MeanMask, NetMask, RoundMask, mirrored
from meshfit.subdivision.triangle_scheme import PushBack

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class PolygonSplit(Enum):
    """How faces are divided."""

    QUADS = "n-gons to n quads: a vertex in every edge and every face"
    SQRT2 = (
        "a quad for every edge: a vertex in every face, old edges dropped; boundary edges halved at every second step"
    )
    TERNARY = "quads to 9: two verts in every edge, one in every corner"
    DUAL = "a face for every face, edge and vertex: a vertex in every corner, old verts dropped"


@dataclass(frozen=True)
class PolygonScheme:
    """One subdivision scheme on polygons, every parameter fixed: declared data, which `assemble_polygons` lays down.

    Attributes:
        split: how faces are divided.
        inserted: mask of the new verts off the boundary.
        boundary: masks along the boundary; None for masks of corners, which have their own.
        vert: mask of the old interior verts; None keeps them where they are.
        push_back: a blend towards interpolation.
    """

    split: PolygonSplit
    inserted: MeanMask | NetMask | CornerMask
    boundary: CurveMask | None = None
    vert: RoundMask | None = None
    push_back: PushBack | None = None

    def __post_init__(self) -> None:
        dual = self.split is PolygonSplit.DUAL
        if isinstance(self.inserted, CornerMask) != dual or (self.boundary is None) != dual:
            raise SchemeError("masks of corners go with the dual split, and those of curves with all others")
        if dual and (self.vert or self.push_back):
            raise SchemeError("the dual split keeps no old verts that could be moved or pushed back")

    def with_alpha(self, alpha: "float | NDArray[np.float64]") -> "PolygonScheme":
        """The same scheme with another α of its push-back.

        Raises:
            SchemeError: the scheme has none.
        """
        if self.push_back is None:
            raise SchemeError("this scheme has no parameter alpha; interp-catmull-clark has")
        return replace(self, push_back=replace(self.push_back, alpha=alpha))


_KEPT = {0: Fraction(1)}
_HALF = {0: Fraction(1, 2), 1: Fraction(1, 2)}
_THIRD = {0: Fraction(2, 3), 1: Fraction(1, 3)}
_HALVED, _TRISECTED = CurveMask(_KEPT, (_HALF,)), CurveMask(_KEPT, (_THIRD, mirrored(_THIRD)))

LINEAR: dict[PolygonSplit, PolygonScheme] = {
    PolygonSplit.QUADS: PolygonScheme(PolygonSplit.QUADS, MeanMask(), _HALVED),
    PolygonSplit.SQRT2: PolygonScheme(PolygonSplit.SQRT2, MeanMask(), _HALVED),
    PolygonSplit.TERNARY: PolygonScheme(PolygonSplit.TERNARY, NetMask(_TRISECTED), _TRISECTED),
}
"""Linear interpolation on each split that keeps old verts: these stay, new ones are put between them."""
