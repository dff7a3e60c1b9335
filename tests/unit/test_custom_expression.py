"""Formulas: values against Python's own fractions, and texts that are refused, quickly and with their place."""

import math
import operator
import time
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshfit.errors import SchemeError
from meshfit.subdivision.custom.expression import LONGEST, parse_expression
from tests.loops import over

VARIABLES = ("n", "j")


def value(text, **variables):
    return parse_expression(text, VARIABLES)(**variables)


# A tree is a pair: its text, and a function from the variables to its value in Python's fractions.
def _spaced(text):
    return st.sampled_from([text, f" {text} ", f"({text})", f"( {text})"])


NUMBERS = st.one_of(
    st.integers(0, 99).map(lambda one: (str(one), Fraction(one))),
    st.tuples(st.integers(0, 99), st.integers(0, 999)).map(
        lambda two: (f"{two[0]}.{two[1]:03}", Fraction(two[0] * 1000 + two[1], 1000))
    ),
    st.integers(0, 99).map(lambda one: (f".{one:02}e-1", Fraction(one, 1000))),
).map(lambda pair: (pair[0], lambda n, j, known=pair[1]: known))
LEAVES = st.one_of(
    NUMBERS,
    st.just(("n", lambda n, j: Fraction(n))),
    st.just(("j", lambda n, j: Fraction(j))),
)
SIGNS = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}


def _extended(trees):
    # Every operand in parentheses: what binds before what is tried below, on its own.
    binary = st.tuples(trees, st.sampled_from(sorted(SIGNS)), trees).map(
        lambda of: (
            f"({of[0][0]}) {of[1]} ({of[2][0]})",
            lambda n, j: SIGNS[of[1]](of[0][1](n, j), of[2][1](n, j)),
        )
    )
    power = st.tuples(trees, st.sampled_from(["^", "**"]), st.integers(0, 3)).map(
        lambda of: (f"({of[0][0]}){of[1]}{of[2]}", lambda n, j: of[0][1](n, j) ** of[2])
    )
    negated = trees.map(lambda tree: (f"-({tree[0]})", lambda n, j: -tree[1](n, j)))
    extreme = st.tuples(st.sampled_from(["min", "max"]), trees, trees).map(
        lambda of: (
            f"{of[0]}({of[1][0]}, {of[2][0]})",
            lambda n, j: {"min": min, "max": max}[of[0]](of[1][1](n, j), of[2][1](n, j)),
        )
    )
    return st.one_of(binary, power, negated, extreme)


@settings(deadline=None)
@given(st.recursive(LEAVES, _extended, max_leaves=8), st.integers(3, 12), st.integers(0, 11))
def test_rational_formulas_are_exact(tree, n, j):
    text, expected = tree
    try:
        wanted = expected(n, j)
    except ZeroDivisionError:
        with pytest.raises(SchemeError, match="divides by zero at n = "):
            value(text, n=n, j=j)
        return
    if len(text) <= LONGEST and max(abs(wanted.numerator), wanted.denominator).bit_length() < 1000:
        found = value(text, n=n, j=j)
        assert isinstance(found, Fraction)
        assert found == wanted


FLAT = st.lists(st.tuples(st.sampled_from(["+", "-", "*", "/"]), st.integers(1, 9)), max_size=12)


@settings(deadline=None)
@given(st.integers(1, 9), FLAT)
def test_signs_bind_as_pythons_do(first, rest):
    text = str(first) + "".join(sign + str(number) for sign, number in rest)
    in_python = f"Fraction({first})" + "".join(f"{sign}Fraction({number})" for sign, number in rest)
    assert value(text) == eval(in_python, {"Fraction": Fraction})


@over(
    ("text", "expected"),
    [
        ("-2^2", -4),
        ("2^3^2", 512),
        ("2**-1", Fraction(1, 2)),
        ("- -3", 3),
        ("+3", 3),
        ("2*-3", -6),
        ("1 - 2 - 3", -4),
        ("8/4/2", 1),
        ("0.1", Fraction(1, 10)),
        ("1e-2", Fraction(1, 100)),
        ("5.", 5),
        ("007", 7),
        ("00.5 + 01^02", Fraction(3, 2)),
        ("min(3, 2, 5/2)", 2),
        ("\n 1 +\n 2 ", 3),
    ],
)
def test_values(text, expected):
    found = value(text)
    assert (found, type(found)) == (expected, Fraction)


@over("n", [3, 4, 5, 6, 7, 12, 28])
def test_loops_and_zorins_weights_are_those_of_python(n):
    assert value("5/8 - (3/8 + cos(2*pi/n)/4)^2", n=n) == 5 / 8 - (3 / 8 + math.cos(2 * math.pi / n) / 4) ** 2
    for j in range(n):
        found = value("(1/4 + cos(2*pi*j/n) + cos(4*pi*j/n)/2)/n", n=n, j=j)
        assert found == pytest.approx(
            (1 / 4 + math.cos(2 * math.pi * j / n) + math.cos(4 * math.pi * j / n) / 2) / n, abs=1e-14
        )


def test_functions():
    assert value("sqrt(2)") == math.sqrt(2)
    assert value("sin(pi/6)") == math.sin(math.pi / 6)
    assert value("max(sqrt(2), 3/2)") == Fraction(3, 2)
    assert value("sqrt(2)^2.5") == pytest.approx(2**1.25, rel=1e-15)


