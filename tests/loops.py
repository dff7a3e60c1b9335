"""Loops over many cases within one test."""

import functools
import inspect
from collections.abc import Callable, Collection, Iterable

import pytest


def over(names: str | tuple[str, ...], values: Iterable | Callable[[str], Iterable], ids=None):
    """Call the test once for each value, within one case. Its arguments are those of `pytest.mark.parametrize`.

    A failure carries a note that names the values. A `tmp_path` is a folder of its own for each of them. The values may
    depend on the scheme: a function from the test's `spec` to them.
    """
    arguments = [name.strip() for name in names.split(",")] if isinstance(names, str) else list(names)
    several = len(arguments) > 1 or not isinstance(names, str)
    fixed = values if callable(values) else list(values)

    def decorate(test):
        @functools.wraps(test)
        def looped(**given):
            rows = list(fixed(given["spec"])) if callable(fixed) else fixed
            assert rows
            for number, row in enumerate(rows):
                case = dict(zip(arguments, row if several else [row], strict=True))
                if "tmp_path" in given:
                    case["tmp_path"] = given["tmp_path"] / str(number)
                    case["tmp_path"].mkdir()
                try:
                    test(**(given | case))
                except BaseException as error:
                    error.add_note(f"in the case {case}")
                    raise

        signature = inspect.signature(test)
        left = [parameter for name, parameter in signature.parameters.items() if name not in arguments]
        looped.__signature__ = signature.replace(parameters=left)
        return looped

    return decorate


def each(name: str, values: Iterable, quick: Collection) -> pytest.MarkDecorator:
    """Make one case for each value, of which all but the quick ones belong to the slow tests."""
    cases = [value if value in quick else pytest.param(value, marks=pytest.mark.slow) for value in values]
    return pytest.mark.parametrize(name, cases)
