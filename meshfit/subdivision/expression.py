"""Arithmetic that a user writes for a weight: a tree of listed operations, exact as long as all is rational."""

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from types import MappingProxyType

from meshfit.errors import SchemeError

Number = Fraction | float
LARGEST_EXPONENT = 64
_MOST_BITS = 4096


@dataclass(frozen=True)
class Constant:
    """A number."""

    value: Number


@dataclass(frozen=True)
class Variable:
    """What is known only when the expression is evaluated."""

    name: str


@dataclass(frozen=True)
class Operation:
    """An operation of `OPERATIONS` on some terms."""

    name: str
    operands: "tuple[Term, ...]"


Term = Constant | Variable | Operation


@dataclass(frozen=True)
class Expression:
    """An expression.

    Attributes:
        text: as it was written.
        term: its tree.
    """

    text: str
    term: Term

    def __call__(self, **variables: int) -> Number:
        """Its value: a `Fraction` where only rational numbers occur in it, else a finite float.

        Raises:
            SchemeError: it has none there; the reason and the variables are named.
        """
        try:
            return _value(self.term, {name: Fraction(value) for name, value in variables.items()})
        except ZeroDivisionError:
            reason = "divides by zero"
        except OverflowError:
            reason = "is too large a number"
        except ValueError as error:
            reason = str(error)
        at = ", ".join(f"{name} = {value}" for name, value in variables.items())
        raise SchemeError(f"'{self.text}' {reason}{f' at {at}' if at else ''}")


def _value(term: Term, variables: Mapping[str, Fraction]) -> Number:
    if isinstance(term, Constant):
        return term.value
    if isinstance(term, Variable):
        return variables[term.name]
    result = OPERATIONS[term.name].apply(*(_value(operand, variables) for operand in term.operands))
    if isinstance(result, Fraction):
        if _bits(result) > _MOST_BITS:
            raise OverflowError
    elif not math.isfinite(result):
        raise OverflowError
    return result


def _bits(value: Fraction) -> int:
    return max(value.numerator.bit_length(), value.denominator.bit_length())


def _power(base: Number, exponent: Number) -> Number:
    """Numbers of a million digits are a few short powers away, so these are bounded before they are worked out."""
    if not -LARGEST_EXPONENT <= exponent <= LARGEST_EXPONENT:
        raise ValueError(f"has an exponent beyond {LARGEST_EXPONENT}")
    if base == 0 and exponent < 0:
        raise ZeroDivisionError
    if isinstance(base, Fraction) and isinstance(exponent, Fraction) and exponent.denominator == 1:
        if _bits(base) * abs(exponent) > _MOST_BITS:
            raise OverflowError
        return base**exponent.numerator
    if base < 0 and exponent != int(exponent):
        raise ValueError("takes a root of a negative number")
    return math.pow(base, exponent)


def _root(value: Number) -> float:
    if value < 0:
        raise ValueError("takes a root of a negative number")
    return math.sqrt(value)


@dataclass(frozen=True)
class _Rule:
    """What an operation does, and how many terms it takes: the fewest and the most."""

    apply: Callable[..., Number]
    fewest: int
    most: int


_MANY = 16

FUNCTIONS: Mapping[str, _Rule] = MappingProxyType(
    {
        "cos": _Rule(math.cos, 1, 1),
        "sin": _Rule(math.sin, 1, 1),
        "sqrt": _Rule(_root, 1, 1),
        "min": _Rule(min, 2, _MANY),
        "max": _Rule(max, 2, _MANY),
    }
)
"""The operations that are written as calls."""

NEGATION = "negation"

OPERATIONS: Mapping[str, _Rule] = MappingProxyType(
    {
        "+": _Rule(operator.add, 2, 2),
        "-": _Rule(operator.sub, 2, 2),
        "*": _Rule(operator.mul, 2, 2),
        "/": _Rule(operator.truediv, 2, 2),
        "^": _Rule(_power, 2, 2),
        NEGATION: _Rule(operator.neg, 1, 1),
        **FUNCTIONS,
    }
)
"""Every operation there is."""
