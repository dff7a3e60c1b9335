"""The chamfer distance between two point sets."""

from dataclasses import dataclass

from jaxtyping import Float, Int64
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Matches:
    """Nearest neighbours, constant in the backward pass.

    Attributes:
        forward: (P,) for each p, the index of the nearest q.
        backward: (Q,) for each q, the index of the nearest p.
    """

    forward: Int64[Tensor, " P"]
    backward: Int64[Tensor, " Q"]


def chamfer(p: Float[Tensor, "P 3"], q: Float[Tensor, "Q 3"], matches: Matches) -> Float[Tensor, ""]:
    """Mean squared distance to the nearest point of the other set, both ways added (Fan et al. 2017, eq. 1).

    Differences are taken before they are squared: |p|² + |q|² - 2p·q would lose all digits where p is near q.
    """
    forward = (p - q.index_select(0, matches.forward)).square().sum(1).mean()
    backward = (q - p.index_select(0, matches.backward)).square().sum(1).mean()
    return forward + backward
