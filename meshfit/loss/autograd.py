"""Autograd functions with analytic gradients."""

from typing import Any

from torch import Tensor
from torch.autograd import Function


def apply(function: type[Function], *args: Any) -> Tensor:  # noqa: ANN401  arguments of any function
    """Return the one result of `function.apply`, which torch leaves untyped."""
    result: Tensor = function.apply(*args)  # type: ignore[no-untyped-call]
    return result
