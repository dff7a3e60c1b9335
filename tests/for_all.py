"""Tests over many values that count as one case."""

import functools
import inspect


def for_all(names, values):
    """Run a test for all values, as `pytest.mark.parametrize` does, but as one case; note the value at fault.

    Each value has a `tmp_path` of its own.
    """
    names = [name.strip() for name in names.split(",")] if isinstance(names, str) else list(names)
    values = list(values)

    def decorate(test):
        signature = inspect.signature(test)

        @functools.wraps(test)
        def run(**fixtures):
            for number, value in enumerate(values):
                given = dict(fixtures)
                if "tmp_path" in given:
                    given["tmp_path"] = fixtures["tmp_path"] / str(number)
                    given["tmp_path"].mkdir()
                try:
                    test(**given, **dict(zip(names, value if len(names) > 1 else [value], strict=True)))
                except BaseException as error:
                    error.add_note(f"with {', '.join(names)} = {value!r}")
                    raise

        run.__signature__ = signature.replace(
            parameters=[given for given in signature.parameters.values() if given.name not in names]
        )
        return run

    return decorate
