"""Autograd functions with analytic gradients."""

from typing import Any

from torch.autograd import Function


def apply(function: type[Function], *args: Any) -> Any:  # noqa: ANN401  arguments and results of any function
    """Call `function.apply`, which torch leaves untyped."""
    return function.apply(*args)  # type: ignore[no-untyped-call]
