"""Chamfer distance between two point sets."""

from dataclasses import dataclass
from typing import Any

from jaxtyping import Float, Int64
from torch import Tensor
from torch.autograd.function import Function, once_differentiable

from meshfit.loss.autograd import apply


@dataclass(frozen=True, eq=False)
class Matches:
    """Nearest neighbours between two point sets, constant in the backward pass.

    The points of K problems follow each other, P of each in one set and Q of each in the other.

    Attributes:
        forward: (K P,) row of the nearest q of the same problem, for each p.
        backward: (K Q,) row of the nearest p of the same problem, for each q.
        batch_size: K.
    """

    forward: Int64[Tensor, " KP"]
    backward: Int64[Tensor, " KQ"]
    batch_size: int = 1

    def means(self, values: Float[Tensor, "N *C"]) -> Float[Tensor, " K"]:
        """Return the mean over the points of each problem; columns, if any, are summed."""
        return values.reshape(self.batch_size, -1).sum(1) / (len(values) // self.batch_size)

    def spread(self, values: Float[Tensor, "N 3"], factors: Float[Tensor, " K"]) -> Float[Tensor, "N 3"]:
        """Return values times the factor of their problem over its number of points, as in the gradient of `means`."""
        scale = (factors / (len(values) // self.batch_size))[:, None, None]
        return (values.view(self.batch_size, -1, 3) * scale).view(-1, 3)


def chamfer(p: Float[Tensor, "KP 3"], q: Float[Tensor, "KQ 3"], matches: Matches) -> Float[Tensor, " K"]:
    """Return the mean squared distance to the nearest point of the other set, both ways added (Fan et al. 2017, eq. 1).

    Differences are squared, since |p|² + |q|² - 2p·q loses all digits where p is near q.
    """
    return apply(_Chamfer, p, q, matches)


class _Chamfer(Function):
    """The difference d of a pair adds 2 d / P to the gradient at one point, and its negative at the other."""

    @staticmethod
    def forward(ctx: Any, p: Tensor, q: Tensor, matches: Matches) -> Tensor:  # noqa: ANN401  torch's context
        forward = p - q.index_select(0, matches.forward)
        backward = q - p.index_select(0, matches.backward)
        ctx.save_for_backward(forward, backward)
        ctx.matches = matches
        return matches.means(forward.square()) + matches.means(backward.square())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, None]:  # noqa: ANN401  torch's context
        (forward, backward), matches = ctx.saved_tensors, ctx.matches
        needs_p, needs_q, _ = ctx.needs_input_grad
        twice = 2 * gradient
        at_p = at_q = None
        if needs_p:
            at_p = matches.spread(forward, twice).index_add(0, matches.backward, matches.spread(backward, -twice))
        if needs_q:
            at_q = matches.spread(backward, twice).index_add(0, matches.forward, matches.spread(forward, -twice))
        return at_p, at_q, None
