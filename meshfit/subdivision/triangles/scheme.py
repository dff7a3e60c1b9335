"""Schemes on triangles: masks on a split, declared as data."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction

from meshfit.errors import SchemeError
from meshfit.subdivision.masks import (
    CHECKED_VALENCES,
    LINEAR,
    TERNARY_LINEAR,
    CurveMask,
    Weight,
    require_unit_sum,
)
from meshfit.subdivision.scheme import BaseScheme


@dataclass(frozen=True)
class EdgeMask:
    """The vertex inserted at an interior edge.

    Attributes:
        end: weight of each of the 2 ends of the edge.
        opposite: of each of the 2 vertices opposite to it in its faces.
        wing: of each of the 4 vertices across the other edges of its faces (the butterfly's wings).
    """

    end: Weight
    opposite: Weight = Fraction(0)
    wing: Weight = Fraction(0)

    def __post_init__(self) -> None:
        require_unit_sum(2 * self.end + 2 * self.opposite + 4 * self.wing, "an edge mask")


@dataclass(frozen=True)
class FaceMask:
    """The vertex inserted in a face.

    Attributes:
        corner: weight of each of the 3 corners.
        across: of each of the 3 vertices across the face's edges.
        wing: of each of the 6 vertices across the outer edges of the 3 neighbouring faces.
    """

    corner: Weight
    across: Weight = Fraction(0)
    wing: Weight = Fraction(0)

    def __post_init__(self) -> None:
        require_unit_sum(3 * self.corner + 3 * self.across + 6 * self.wing, "a face mask")


@dataclass(frozen=True)
class VertMask:
    """The new position of an interior vertex of valence n: 1 - ring(n) of itself, ring(n) of its one-ring's mean."""

    ring: Callable[[int], float]


@dataclass(frozen=True)
class SpokeMask:
    """A vertex inserted next to an interior vertex v of valence n other than 6, from v and its one-ring alone.

    Attributes:
        weights: n → (centre, s_0, …, s_(n-1)), counter-clockwise. Spoke 0 leads to the other end of the edge; in a
            face, spokes 0 and 1 lead to the two other corners.
    """

    weights: Callable[[int], tuple[float, ...]]

    def __post_init__(self) -> None:
        for valence in CHECKED_VALENCES:
            weights = self.weights(valence)
            if len(weights) != valence + 1:
                raise SchemeError(f"a spoke mask has {len(weights)} weights at valence {valence}, not {valence + 1}")
            require_unit_sum(sum(weights), f"a spoke mask at valence {valence}")


class Split(Enum):
    """Division of faces."""

    QUADRISECT = "1-to-4: a vertex in every edge"
    SQRT3 = "1-to-3: a vertex in every face, old edges flipped; boundary edges trisected at every second step"


@dataclass(frozen=True)
class TriangleScheme(BaseScheme):
    """A subdivision scheme on triangles.

    Attributes:
        split: how faces are divided.
        inserted: mask of the new vertex in an interior edge or a face.
        boundary: masks along the boundary.
        vert: mask of the old interior vertices; None keeps them where they are.
        spokes: mask of a new vertex next to an interior vertex of valence other than 6; None uses `inserted` there too.
        at_valence3: masks that take the place of O + αMD, by α, at edges with an interior end of valence 3.
    """

    split: Split
    inserted: EdgeMask | FaceMask
    boundary: CurveMask
    vert: VertMask | None = None
    spokes: SpokeMask | None = None
    at_valence3: "TriangleScheme | None" = field(default=None, kw_only=True)

    @property
    def takes_creases(self) -> bool:
        """Whether its boundary rule also serves along creases: new vertices halve edges, and old ones move evenly."""
        vert, (inserted, *others) = self.boundary.vert, self.boundary.inserted
        ends = {offset: weight for offset, weight in inserted.items() if weight}
        return (
            self.split is Split.QUADRISECT
            and not others
            and ends == {0: Fraction(1, 2), 1: Fraction(1, 2)}
            and vert.get(-1, 0) == vert.get(1, 0)
        )


LINEAR_SCHEMES: dict[Split, TriangleScheme] = {
    Split.QUADRISECT: TriangleScheme(Split.QUADRISECT, EdgeMask(Fraction(1, 2)), LINEAR),
    Split.SQRT3: TriangleScheme(Split.SQRT3, FaceMask(Fraction(1, 3)), TERNARY_LINEAR),
}
"""Linear interpolation on each split: old vertices stay, and new ones lie between them."""
MIDPOINT = LINEAR_SCHEMES[Split.QUADRISECT]
"""Edges are halved, and nothing moves."""
