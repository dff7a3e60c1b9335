"""Arithmetic formulas for weights, read by Python's own parser and evaluated node by node from a list of operations.

Nothing is executed as Python: every node of the syntax tree has to be on the list. Values are exact fractions as long
as only rational numbers occur.
"""

import ast
import math
import operator
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from types import MappingProxyType

from meshfit.errors import SchemeError
from meshfit.specs import suggest

Number = Fraction | float

LONGEST = 400
"""The most characters of a formula."""
DEEPEST = 16
"""The deepest nesting of parentheses, of calls, signs and powers."""
LARGEST_EXPONENT = 64
_LARGEST_DECIMAL_EXPONENT = 300
_MOST_BITS = 4096
_MOST_ARGUMENTS = 16

_CHARACTERS = re.compile(r"[0-9A-Za-z_.+\-*/^(), ]*")
_WORD = re.compile(r"[\w.]+|\S|$")
_LEADING_ZEROS = re.compile(r"(?<![\w.])0+(?=[0-9])")  # which Python refuses
_NUMBER = re.compile(r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE](?P<exponent>[-+]?[0-9]+))?")


@dataclass(frozen=True)
class Expression:
    """A formula.

    Attributes:
        text: as it was written.
        tree: its syntax tree, all of whose nodes are allowed.
    """

    text: str
    tree: ast.expr = field(compare=False, repr=False)

    def __call__(self, **variables: int) -> Number:
        """Return its value: a `Fraction` where only rational numbers occur in it, else a finite float.

        Raises:
            SchemeError: it has none for these variables; the reason and the variables are named.
        """
        try:
            return _value(self.tree, {name: Fraction(value) for name, value in variables.items()})
        except ZeroDivisionError:
            reason = "divides by zero"
        except OverflowError:
            reason = "is too large a number"
        except ValueError as error:
            reason = str(error)
        at = ", ".join(f"{name} = {value}" for name, value in variables.items())
        raise SchemeError(f"'{self.text}' {reason}{f' at {at}' if at else ''}")


def parse_expression(text: str, variables: Sequence[str] = ()) -> Expression:
    """Read a formula: numbers, variables, pi, + - * / ^ (or **), parentheses, and calls of `FUNCTIONS`.

    Powers bind before signs, as in -2^2 = -4, and from the right, as in 2^3^2 = 2^9.

    Args:
        text: at most 400 characters, nested at most 16 deep.
        variables: the names that may occur in it, such as n.

    Raises:
        SchemeError: it is not such a formula; the place is named.
    """
    text = " ".join(text.split())
    if len(text) > LONGEST:
        raise SchemeError(f"'{text[:40]}…' has {len(text)} characters; {LONGEST} are allowed")
    return Expression(text, _Parser(text, variables).parse())


