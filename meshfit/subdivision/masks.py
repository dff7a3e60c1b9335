"""Masks: the weights of a refinement rule, declared by role and checked to sum to one."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction

from meshfit.errors import SchemeError

Weight = Fraction | float
"""A weight: exact where it is rational."""

_TOLERANCE = 1e-12
CHECKED_VALENCES = range(3, 13)
"""Valences at which weights that are given by valence are tried."""


def require_unit_sum(total: Weight, what: str) -> None:
    """Refuse weights that do not sum to one: fractions exactly, reals but for rounding.

    Raises:
        SchemeError: saying what they are of.
    """
    allowed = 0.0 if isinstance(total, Fraction) else _TOLERANCE
    if abs(float(total - 1)) > allowed:
        raise SchemeError(f"the weights of {what} sum to {total}, not to 1")


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
    """The new place of an interior vertex of valence n: 1 - ring(n) of itself, ring(n) of its one-ring's mean."""

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


CurveWeights = Mapping[int, Fraction]


@dataclass(frozen=True)
class CurveMask:
    """The rule along a curve, such as a boundary.

    Attributes:
        vert: weights by offset along the curve from the vertex itself (0); -1 and 1 are the furthest.
        inserted: for each vertex inserted in an edge, weights by offset from the edge's first end (0); its second is 1,
            and -1 and 2 are the furthest.
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
