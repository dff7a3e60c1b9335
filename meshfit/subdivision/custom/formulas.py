"""Weights in user-defined schemes: numbers or formulas, for all valences or for single ones."""

import json
import math
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from pydantic import ValidationError
from pydantic_core import InitErrorDetails

from meshfit.errors import SchemeError
from meshfit.subdivision.custom.expression import Expression, Number, parse_expression
from meshfit.subdivision.masks import CHECKED_VALENCES

Written = float | str
"""A weight as the user writes it: a number or a formula."""

OTHERS = "else"
LARGEST_WEIGHT = 100
_REGULAR = 6
_HUGE = 10**300
_VALENCE = re.compile(r"[3-9]|[1-9][0-9]")

_Rule = TypeVar("_Rule")


def read_formula(written: object, *variables: str) -> Expression:
    """Read a weight as an expression in some variables; decimal numbers are exact.

    Raises:
        SchemeError: it is not a number or a formula; the place is named.
    """
    if isinstance(written, str):
        return parse_expression(written, variables)
    if isinstance(written, bool) or not isinstance(written, int | float) or not math.isfinite(written):
        raise SchemeError(f"expected a number or a formula such as 3/8, found {_shown(written)}")
    return parse_expression(repr(written))


def weight(expression: Expression, **variables: int) -> Number:
    """Return the value of a weight.

    Raises:
        SchemeError: it has none, or one out of range.
    """
    value = expression(**variables)
    if not -LARGEST_WEIGHT <= value <= LARGEST_WEIGHT:
        at = ", ".join(f"{name} = {given}" for name, given in variables.items())
        allowed = f"weights from -{LARGEST_WEIGHT} to {LARGEST_WEIGHT} are allowed"
        raise SchemeError(f"'{expression.text}' is {_digits(value)}{f' at {at}' if at else ''}; {allowed}")
    return value


@dataclass(frozen=True)
class Ring:
    """Total weight of a one-ring by valence: an expression in n for some valences, and one for all others.

    Attributes:
        given: by valence.
        others: for all other valences.
        where: the name of the rule, put in front of messages.
    """

    given: Mapping[int, Expression]
    others: Expression
    where: str = ""

    def __call__(self, valence: int) -> float:
        """Return the weight at a valence."""
        return float(_named_weight(self.where, self.given.get(valence, self.others), n=valence))


@dataclass(frozen=True)
class Spokes:
    """Weights of a one-ring by valence: an expression for each neighbour, or one in n and j for all of them.

    The centre gets the rest to one. Attributes are those of `Ring`.
    """

    given: Mapping[int, Sequence[Expression]]
    others: Expression
    where: str = ""

    def __call__(self, valence: int) -> tuple[float, ...]:
        """Return (centre, s_0, …, s_(n-1)) at a valence."""
        expressions = self.given.get(valence, (self.others,) * valence)
        spokes = [_named_weight(self.where, spoke, n=valence, j=j) for j, spoke in enumerate(expressions)]
        return (float(1 - sum(spokes)), *map(float, spokes))


def read_ring(written: object, where: str = "") -> Ring:
    """Read the weights of one-rings: a formula in n, or one for each of some valences and one for all others.

    Raises:
        SchemeError: a formula that cannot be read, or has no value at a common valence.
        ValidationError: the same, in the entry of a valence.
    """
    entries = _entries(written)
    given = {valence: _at(valence, read_formula, entries[str(valence)], "n") for valence in _valences(entries)}
    ring = Ring(given, _at(OTHERS if given else None, read_formula, entries[OTHERS], "n"), where)
    _check(ring, given)
    return ring


def read_spokes(written: object, where: str = "") -> Spokes:
    """Read the weights of spokes: a formula in n and j, or lists for some valences and a formula for all others.

    Raises:
        SchemeError: a formula that cannot be read, or has no value at a common valence.
        ValidationError: the same, in the entry of a valence, or a list of the wrong length.
    """
    entries = _entries(written)
    given = {valence: _at(valence, _read_list, entries[str(valence)], valence) for valence in _valences(entries)}
    if _REGULAR in given:
        raise error_at((str(_REGULAR),), f"valence {_REGULAR} is regular and uses the mask of other new vertices")
    spokes = Spokes(given, _at(OTHERS if given else None, read_formula, entries[OTHERS], "n", "j"), where)
    _check(spokes, given)
    return spokes


def error_at(key: tuple[str | int, ...], message: str) -> ValidationError:
    """Make the error for a key within the value that is being validated."""
    details = InitErrorDetails(type="value_error", loc=key, input=None, ctx={"error": ValueError(message)})
    return ValidationError.from_exception_data("weights", [details])


def _named_weight(where: str, expression: Expression, **variables: int) -> Number:
    try:
        return weight(expression, **variables)
    except SchemeError as error:
        raise SchemeError(f"{where}{error}") from None


def _entries(written: object) -> Mapping[str, object]:
    """Return the entries by valence, and under `else` for all others; keys are texts, as in JSON."""
    if not isinstance(written, Mapping):
        return {OTHERS: written}
    if OTHERS not in written:
        raise SchemeError(f"expected an entry '{OTHERS}' for all valences that are not listed")
    return {str(key): value for key, value in written.items()}


def _valences(entries: Mapping[str, object]) -> list[int]:
    for key in entries:
        if key != OTHERS and not _VALENCE.fullmatch(key):
            raise error_at((key,), f"expected a valence from 3 to 99, or '{OTHERS}'")
    return [int(key) for key in entries if key != OTHERS]


def _read_list(written: object, valence: int) -> tuple[Expression, ...]:
    if not isinstance(written, Sequence) or isinstance(written, str):
        return (read_formula(written, "n", "j"),) * valence
    if len(written) != valence:
        raise SchemeError(f"expected one weight for each of {valence} neighbours, found {len(written)}")
    return tuple(read_formula(entry, "n") for entry in written)


def _at(key: str | int | None, read: Callable[..., _Rule], *arguments: object) -> _Rule:
    """Read the entry at a key and name the key in errors; None for a single entry without keys."""
    try:
        return read(*arguments)
    except SchemeError as error:
        if key is None:
            raise
        raise error_at((str(key),), str(error)) from None


def _check(rule: Callable[[int], object], given: Mapping[int, object]) -> None:
    """Refuse weights without a value now, rather than on a mesh."""
    for valence in (*given, *CHECKED_VALENCES):
        key = (valence if valence in given else OTHERS) if given else None
        _at(key, rule, valence)


def _digits(value: Number) -> str:
    """Write a number to six digits; a fraction too large for a float is `huge`."""
    return f"{value:g}" if isinstance(value, float) else f"{float(value):g}" if abs(value) < _HUGE else "huge"


def _shown(written: object) -> str:
    return textwrap.shorten(json.dumps(written, default=str), 60, placeholder=" …")
