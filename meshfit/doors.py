"""Decorator of the functions that users call."""

import typing
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    _Function = TypeVar("_Function")

    def no_type_check(function: _Function) -> _Function:
        """Leave a function's arguments to its own checks, whose messages are for users.

        The checks of shapes and dtypes in tests would refuse a wrong argument before it is reached.
        """
        return function

else:
    no_type_check = typing.no_type_check
