"""Arithmetic that a user writes for a weight: a tree of listed operations, exact as long as all is rational."""

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from types import MappingProxyType

from meshfit.errors import SchemeError
from meshfit.specs import suggest

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


LONGEST = 400
DEEPEST = 16
_LARGEST_DECIMAL_EXPONENT = 300

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z_0-9]*)|(?P<sign>\*\*|[-+*/^(),]))"
)


def parse_expression(text: str, variables: Sequence[str] = ()) -> Expression:
    """Read an expression: numbers, variables, pi, + - * / ^ (or **), parentheses, and the calls of `FUNCTIONS`.

    Powers bind before signs, as in -2^2 = -4, and from the right, as in 2^3^2 = 2^9.

    Args:
        text: at most 400 characters, nested at most 16 deep.
        variables: the names that may stand in it, such as n.

    Raises:
        SchemeError: it is no such expression; the place is named.
    """
    text = " ".join(text.split())
    if len(text) > LONGEST:
        raise SchemeError(f"'{text[:40]}…' has {len(text)} characters; {LONGEST} are allowed")
    return Expression(text, _Reader(text, variables).read())


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    at: int


class _Reader:
    """Recursive descent: a sum is of products, these of signed powers, these of atoms."""

    def __init__(self, text: str, variables: Sequence[str]) -> None:
        self._text, self._variables = text, variables
        self._tokens, self._next, self._depth = self._split(), 0, 0

    def read(self) -> Term:
        term = self._sum()
        if self._token.kind != "end":
            raise self._refusal(self._token, "an operator or the end")
        return term

    def _split(self) -> list[_Token]:
        tokens, at, end = [], 0, len(self._text)
        while at < end:
            found = _TOKEN.match(self._text, at)
            if found is None or found.lastgroup is None:
                raise self._refusal(_Token("", self._text[at:].strip()[0], at), "a number, a name or an operator")
            tokens.append(_Token(found.lastgroup, found[found.lastgroup], found.start(found.lastgroup)))
            at = found.end()
        return [*tokens, _Token("end", "", end)]

    @property
    def _token(self) -> _Token:
        return self._tokens[self._next]

    def _took(self, *signs: str) -> str:
        """The sign that comes next, which is passed, if it is one of these; else nothing."""
        token = self._token
        if token.kind != "sign" or token.text not in signs:
            return ""
        self._next += 1
        return token.text

    def _expect(self, sign: str) -> None:
        if not self._took(sign):
            raise self._refusal(self._token, f"'{sign}'")

    def _chain(self, part: Callable[[], Term], *signs: str) -> Term:
        term = part()
        while sign := self._took(*signs):
            term = Operation(sign, (term, part()))
        return term

    def _sum(self) -> Term:
        return self._chain(self._product, "+", "-")

    def _product(self) -> Term:
        return self._chain(self._signed, "*", "/")

    def _signed(self) -> Term:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self._error(self._token.at, f"nested more than {DEEPEST} deep")
        sign = self._took("-", "+")
        term = self._signed() if sign else self._power()
        self._depth -= 1
        return Operation(NEGATION, (term,)) if sign == "-" else term

    def _power(self) -> Term:
        base = self._atom()
        return Operation("^", (base, self._signed())) if self._took("^", "**") else base

    def _atom(self) -> Term:
        token = self._token
        if self._took("("):
            term = self._sum()
            self._expect(")")
            return term
        if token.kind not in ("number", "name"):
            raise self._refusal(token, "a number, a name or '('")
        self._next += 1
        return self._number(token) if token.kind == "number" else self._named(token)

    def _number(self, token: _Token) -> Constant:
        _, _, exponent = token.text.lower().partition("e")
        if exponent and abs(int(exponent)) > _LARGEST_DECIMAL_EXPONENT:
            raise self._error(token.at, f"the exponent of {token.text} is beyond {_LARGEST_DECIMAL_EXPONENT}")
        return Constant(Fraction(token.text))

    def _named(self, token: _Token) -> Term:
        if token.text in FUNCTIONS:
            return Operation(token.text, self._arguments(token))
        if token.text == "pi":
            return Constant(math.pi)
        if token.text not in self._variables:
            known = [*self._variables, "pi", *FUNCTIONS]
            raise self._error(token.at, f"'{token.text}' is not known here: {suggest(token.text, known)}")
        return Variable(token.text)

    def _arguments(self, token: _Token) -> tuple[Term, ...]:
        self._expect("(")
        arguments = [self._sum()]
        while self._took(","):
            arguments.append(self._sum())
        self._expect(")")
        rule = FUNCTIONS[token.text]
        if not rule.fewest <= len(arguments) <= rule.most:
            allowed = f"{rule.fewest}" if rule.fewest == rule.most else f"{rule.fewest} to {rule.most}"
            raise self._error(token.at, f"{token.text} takes {allowed} values, found {len(arguments)}")
        return tuple(arguments)

    def _refusal(self, token: _Token, needed: str) -> SchemeError:
        found = f"found '{token.text}'" if token.text else "it ends here"
        return self._error(token.at, f"{found}; {needed} is needed")

    def _error(self, at: int, what: str) -> SchemeError:
        return SchemeError(f"'{self._text}', character {at + 1}: {what}")
