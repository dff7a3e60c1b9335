"""Strict YAML: its scalars, and refusals in one line."""

import math

import pytest
import yaml

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


GROWING = "a: &a [1]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
DEEP = "".join(f"k{i}: &k{i} {'[' * 99}{f'*k{i - 1}' if i else ''}{']' * 99}\n" for i in range(12))
REFUSED = {
    "a: 1\nb: 2\na: 3": "it, line 3: duplicate key 'a' (first on line 1)",
    "a:\n  b: 1\n  c: 2\n  b: 3": "it, line 4: duplicate key 'b' (first on line 2)",
    "a: {b: 1,\n b: 2}": "it, line 2: duplicate key 'b' (first on line 1)",
    "a: [{b: 1, b: 2}]": "it, line 1: duplicate key 'b' (first on line 1)",
    "1: x\n'1': y": "it, line 2: duplicate key '1' (first on line 1)",
    "a: *b": "it: line 1: not valid YAML: found undefined alias 'b'",
    "a: &x 1\nb: &x 2": "it: line 2: not valid YAML: second occurrence",
    "a: &x [*x]": "it: line 1: not valid YAML: *x stands inside &x, which would never end",
    "a: &x\n  b: [&y {c: *y}]": "it: line 2: not valid YAML: *y stands inside &y",
    "a: &x\n  <<: *x": "it: line 2: not valid YAML: *x stands inside &x",
    "a: &x {b: 1, b: 2}\nc: *x": "it, line 1: duplicate key 'b' (first on line 1)",
    "a: &x {b: 1}\nc:\n  <<: *x\n  <<: *x": "it, line 4: duplicate key '<<' (first on line 3)",
    "a: &x 1\nc:\n  <<: *x": "it, line 3: <<: expected a mapping such as *name, or a list of them, got a single value",
    "a: &x [1]\n<<: *x": "it, line 2: <<: expected a mapping such as *name, or a list of them, got a single value",
    "a: &a [1]\n"
    + "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)): (
        "it, line 5: aliases (*name) make more than 10,000 values; use fewer of them"
    ),
    "".join(
        f"k{i}: &k{i} {'[' * 99}{f'*k{i - 1}' if i else ''}{']' * 99}\n" for i in range(12)
    ): "it: nested too deeply",
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


@over("text", ["{a: 1, a: 2}", "*a", "&a [*a]", "!!bool x", "[1", "[" * 700, "{[a]: 1}", "1\n---\n2"])
def test_single_values_are_held_to_the_same(text):
    with pytest.raises(ConfigError, match=r"^--set k(: |, line 1: duplicate key 'a')") as caught:
        parse_value(text, "--set k")
    assert "\n" not in str(caught.value)


@over(
    ("text", "value"),
    [
        ("a: &x [1, {b: 2}]\nc: *x", {"a": [1, {"b": 2}], "c": [1, {"b": 2}]}),
        ("a: &x\nb: *x", {"a": None, "b": None}),
        ("a: &x {p: 1, q: 2}\nb:\n  <<: *x\n  q: 3", {"a": {"p": 1, "q": 2}, "b": {"p": 1, "q": 3}}),
        ("a: &x {p: 1}\nb: {q: 3, p: 2, <<: *x}", {"a": {"p": 1}, "b": {"q": 3, "p": 2}}),
        ("b: {<<: [&x {p: 1}, {p: 2, q: 2}]}\nc: *x", {"b": {"p": 1, "q": 2}, "c": {"p": 1}}),
        ("a: &x {p: 1}\nc: &y {<<: *x}\nb: {<<: *y}", {"a": {"p": 1}, "c": {"p": 1}, "b": {"p": 1}}),
        ("a: {<<: {p: 1}}\nb: {<<: []}\nc: {'<<': 1}", {"a": {"p": 1}, "b": {}, "c": {"<<": 1}}),
        # A mapping is replaced, not merged with one of the same key; merged keys stand where the merge key does.
        ("a: &x {p: {q: 1}, z: 0}\nb: {y: 1, <<: *x, p: {}}",
         {"a": {"p": {"q": 1}, "z": 0}, "b": {"y": 1, "z": 0, "p": {}}}),
    ],
)  # fmt: skip
def test_aliases_and_merge_keys(text, value):
    data = parse_document(text, "it").data
    assert data == value
    assert list(data.get("b") or ()) == list(value.get("b") or ())
    assert yaml.safe_load(text) == value or "'<<'" in text  # which PyYAML takes for a merge key


def test_aliases_are_values_of_their_own_with_the_line_where_they_are_written():
    document = parse_document("a: &x\n  p: 1\n  q: [2]\nb:\n  <<: *x\n  r: 3\nc: *x\n", "it")
    lines = {("b", "p"): 2, ("b", "q", 0): 3, ("b", "r"): 6, ("c",): 7, ("c", "q"): 3}
    assert lines.items() <= document.lines.items()
    document.data["a"]["q"].append(4)
    assert document.data["b"]["q"] == document.data["c"]["q"] == [2]


def test_as_many_values_by_aliases_as_the_bound_and_any_number_without():
    many = f"a: &x [{', '.join(['1'] * 999)}]\nb: [{', '.join(['*x'] * 10)}]"
    assert parse_document(many, "it").data["b"] == [[1] * 999] * 10
    with pytest.raises(ConfigError, match="make more than 10,000 values"):
        parse_document(many + "\nc: *x", "it")
    assert parse_document(f"a: [{', '.join(['1'] * 10_001)}]", "it").data["a"] == [1] * 10_001


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


def test_every_duplicate_key_is_reported_once():
    text = "a: &x {b: 1, b: 2, b: 3}\nc: *x\na: 4\n"
    with pytest.raises(ConfigError) as caught:
        parse_document(text, "it")
    twice = "it, line 1: duplicate key 'b' (first on line 1)"
    assert caught.value.faults == ("it, line 3: duplicate key 'a' (first on line 1)", twice)
