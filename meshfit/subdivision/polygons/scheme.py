"""Schemes on polygons: masks on a split, declared as data."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction

from meshfit.errors import SchemeError
from meshfit.subdivision.masks import (
    CHECKED_VALENCES,
    KEPT,
    LINEAR,
    TERNARY_LINEAR,
    CurveMask,
    CurveWeights,
    mirrored,
    require_unit_sum,
)
from meshfit.subdivision.scheme import BaseScheme


@dataclass(frozen=True)
class PolygonVertMask:
    """The new position of an interior vertex of valence n, which is 2 or more.

    Attributes:
        weights: n → weights of itself, of the mean of its n neighbours, and of the mean of the means of its n faces.
    """

    weights: Callable[[int], tuple[Fraction, Fraction, Fraction]]

    def __post_init__(self) -> None:
        for valence in (2, *CHECKED_VALENCES):
            require_unit_sum(sum(self.weights(valence), Fraction(0)), f"a vertex mask at valence {valence}")


@dataclass(frozen=True)
class MeanMask:
    """New vertices from the means of faces; the new vertex of a face is its mean.

    Attributes:
        end: for the vertex in an interior edge, the weight of each of the 2 ends.
        mean: the weight of the mean of each of its 2 faces.
    """

    end: Fraction = Fraction(1, 2)
    mean: Fraction = Fraction(0)

    def __post_init__(self) -> None:
        require_unit_sum(2 * self.end + 2 * self.mean, "an edge mask")


@dataclass(frozen=True)
class TensorProductMask:
    """A rule for curves, applied along the lines of a net of quads, then across them.

    A vertex in an edge is on the curve through the vertices in line with the edge. One in a face is on the curve
    through the new vertices of edges that lie side by side, and the mean of both directions where these differ. Beyond
    a boundary, a line continues by reflection.

    Attributes:
        curve: the rule for curves, with weights at offsets -1 to 2.
        diagonal: the weight q in the point by which a line continues behind an interior vertex of valence n other than
            4. With the neighbours l and the vertices h diagonally across faces, h_i between l_i and l_i+1, it is

                4/n Σl - (l_i-1 + l_i + l_i+1) + q (h_i-2 + h_i-1 + h_i + h_i+1 - 4/n Σh)

            for the line that comes from l_i (Kobbelt 1996, section 4; at n = 4, it is l_i+2). None refuses other
            valences than 4 and faces other than quads.
    """

    curve: CurveMask
    diagonal: Fraction | None = None

    def __post_init__(self) -> None:
        first, *others = self.curve.inserted
        last = others[-1] if others else first
        if mirrored(first) != dict(last):
            raise SchemeError("a tensor product needs a curve rule that is its own mirror image")

    @property
    def is_local(self) -> bool:
        """Whether it uses the vertices of the edge or face alone, so that no line has to continue beyond them."""
        reach = {offset for weights in self.curve.inserted for offset in weights}
        return reach <= {0, 1} and not self.moves

    @property
    def moves(self) -> bool:
        """Whether old vertices move, and new ones in edges with them."""
        return dict(self.curve.vert) != KEPT

    def vert_mask(self) -> PolygonVertMask:
        """Return the rule for old vertices: the curve's, in one direction after the other."""
        own, side = self.curve.vert[0], self.curve.vert[1]
        # The mean of a quad has a quarter of each corner, so the vertices diagonally across come with the others.
        weights = (own**2 - 4 * side**2, 4 * own * side - 8 * side**2, 16 * side**2)
        return PolygonVertMask(lambda _: weights)


@dataclass(frozen=True)
class CornerMask:
    """A new vertex in every corner of a face, in place of the old vertices.

    A corner between two boundary edges stays where it is. A corner at one boundary edge has its new vertex on it.

    Attributes:
        weights: n → weights of the n corners of the face, counter-clockwise from the corner itself.
        on_edge: at one boundary edge, weights of the corner itself (0) and of the other end (1).
        beside_kept: the same, if the other end is a corner that stays.
        beside: off the boundary, if one side leads to a boundary edge, weights of the corner itself, of the corner on
            that edge, and of the mean of the face. If both sides do, the new vertex is that mean.
    """

    weights: Callable[[int], tuple[float, ...]]
    on_edge: CurveWeights
    beside_kept: CurveWeights
    beside: tuple[Fraction, Fraction, Fraction]

    def __post_init__(self) -> None:
        for weights in (self.on_edge.values(), self.beside_kept.values(), self.beside):
            require_unit_sum(sum(weights, Fraction(0)), "a corner mask at the boundary")
        for size in CHECKED_VALENCES:
            weights_of_face = self.weights(size)
            if len(weights_of_face) != size:
                raise SchemeError(f"a corner mask has {len(weights_of_face)} weights in a face of {size} corners")
            require_unit_sum(sum(weights_of_face), f"a corner mask in a face of {size} corners")


class PolygonSplit(Enum):
    """Division of faces."""

    QUADS = "n-gons to n quads: a vertex in every edge and every face"
    SQRT2 = (
        "a quad for every edge: a vertex in every face, old edges dropped; boundary edges halved at every second step"
    )
    TERNARY = "quads to 9: two vertices in every edge, one in every corner"
    DUAL = "a face for every face, edge and vertex: a vertex in every corner, old vertices dropped"


@dataclass(frozen=True)
class PolygonScheme(BaseScheme):
    """A subdivision scheme on polygons.

    Attributes:
        split: how faces are divided.
        inserted: mask of the new vertices off the boundary.
        boundary: masks along the boundary; None for corner masks, which have boundary rules of their own.
        vert: mask of the old interior vertices; None keeps them where they are.
    """

    split: PolygonSplit
    inserted: MeanMask | TensorProductMask | CornerMask
    boundary: CurveMask | None = None
    vert: PolygonVertMask | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        dual = self.split is PolygonSplit.DUAL
        if isinstance(self.inserted, CornerMask) != dual or (self.boundary is None) != dual:
            raise SchemeError("masks of corners go with the dual split, and those of curves with all others")
        if dual and (self.vert or self.alpha is not None):
            raise SchemeError("the dual split keeps no old vertices that could be moved or pushed back")


LINEAR_SCHEMES: dict[PolygonSplit, PolygonScheme] = {
    PolygonSplit.QUADS: PolygonScheme(PolygonSplit.QUADS, MeanMask(), LINEAR),
    PolygonSplit.SQRT2: PolygonScheme(PolygonSplit.SQRT2, MeanMask(), LINEAR),
    PolygonSplit.TERNARY: PolygonScheme(PolygonSplit.TERNARY, TensorProductMask(TERNARY_LINEAR), TERNARY_LINEAR),
}
"""Linear interpolation on each split that keeps old vertices: these stay, and new ones lie between them."""
