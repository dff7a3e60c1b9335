"""Strict YAML: its scalars, and refusals in one line."""

import math

import pytest

from meshfit.config.strict_yaml import dump, parse_document, parse_value
from meshfit.errors import ConfigError
from tests.loops import over

NUMBERS = {
    "1e-3": 0.001, "1E5": 1e5, ".5": 0.5, "5.": 5.0, "1.e3": 1000.0, "+.5": 0.5, "-2.5e-3": -0.0025,
    "6.02E+23": 6.02e23,    "0": 0, "-7": -7, "+5": 5, "2000": 2000, "0.0": 0.0, "-.inf": -math.inf, ".Inf": math.inf,
}  # fmt: skip
WORDS = [
    "012", "-012", "00", "0x10", "0o17", "0b1", "1_000", "1:30", "1:30:00", "2024-01-01", "2024-01-01 10:00:00", "1e",
    "e5",    ".", "1.2.3", "yes", "no", "Yes", "NO", "on", "off", "Off", "y", "n", "=", "<<", "true_head.obj",
    "truest", "false-start",    "nullhead.ply", "~/meshes/head.obj", "~x", "1e3x", "12 monkeys", "inf", "nan",
]  # fmt: skip


@over("text", NUMBERS)
def test_numbers(text):
    found = parse_value(text, "it")
    assert found == NUMBERS[text]
    assert type(found) is type(NUMBERS[text])


@over("text", WORDS)
def test_words(text):
    assert parse_value(text, "it") == text
    assert parse_document(f"a: [{text}]", "it").data == {"a": [text]}


@over(
    ("text", "value"),
    [("true", True), ("True", True), ("TRUE", True), ("false", False), ("False", False), ("FALSE", False)]
    + [(text, None) for text in ("null", "Null", "NULL", "~", "")],
)
def test_truth_and_nothing(text, value):
    assert parse_document(f"a: {text}", "it").data["a"] is value


@over("text", ["'1'", '"1"', "'true'", "'~'", "'1e-3'", "! 'no'"])
def test_what_stands_in_quotes_is_a_word(text):
    assert isinstance(parse_value(text, "it"), str)


def test_not_a_number():
    assert math.isnan(parse_value(".nan", "it"))


def test_every_key_and_entry_has_its_line():
    document = parse_document("# c\n\na: 1\nb:\n  c: [x,\n   y]\n  d: {e: 1,\n   f: 2}\n", "it")
    assert document.data == {"a": 1, "b": {"c": ["x", "y"], "d": {"e": 1, "f": 2}}}
    lines = {
        ("a",): 3,
        ("b",): 4,
        ("b", "c"): 5,
        ("b", "c", 1): 6,
        ("b", "d"): 7,
        ("b", "d", "e"): 7,
        ("b", "d", "f"): 8,
    }
    assert lines.items() <= document.lines.items()


REFUSED = {
    "a: 1\nb: 2\na: 3": "it, line 3: duplicate key 'a' (first on line 1)",
    "a:\n  b: 1\n  c: 2\n  b: 3": "it, line 4: duplicate key 'b' (first on line 2)",
    "a: {b: 1,\n b: 2}": "it, line 2: duplicate key 'b' (first on line 1)",
    "a: [{b: 1, b: 2}]": "it, line 1: duplicate key 'b' (first on line 1)",
    "1: x\n'1': y": "it, line 2: duplicate key '1' (first on line 1)",
    "x: 1\na: &b 1": "it: line 2: not valid YAML: anchors and aliases (&name, *name) are not allowed",
    "a: *b": "it: line 1: not valid YAML: anchors and aliases (&name, *name) are not allowed; write the value out",
    "a: &x [*x]": "it: line 1: not valid YAML: anchors and aliases (&name, *name) are not allowed; write the value out",
    "a: !!python/object/apply:os.system ['true']": "it: line 1: not valid YAML: tags (!name) are not allowed",
    "a: !!python/name:os.system ''": "it: line 1: not valid YAML: tags (!name) are not allowed",
    "b: 1\na: !!bool x": "it: line 2: not valid YAML: tags (!name) are not allowed",
    "a: !!timestamp x": "it: line 1: not valid YAML: tags (!name) are not allowed",
    "a: !!set {b}": "it: line 1: not valid YAML: tags (!name) are not allowed",
    "a: !!binary aGk=": "it: line 1: not valid YAML: tags (!name) are not allowed",
    "!!set {a}": "it: line 1: not valid YAML: tags (!name) are not allowed",
    "a: !mine 3": "it: line 1: not valid YAML: tags (!name) are not allowed",
    "b: 1\n\ta: 1": "it: line 2: not valid YAML: found character '\\t' that cannot start any token",
    "a:\n\tb: 1": "it: line 2: not valid YAML: found character '\\t' that cannot start any token",
    "a: [1,\n2": "it: line 2: not valid YAML: ",
    "a: b: c": "it: line 1: not valid YAML: mapping values are not allowed here",
    "a: 'x": "it: line 1: not valid YAML: ",
    "a: \0": "it: not valid YAML: unacceptable character #x0000",
    "a: 1\n---\nb: 2": "it: line 2: not valid YAML: but found another document",
    "? [a]\n: 1": "it: line 1: not valid YAML: found unhashable key",
    "": "it: the file is empty; expected a mapping of settings",
    "# nothing\n\n": "it: the file is empty; expected a mapping of settings",
    "- a": "it: expected a mapping of settings ('key: value' lines), got a list",
    "hello": "it: expected a mapping of settings ('key: value' lines), got a single value",
    "a: " + "9" * 5000: "it: not valid YAML: ",
    "a: " + "[" * 700: "it: nested too deeply",
    "a: " + "{a: " * 700 + "}" * 700: "it: nested too deeply",
    "- " * 700: "it: nested too deeply",
    "".join(" " * i + "a:\n" for i in range(700)): "it: nested too deeply",
}


@over("text", REFUSED)
def test_what_is_refused_is_refused_in_one_line(text):
    with pytest.raises(ConfigError) as caught:
        parse_document(text, "it")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(REFUSED[text])


@over("text", ["{a: 1, a: 2}", "*a", "&a 1", "!!bool x", "[1", "[" * 700, "{[a]: 1}", "1\n---\n2"])
def test_single_values_are_held_to_the_same(text):
    with pytest.raises(ConfigError, match=r"^--set k(: |, line 1: duplicate key 'a')") as caught:
        parse_value(text, "--set k")
    assert "\n" not in str(caught.value)


def test_a_byte_order_mark_and_document_marks_do_no_harm():
    assert parse_document("\ufeff---\na: 1\n...\n", "it").data == {"a": 1}


@over("value", [*WORDS, *NUMBERS, "true", "null", "~", "", "a: b", "# c", "[x]", "é√", " x ", "a\nb", "-"])
def test_what_is_written_is_read_back_as_the_word_it_was(value):
    data = {"a": value, "b": [value, {"c": value}]}
    assert parse_document(dump(data), "it").data == data


@over("value", [0, -3, 10**12, 1.0, 0.1, 1e-9, 1e22, 1.7976931348623157e308, True, False, None, [], [1.5]])
def test_what_is_written_is_read_back_as_the_value_it_was(value):
    found = parse_document(dump({"a": value}), "it").data["a"]
    assert found == value
    assert type(found) is type(value)


def test_keys_keep_their_order_and_lists_stand_on_one_line():
    assert dump({"b": [1, 2], "a": {"z": [], "y": 1.5}}) == "b: [1, 2]\na:\n  z: []\n  y: 1.5\n"
