"""Functions that bring their own gradient."""

from typing import Any

from torch.autograd import Function


def apply(function: type[Function], *args: Any) -> Any:  # noqa: ANN401  whatever the function takes and gives
    """The function of these arguments; torch leaves `apply` untyped."""
    return function.apply(*args)  # type: ignore[no-untyped-call]
