"""Deviation of the normals of matched points."""

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import cosine_similarity

from meshfit.loss.chamfer import Matches

_EPS = 1e-6


def normal(p_normals: Float[Tensor, "KP 3"], q_normals: Float[Tensor, "KQ 3"], matches: Matches) -> Float[Tensor, " K"]:
    """Return the mean of 1 - |cos| between the normals of matched points, both ways added; 0 if all agree up to sign.

    This is the normal distance of Mesh R-CNN (Gkioxari, Malik and Johnson 2019, eq. 2) plus 2, as in PyTorch3D.
    """
    forward = cosine_similarity(p_normals, q_normals.index_select(0, matches.forward), dim=1, eps=_EPS)
    backward = cosine_similarity(q_normals, p_normals.index_select(0, matches.backward), dim=1, eps=_EPS)
    return matches.means(1 - forward.abs()) + matches.means(1 - backward.abs())
