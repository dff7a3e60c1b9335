"""What holds a surface together while it is fitted: smoothness, and tension where it is to shrink."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from meshfit.fitting.gauss_newton.surface import Connectivity


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
