"""Parsing and printing of specs."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshfit.errors import ConfigError
from meshfit.specs import Spec, parse_spec, suggest
from tests.loops import over

WORD = st.text("abcdefghijklmnopqrstuvwxyz-_", min_size=1, max_size=12)


def is_a_word(text):
    return isinstance(parse_spec(f"a:k={text}").parameters[0][1], str)


VALUE = st.one_of(
    st.integers(-(10**12), 10**12), st.floats(allow_nan=False, allow_infinity=False), WORD.filter(is_a_word)
)
SPEC = st.builds(Spec, WORD, st.lists(st.tuples(WORD, VALUE), max_size=4, unique_by=lambda pair: pair[0]).map(tuple))


@given(SPEC)
def test_what_is_written_is_read_back(spec):
    found = parse_spec(str(spec))
    assert found == spec
    assert [type(value) for _, value in found.parameters] == [type(value) for _, value in spec.parameters]


@given(SPEC, st.sampled_from(["", " ", "\t", "\n"]))
def test_spaces_about_the_parts_do_not_matter(spec, space):
    text = space + str(spec).replace("=", f"{space}={space}").replace(",", f"{space},{space}") + space
    assert parse_spec(text) == spec


@over(
    ("text", "expected"),
    [
        ("loop", Spec("loop")),
        ("interp-loop:alpha=0.5", Spec("interp-loop", (("alpha", 0.5),))),
        ("icosphere:level=3", Spec("icosphere", (("level", 3),))),
        ("a:b=1,c=x", Spec("a", (("b", 1), ("c", "x")))),
        ("a:b=1e-3", Spec("a", (("b", 0.001),))),
        ("a:b=c=d", Spec("a", (("b", "c=d"),))),
        ("√3", Spec("√3")),
    ],
)
def test_known_answers(text, expected):
    assert parse_spec(text) == expected


def test_what_looks_like_a_number_is_one_and_an_integer_stays_one():
    values = dict(parse_spec("a:i=2,f=2.0,e=1e2,n=nan,w=two").parameters)
    assert (values["i"], values["f"], values["e"], values["w"]) == (2, 2.0, 100.0, "two")
    assert isinstance(values["i"], int)
    assert isinstance(values["f"], float)
    assert math.isnan(values["n"])


@over("text", ["", "  ", ":", ":a=1", "two words", "a=1", "a,b", "=", "a b:c=1"])
def test_what_has_no_name_is_refused(text):
    with pytest.raises(ConfigError, match=r"expected a name or 'name:key=value,key=value'$"):
        parse_spec(text)


@over(
    ("text", "pair"),
    [
        ("a:", ""),
        ("a:b", "b"),
        ("a:b=", "b="),
        ("a:=1", "=1"),
        ("a:b=1,", ""),
        ("a:,b=1", ""),
        ("a:b=1,c", "c"),
        ("a::", ":"),
    ],
)
def test_parameters_without_key_or_value_are_refused(text, pair):
    with pytest.raises(ConfigError) as caught:
        parse_spec(text)
    assert str(caught.value) == f"'{text}': expected 'key=value', got '{pair}'"


def test_a_parameter_that_stands_twice_is_refused():
    with pytest.raises(ConfigError, match=r"^'a:b=1,b=2': duplicate parameter$"):
        parse_spec("a:b=1,b=2")


def test_suggestions_name_the_nearest_word_if_one_is_near_and_always_all():
    assert suggest("lop", ["loop", "butterfly"]) == "did you mean 'loop'? allowed: loop, butterfly"
    assert suggest("xyz", iter(["loop", "butterfly"])) == "allowed: loop, butterfly"
