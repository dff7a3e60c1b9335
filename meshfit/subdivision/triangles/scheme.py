"""Schemes on triangles: masks on a split, declared as data."""

from dataclasses import dataclass, replace
from enum import Enum
from fractions import Fraction
from typing import TYPE_CHECKING

from meshfit.errors import SchemeError
from meshfit.subdivision.masks import CurveMask, EdgeMask, FaceMask, SpokeMask, VertMask

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Split(Enum):
    """How faces are divided."""

    QUADRISECT = "1-to-4: a vertex in every edge"
    SQRT3 = "1-to-3: a vertex in every face, old edges flipped; boundary edges trisected at every second step"


@dataclass(frozen=True)
class PushBack:
    """Take back, by α, what smoothing by the base masks does: from approximating (0) to interpolatory (1).

    With E and O the base masks of old and inserted vertices, M the split's linear interpolation and D = I - E the
    displacement, old vertices become E + αD and inserted ones O + αMD.

    Attributes:
        alpha: one value in [0, 1], or one for each vertex of the mesh that is refined.
        at_valence3: masks that take the place of O + αMD, by α, at edges with an interior end of valence 3.
    """

    alpha: "float | NDArray[np.float64]"
    at_valence3: "TriangleScheme | None" = None

    def __post_init__(self) -> None:
        alpha = self.alpha
        low, high = (alpha, alpha) if isinstance(alpha, float | int) else (alpha.min(initial=1), alpha.max(initial=0))
        if not (low >= 0 and high <= 1):
            raise SchemeError(f"alpha is not allowed: all its values must lie from 0 to 1{_first_outside(alpha)}")


def _first_outside(alpha: "float | NDArray[np.float64]") -> str:
    if isinstance(alpha, float | int):
        return f"; found {alpha:g}"
    vert = int((~((alpha >= 0) & (alpha <= 1))).argmax())
    return f"; vertex {vert} has {alpha.flat[vert]:g}"


@dataclass(frozen=True)
class TriangleScheme:
    """One subdivision scheme on triangles, every parameter fixed: declared data, which `assemble` lays down.

    Attributes:
        split: how faces are divided.
        inserted: mask of the new vertex in an interior edge or a face.
        boundary: masks along the boundary.
        vert: mask of the old interior vertices; None keeps them where they are.
        spokes: mask of a new vertex next to an interior vertex of valence other than 6; None uses `inserted` there too.
        push_back: a blend towards interpolation.
    """

    split: Split
    inserted: EdgeMask | FaceMask
    boundary: CurveMask
    vert: VertMask | None = None
    spokes: SpokeMask | None = None
    push_back: PushBack | None = None

    @property
    def takes_creases(self) -> bool:
        """Whether the rule along its boundary can be that along a crease: halves, between the ends of an edge alone."""
        vert, (inserted, *others) = self.boundary.vert, self.boundary.inserted
        ends = {offset: weight for offset, weight in inserted.items() if weight}
        return (
            self.split is Split.QUADRISECT
            and not others
            and ends == {0: Fraction(1, 2), 1: Fraction(1, 2)}
            and vert.get(-1, 0) == vert.get(1, 0)
        )

    def with_alpha(self, alpha: "float | NDArray[np.float64]") -> "TriangleScheme":
        """The same scheme with another α of its push-back.

        Raises:
            SchemeError: the scheme has none.
        """
        if self.push_back is None:
            raise SchemeError("this scheme has no parameter alpha; interp-loop and others have")
        return replace(self, push_back=replace(self.push_back, alpha=alpha))