REFUSED = {
    "": "character 1: it ends here; allowed: numbers, n, j, pi, + - * / ^, parentheses, and cos, sin, sqrt, min, max",
    "3/": "character 3: it ends here",
    "(1": "character 1: this parenthesis is never closed",
    "1)": "character 2: found ')'",
    "2n": "character 1: found '2n'",
    "1 2": "found '",
    "2^^2": "character 3: found '^'",
    "k": "'k' is not known here: allowed: n, j, pi, cos",
    "cso(n)": "did you mean 'cos'?",
    "2^cso(n)": "character 3: 'cso' is not known here",
    "cos": "'cos' is a function; expected its values in parentheses",
    "cos()": "cos takes 1 value, found 0",
    "cos(1, 2)": "cos takes 1 value, found 2",
    "min(1)": "min takes 2 to 16 values, found 1",
    "pi(1)": "'pi' is not a function",
    "n(1)": "'n' is not a function",
    "1(2)": "found '1(2)'",
    "n.real": "character 1: found 'n.real'",
    "1 .real": "found '1 .real'",
    "n[0]": "character 2: found '['",
    "[1]": "found '['",
    "'a'": "found '''",
    "x = 1": "found '='",
    "1 if n else 2": "found '1 if n else 2'",
    "1if n else 2": "found '1if n else 2'",
    "n or 1": "found 'n or 1'",
    "not n": "found 'not n'",
    "n in n": "found 'n in n'",
    "min(n for n in n)": "min takes 2 to 16 values, found 1",
    "max(1, (n for n in n))": "found '(n for n in n)'",
    "min(*n, 1)": "found '*n'",
    "min(**n)": "found 'min(",
    "(1, 2)": "found '(1, 2)'",
    "None": "found 'None'; expected a decimal number",
    "...": "found '...'",
    "lambda: 1": "found ':'",
    "__import__('os').system('true')": "found '''",
    "exit()": "'exit' is not known here",
    "cos.__class__(1)": "found 'cos.__class__(1)'",
    "(1).__class__": "found '(1).__class__'",
    "().__class__": "found '().__class__'",
    "()": "found '()'",
    "1_000": "found '1_000'; expected a decimal number",
    "0x10": "found '0x10'; expected a decimal number",
    "1j": "found '1j'; expected a decimal number",
    "nan": "'nan' is not known here",
    "inf": "'inf' is not known here",
    "½": "found '½'",
    "1 // 2": "found '1 // 2'",
    "1 % 2": "found '%'",
    "n < 3": "found '<'",
    "~1": "found '~'",
    "1e999999999": "is beyond 300",
    "1" * (LONGEST + 1): f"{LONGEST} are allowed",
    "(" * 200 + "1" + ")" * 199: "nested more than 16 deep",
    "-" * 300 + "1": "nested more than 16 deep",
    "2^" * 100 + "2": "nested more than 16 deep",
    "cos(" * 60 + "1" + ")" * 60: "nested more than 16 deep",
    "cos(-" * 9 + "1" + ")" * 9: "nested more than 16 deep",
}


def test_what_is_no_formula_is_refused_with_its_place():
    for text, message in REFUSED.items():
        start = time.perf_counter()
        with pytest.raises(SchemeError) as caught:
            parse_expression(text, VARIABLES)
        assert time.perf_counter() - start < 0.5
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)


WITHOUT_VALUE = {
    "1/(n-6)": "'1/(n-6)' divides by zero at n = 6, j = 0",
    "0^-1": "divides by zero",
    "sqrt(2)*0/0": "divides by zero",
    "sqrt(5-n)": "takes a root of a negative number at n = 6",
    "(-1)^0.5": "takes a root of a negative number",
    "(-1)^(1/3)": "takes a root of a negative number",
    "2^65": "has an exponent beyond 64",
    "2^n^n": "has an exponent beyond 64",
    "9^64^1^64 * (9^64)^64": "is too large a number",
    "((((9^60)^60)^60)^60)": "is too large a number",
    "1e300*1e300*1e300*1e300*1e300*1e300": "is too large a number",
    "sqrt(1e300)^3": "is too large a number",
    "cos(1e300*1e300)": "is too large a number",
    "1e300*1e300 + pi": "is too large a number",
}


def test_what_has_no_value_is_refused_with_the_valence():
    for text, message in WITHOUT_VALUE.items():
        start = time.perf_counter()
        with pytest.raises(SchemeError) as caught:
            value(text, n=6, j=0)
        assert time.perf_counter() - start < 0.5
        assert message in str(caught.value)


LETTERS = st.text(st.sampled_from("0123456789.eE+-*/^(), nj_cosinqrtmaxp½'\"[]\n"), max_size=60)


@settings(deadline=None)
@given(LETTERS)
def test_any_text_has_a_value_or_is_refused_in_one_line(text):
    try:
        found, said = value(text, n=5, j=2), ""
    except SchemeError as error:
        found, said = Fraction(0), str(error)
    assert isinstance(found, Fraction) or math.isfinite(found)
    assert "\n" not in said


def test_what_is_nested_as_deep_as_is_allowed_can_be_read():
    assert value("(" * 15 + "1" + ")" * 15) == 1
    assert value("-" * 15 + "1") == -1


def test_a_long_chain_is_no_deep_nest():
    assert value("+".join(["1"] * 200)) == 200
