"""The squared length of edges."""

from jaxtyping import Float
from torch import Tensor

from meshfit.loss.surface import Surface


def edge(verts: Float[Tensor, "V 3"], surface: Surface) -> Float[Tensor, ""]:
    """Mean over edges of the squared length, in squared units of length (Gkioxari, Malik and Johnson 2019)."""
    tail, head = surface.edges
    return (verts.index_select(0, tail) - verts.index_select(0, head)).square().sum(1).mean()
