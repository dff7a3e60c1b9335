"""Fairness of a surface while it is fitted: smoothness, and tension that shrinks membranes.

A membrane is a part of the surface that spans a gap of the target, such as the web between two legs.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.remeshing.triangle_geometry import dot, length_of

# A point is on a membrane if it is outside the target, at least this many sides of its face away, and the cosine
# between the two normals is below this.
_FAR, _ASIDE = 0.5, 0.7
# Tension of an edge of a membrane, relative to the weight of all correspondences over the number of vertices; it falls
# with fairness below the second number.
_TENSION, _FULL_FAIRNESS = 1.0, 0.1
# Rest length of an edge of a membrane, relative to the median edge.
_REST = 0.3


@dataclass(frozen=True, eq=False)
class Tension:
    """Springs along edges: Σ t |(x + d) - (x' + d') - r (x - x')|² over the edges x x', for a step d.

    Attributes:
        weights: (E, 1) t.
        rest: (E, 1) r, rest length relative to the current length.
    """

    weights: Float[Tensor, "E 1"]
    rest: Float[Tensor, "E 1"]


@dataclass(frozen=True, eq=False)
class Fairness:
    """Smoothness λ/V Σ w |L x|², with L the uniform Laplacian and x positions or displacements, plus tension.

    Attributes:
        connectivity: the surface.
        weights: (V, 1) w λ/V.
        tension: springs along its edges, if any.
        reference: (V, 3) positions from which displacements are to be smooth; None for a smooth surface.
    """

    connectivity: Connectivity
    weights: Float[Tensor, "V 1"]
    tension: Tension | None = None
    reference: Float[Tensor, "V 3"] | None = None

    def __call__(self, x: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """Return Lᵀ W L x + Dᵀ T D x, with D the differences along edges."""
        return self._smooth(x) if self.tension is None else self._smooth(x) + self._pull(x, self.tension.weights)

    def slope(self, x: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """Return half the gradient at the start of the step: Lᵀ W L x + Dᵀ T (1 - R) D x."""
        smooth = self._smooth(x if self.reference is None else x - self.reference)
        if self.tension is None:
            return smooth
        return smooth + self._pull(x, self.tension.weights * (1 - self.tension.rest))

    def diagonal(self) -> Float[Tensor, "V 1"]:
        """Return the diagonal of Lᵀ W L + Dᵀ T D."""
        tail, head = self.connectivity.ends
        share = self.weights / self.connectivity.edges.valence.clamp_min(1)[:, None] ** 2
        smooth = self.weights.index_add(0, tail, share[head]).index_add(0, head, share[tail])
        if self.tension is None:
            return smooth
        return smooth.index_add(0, tail, self.tension.weights).index_add(0, head, self.tension.weights)

    def _smooth(self, x: Tensor) -> Tensor:
        umbrella = self.connectivity.umbrella
        return umbrella.T @ (self.weights * (umbrella @ x))

    def _pull(self, x: Tensor, weights: Tensor) -> Tensor:
        tail, head = self.connectivity.ends
        pull = weights * (x[tail] - x[head])
        return torch.zeros_like(x).index_add_(0, tail, pull).index_add_(0, head, -pull)


def in_membranes(
    shape: Shape,
    face: Int64[Tensor, " M"],
    away: Float[Tensor, "M 3"],
    normals: Float[Tensor, "M 3"],
    nearest: Float[Tensor, "M 3"],
) -> Bool[Tensor, " M"]:
    """Return which points of the surface are on membranes.

    Args:
        shape: the surface.
        face: (M,) face of each point.
        away: (M, 3) vectors from the nearest points of the target.
        normals: (M, 3) normals of the surface at the points.
        nearest: (M, 3) normals of the target at the nearest points.
    """
    sides = shape.edge_lengths[shape.connectivity.edges.of_side].mean(1)
    far = length_of(away) > _FAR * sides[face]
    return far & (dot(away, nearest) > 0) & (dot(normals, nearest) < _ASIDE)


def membrane_share(shape: Shape, per_face: Float[Tensor, " F"]) -> Float[Tensor, " V"]:
    """Return the share of the area at each vertex that is on membranes, from the share of each face."""
    area = shape.double_area[:, None]
    whole = shape.connectivity.at_verts(area).clamp_min(torch.finfo(area.dtype).tiny)
    return (shape.connectivity.at_verts(area * per_face[:, None]) / whole)[:, 0]


def membrane_tension(shape: Shape, share: Float[Tensor, " V"], fairness: float) -> Tension:
    """Return the tension of membranes.

    Edges that are already short are not shrunk further, so that no part is pinched off; remeshing collapses them.

    Args:
        shape: the surface.
        share: (V,) share of each vertex's area that is on membranes.
        fairness: weight of smoothness; when it is low, membranes are hardly more than noise.
    """
    (tail, head), lengths = shape.connectivity.ends, shape.edge_lengths
    weight = _TENSION * min(fairness / _FULL_FAIRNESS, 1.0) / shape.connectivity.num_verts
    rest = (_REST * lengths.median() / lengths.clamp_min(torch.finfo(lengths.dtype).tiny)).clamp_max(1)
    return Tension(((share[tail] + share[head]) * (weight / 2))[:, None], rest[:, None])