class _Parser:
    """The syntax tree of one formula, and the place of each of its nodes in messages."""

    def __init__(self, text: str, variables: Sequence[str]) -> None:
        self.text, self.variables = text, variables
        spaced = _LEADING_ZEROS.sub(lambda zeros: " " * len(zeros[0]), text.replace("^", "**"))
        self.source = spaced.lstrip()  # Python refuses an indented expression
        self.indent = len(spaced) - len(self.source)

    def parse(self) -> ast.expr:
        known = _CHARACTERS.match(self.text)
        if known is not None and known.end() < len(self.text):
            raise self._refusal(known.end(), f"found '{self.text[known.end()]}'")
        self._check_parentheses()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what Python warns of here is refused below
                tree = ast.parse(self.source, mode="eval").body
        except SyntaxError as error:
            place = self._place(error.offset - 1) if error.offset else len(self.text)
            raise self._refusal(place, self._finding(place, error.msg)) from None
        self._check(tree, 1)
        return tree

    def _finding(self, place: int, reason: str) -> str:
        if reason.endswith("was never closed"):
            return "this parenthesis is never closed"
        word = _WORD.match(self.text[place:].lstrip())
        return f"found '{word[0]}'" if word is not None and word[0] else "it ends here"

    def _check_parentheses(self) -> None:
        depth = 0
        for place, character in enumerate(self.text):
            depth += {"(": 1, ")": -1}.get(character, 0)
            if depth >= DEEPEST:
                raise self._too_deep(place)

    def _check(self, node: ast.expr, depth: int) -> None:
        """Refuse all nodes but those of formulas, and keep the digits of numbers, so that decimals are exact."""
        place = self._place(node.col_offset)
        if depth > DEEPEST:
            raise self._too_deep(place)
        match node:
            case ast.Constant():
                node.value = self._digits(node, place)
            case ast.Name(id=name):
                self._check_name(name, place, is_function=False)
            case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
                self._check(operand, depth + 1)
            case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _SIGNS:
                self._check(left, depth)
                self._check(right, depth + isinstance(sign, ast.Pow))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                self._check_name(name, place, is_function=True)
                fewest, most = FUNCTIONS[name].fewest, FUNCTIONS[name].most
                if not fewest <= len(arguments) <= most:
                    allowed = f"{fewest} to {most} values" if fewest < most else f"{fewest} value"
                    raise self._error(place, f"{name} takes {allowed}, found {len(arguments)}")
                for argument in arguments:
                    self._check(argument, depth + 1)
            case _:
                raise self._refusal(place, f"found '{self._segment(node)}'")

    def _digits(self, node: ast.Constant, place: int) -> str:
        digits = self._segment(node)
        number = _NUMBER.fullmatch(digits)
        if number is None:
            raise self._error(place, f"found '{digits}'; expected a decimal number such as 12, 0.5 or 1e-3")
        if abs(int(number["exponent"] or 0)) > _LARGEST_DECIMAL_EXPONENT:
            raise self._error(place, f"the exponent of '{digits}' is beyond {_LARGEST_DECIMAL_EXPONENT}")
        return digits

    def _check_name(self, name: str, place: int, *, is_function: bool) -> None:
        known = [*self.variables, "pi", *FUNCTIONS]
        if name not in known:
            raise self._error(place, f"'{name}' is not known here: {suggest(name, known)}")
        if is_function != (name in FUNCTIONS):
            fault = "is not a function" if is_function else "is a function; expected its values in parentheses"
            raise self._error(place, f"'{name}' {fault}")

    def _segment(self, node: ast.expr) -> str:
        return ast.get_source_segment(self.source, node) or ""

    def _place(self, offset: int) -> int:
        """Return the place in the text of an offset in the source, where `^` is written with two characters."""
        place, offset = 0, offset + self.indent
        while offset > 0 and place < len(self.text):
            offset -= 2 if self.text[place] == "^" else 1
            place += 1
        return place

    def _too_deep(self, place: int) -> SchemeError:
        return self._error(place, f"nested more than {DEEPEST} deep")

    def _refusal(self, place: int, finding: str) -> SchemeError:
        names = ", ".join([*self.variables, "pi"])
        allowed = f"numbers, {names}, + - * / ^, parentheses, and {', '.join(FUNCTIONS)}"
        return self._error(place, f"{finding}; allowed: {allowed}")

    def _error(self, place: int, message: str) -> SchemeError:
        return SchemeError(f"'{self.text}', character {place + 1}: {message}")


def _value(node: ast.expr, variables: Mapping[str, Fraction]) -> Number:
    match node:
        case ast.Constant(value=str(digits)):
            return _fraction(digits)
        case ast.Name(id=name):
            return math.pi if name == "pi" else variables[name]
        case ast.UnaryOp(op=sign, operand=operand):
            value = _value(operand, variables)
            return -value if isinstance(sign, ast.USub) else value
        case ast.BinOp(left=left, op=sign, right=right):
            return _bounded(_SIGNS[type(sign)](_value(left, variables), _value(right, variables)))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return _bounded(FUNCTIONS[name].apply(*(_value(argument, variables) for argument in arguments)))
    raise AssertionError(f"a node that was not checked: {ast.dump(node)}")


@cache
def _fraction(digits: str) -> Fraction:
    return Fraction(digits)


def _bounded(value: Number) -> Number:
    """Refuse values that are too large: of fractions, before they have thousands of digits."""
    if _bits(value) > _MOST_BITS if isinstance(value, Fraction) else not math.isfinite(value):
        raise OverflowError
    return value


def _bits(value: Fraction) -> int:
    return max(value.numerator.bit_length(), value.denominator.bit_length())


def _power(base: Number, exponent: Number) -> Number:
    """Bound powers before they are computed, since a few short ones make numbers of a million digits."""
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
class _Function:
    """A function, and how many values it takes: the fewest and the most."""

    apply: Callable[..., Number]
    fewest: int = 1
    most: int = 1


FUNCTIONS: Mapping[str, _Function] = MappingProxyType(
    {
        "cos": _Function(math.cos),
        "sin": _Function(math.sin),
        "sqrt": _Function(_root),
        "min": _Function(min, 2, _MOST_ARGUMENTS),
        "max": _Function(max, 2, _MOST_ARGUMENTS),
    }
)
"""The functions that a formula may call."""

_SIGNS: Mapping[type[ast.operator], Callable[[Number, Number], Number]] = MappingProxyType(
    {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv, ast.Pow: _power}
)
