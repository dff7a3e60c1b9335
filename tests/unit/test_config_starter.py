"""The starter config and the JSON Schema agree with the settings models."""

import json
import re

import pytest

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.loading import bundled_configs, load_experiment
from meshfit.config.starter import starter_config
from meshfit.config.strict_yaml import parse_document
from meshfit.errors import ConfigError
from meshfit.settings import Settings, build
from tests.loops import over

LINES = starter_config().splitlines()


def described(settings):
    for name, field in type(settings).model_fields.items():
        yield name, field.description
        value = getattr(settings, name)
        if isinstance(value, Settings):
            yield from described(value)


def test_it_holds_the_defaults():
    assert build(ExperimentSettings, parse_document(starter_config(), "it").data) == ExperimentSettings()


def test_it_loads_as_a_file(tmp_path):
    (tmp_path / "a.yaml").write_text(starter_config(), encoding="utf-8")
    assert load_experiment(str(tmp_path / "a.yaml")).settings == ExperimentSettings()


def test_it_holds_every_key_once_in_order():
    keys = [match[1] for line in LINES if (match := re.match(r" *([a-z_]+):", line))]
    assert keys == [name for name, _ in described(ExperimentSettings())]


def test_every_key_has_its_own_comment_above_it():
    above, found = [], []
    for line in LINES:
        if line.strip().startswith("#"):
            above.append(line.strip().removeprefix("# "))
        elif line.strip():
            found.append(" ".join(above))
            above = []
        else:
            above = []
    expected = [" ".join(description.split()) for _, description in described(ExperimentSettings())]
    assert all(expected)
    assert found == expected


def test_lines_are_short_enough_to_read():
    assert max(map(len, LINES)) <= 120


SCHEMA = json.loads(json.dumps(ExperimentSettings.model_json_schema()))


KINDS = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float), "null": type(None)}


def is_number(value):
    return isinstance(value, int | float)


def known_by_pattern(key, schema):
    return any(re.search(pattern, key) for pattern in schema.get("patternProperties", ()))


# Whether a value breaks a rule, by the rule's word; words that pydantic does not use yet are missing on purpose.
BREAKS = {
    "type": lambda value, rule, _: not isinstance(value, KINDS[rule]) or isinstance(value, bool),
    "properties": lambda value, rule, _: (
        isinstance(value, dict) and any(faulty(value[key], rule.get(key, {})) for key in value)
    ),
    "additionalProperties": lambda value, rule, beside: (
        isinstance(value, dict)
        and any(key not in beside["properties"] and not known_by_pattern(key, beside) for key in value)
        if rule is False
        else isinstance(rule, dict) and isinstance(value, dict) and any(faulty(entry, rule) for entry in value.values())
    ),
    "patternProperties": lambda value, rule, _: any(
        re.search(pattern, key) and faulty(value[key], schema) for pattern, schema in rule.items() for key in value
    ),
    "items": lambda value, rule, _: any(faulty(entry, rule) for entry in value),
    "anyOf": lambda value, rule, _: all(faulty(value, option) for option in rule),
    "oneOf": lambda value, rule, _: sum(not faulty(value, option) for option in rule) != 1,
    "required": lambda value, rule, _: isinstance(value, dict) and not set(rule) <= value.keys(),
    "enum": lambda value, rule, _: value not in rule,
    "const": lambda value, rule, _: value != rule,
    "minItems": lambda value, rule, _: isinstance(value, list) and len(value) < rule,
    "maxItems": lambda value, rule, _: isinstance(value, list) and len(value) > rule,
    "minimum": lambda value, rule, _: is_number(value) and value < rule,
    "maximum": lambda value, rule, _: is_number(value) and value > rule,
    "exclusiveMinimum": lambda value, rule, _: is_number(value) and value <= rule,
    "exclusiveMaximum": lambda value, rule, _: is_number(value) and value >= rule,
}
SILENT = {"title", "examples", "description", "default", "$defs", "prefixItems", "$ref"}


def faulty(value, schema):
    if "$ref" in schema:
        schema = SCHEMA["$defs"][schema["$ref"].removeprefix("#/$defs/")] | schema
    return any(BREAKS[word](value, rule, schema) for word, rule in schema.items() if word not in SILENT)


@over("name", bundled_configs())
def test_the_schema_lets_bundled_configs_through(name):
    data = parse_document(bundled_configs()[name].read_text(encoding="utf-8"), name).data
    assert not faulty(data, SCHEMA)


def test_the_schema_lets_the_starter_through():
    assert not faulty(parse_document(starter_config(), "it").data, SCHEMA)


OWN = {"edge": {"end": "3/8", "opposite": 0.125}, "boundary": "linear"}


@over(
    "own",
    [
        OWN,
        OWN | {"vertex": 0.5, "spokes": "1/n"},
        OWN | {"vertex": {"3": "9/16", "else": "3/8"}, "spokes": {"4": ["3/8", 0, "-1/8", 0], "else": "j/n"}},
        {"split": "sqrt3", "face": {"corner": "1/3"}, "boundary": "ternary-bspline"},
        {"base": "loop", "alpha": 0.5},
    ],
)
def test_the_schema_lets_schemes_of_ones_own_through_as_the_models_do(own):
    data = {"define": {"mine": own}}
    assert not faulty(data, SCHEMA)
    build(ExperimentSettings, data)


@over(
    "own",
    [
        {},
        OWN | {"edge": {"end": [1]}},
        OWN | {"boundary": "ternary-bspline"},
        OWN | {"vertex": {"3": "9/16"}},
        OWN | {"spokes": {"4": [1, 2], "else": 0}},
        OWN | {"base": "loop"},
        OWN | {"split": "sqrt3"},
        {"base": "loop", "alpha": 2},
    ],
)
def test_the_schema_refuses_schemes_that_the_models_refuse(own):
    data = {"define": {"mine": own}}
    assert faulty(data, SCHEMA)
    with pytest.raises(ConfigError):
        build(ExperimentSettings, data)


def test_the_example_in_the_starter_is_one():
    commented = [line.removeprefix("# ") for line in LINES[LINES.index("# define:") :]]
    example = parse_document("\n".join(commented[: commented.index("")]), "it").data
    settings = build(ExperimentSettings, example | {"schemes": ["my-loop", "softer:alpha=0.3"]})
    assert list(settings.define) == ["my-loop", "softer"]


@over(
    "data",
    [
        {"seed": 1},
        {"seeds": []},
        {"seeds": [-1]},
        {"seeds": [True]},
        {"fit": {"steps": "x"}},
        {"fit": {"losses": {"egde": 1}}},
        {"normalise": "Box"},
        {"source": {"levels": 9}},
        {"source": {"radius": 0}},
        {"measure": {"samples": 99}},
    ],
)
def test_the_schema_refuses_what_the_models_refuse(data):
    assert faulty(data, SCHEMA)


def test_the_schema_describes_every_key():
    for part in (SCHEMA, *SCHEMA["$defs"].values()):
        for key, entry in part["properties"].items():
            referred = SCHEMA["$defs"].get(entry.get("$ref", "").removeprefix("#/$defs/"), {})
            assert entry.get("description") or referred.get("description"), key


def test_the_schema_lets_shared_values_through_at_the_top_only():
    assert not faulty({"x-shared": [1], "seeds": [0]}, SCHEMA)
    assert faulty({"y-shared": [1]}, SCHEMA)
    assert faulty({"source": {"x-shared": 1}}, SCHEMA)
