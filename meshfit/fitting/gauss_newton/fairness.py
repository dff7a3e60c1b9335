"""What holds a surface together while it is fitted: smoothness, and tension where it is to shrink."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.remeshing.triangle_geometry import dot, length_of


@dataclass(frozen=True, eq=False)
class Tension:
    """What draws the ends of edges together: Σ t |(x + d) - (x' + d') - r (x - x')|² over edges, d the step.

    Attributes:
        weights: (E, 1) t.
        rest: (E, 1) r, the share of each edge's length that it is drawn to.
    """

    weights: Float[Tensor, "E 1"]
    rest: Float[Tensor, "E 1"]


@dataclass(frozen=True, eq=False)
class Fairness:
    """What keeps a surface smooth: λ/V Σ w |L x|², L the uniform Laplacian; and tension, where there is any.

    Attributes:
        connectivity: of the surface.
        weights: (V, 1) w times λ/V.
        tension: of its edges.
    """

    connectivity: Connectivity
    weights: Float[Tensor, "V 1"]
    tension: Tension | None = None

    def __call__(self, x: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """Lᵀ W L x + Dᵀ T D x, with D the differences along edges."""
        return self._smooth(x) if self.tension is None else self._smooth(x) + self._pull(x, self.tension.weights)

    def slope(self, x: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """Half the gradient, where the step begins: Lᵀ W L x + Dᵀ T (1 - R) D x."""
        if self.tension is None:
            return self._smooth(x)
        return self._smooth(x) + self._pull(x, self.tension.weights * (1 - self.tension.rest))

    def diagonal(self) -> Float[Tensor, "V 1"]:
        """The diagonal of Lᵀ W L + Dᵀ T D."""
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


# A point belongs to a web if it is outside the target, this far from it in sides of its face, and the cosine between
# the normals there is below this.
_FAR, _ASIDE = 0.5, 0.7
# Of an edge in a web, as a share of the weight of all pairs, over the number of verts; less where fairness is less.
_TENSION, _FULL_FAIRNESS = 1.0, 0.1
# What an edge is drawn to, as a share of the median edge.
_REST = 0.3


def in_membranes(
    shape: Shape,
    face: Int64[Tensor, " M"],
    away: Float[Tensor, "M 3"],
    normals: Float[Tensor, "M 3"],
    nearest: Float[Tensor, "M 3"],
) -> Bool[Tensor, " M"]:
    """Which points of the surface belong to a web.

    Args:
        shape: the surface.
        face: the face that each point lies on.
        away: from the nearest point of the target to each.
        normals: of the surface at each.
        nearest: of the target at the nearest point.
    """
    sides = shape.edge_lengths[shape.connectivity.edges.of_side].mean(1)
    far = length_of(away) > _FAR * sides[face]
    return far & (dot(away, nearest) > 0) & (dot(normals, nearest) < _ASIDE)


def membrane_share(shape: Shape, per_face: Float[Tensor, " F"]) -> Float[Tensor, " V"]:
    """The share of the area at each vertex that belongs to webs, from that of each face."""
    area = shape.double_area[:, None]
    whole = shape.connectivity.at_verts(area).clamp_min(torch.finfo(area.dtype).tiny)
    return (shape.connectivity.at_verts(area * per_face[:, None]) / whole)[:, 0]


def membrane_tension(shape: Shape, share: Float[Tensor, " V"], fairness: float) -> Tension:
    """How strongly each edge draws its ends together, and how near.

    Edges that are short already are not drawn, so that no part is strangled: they are for remeshing to take away.

    Args:
        shape: the surface.
        share: of each vertex, that belongs to webs.
        fairness: the weight of smoothness; what is nearly done has webs that are hardly more than noise.
    """
    (tail, head), lengths = shape.connectivity.ends, shape.edge_lengths
    weight = _TENSION * min(fairness / _FULL_FAIRNESS, 1.0) / shape.connectivity.num_verts
    rest = (_REST * lengths.median() / lengths.clamp_min(torch.finfo(lengths.dtype).tiny)).clamp_max(1)
    return Tension(((share[tail] + share[head]) * (weight / 2))[:, None], rest[:, None])
