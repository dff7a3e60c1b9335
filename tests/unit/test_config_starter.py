"""The starter config and the JSON Schema say what the models say."""

import json
import re

import pytest

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.load import bundled_configs, load_experiment
from meshfit.config.starter import starter_config
from meshfit.config.strict_yaml import parse_document
from meshfit.settings import Settings, build

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


def faults(value, schema, where="it"):
    """A small checker of the words of JSON Schema that pydantic uses; any other word is an error of the test."""
    if "$ref" in schema:
        schema = SCHEMA["$defs"][schema["$ref"].removeprefix("#/$defs/")] | {
            k: v for k, v in schema.items() if k != "$ref"
        }
    kinds = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float), "null": type(None)}
    for word, rule in schema.items():
        match word:
            case "title" | "description" | "default" | "$defs" | "prefixItems":
                bad = False
            case "type":
                bad = not isinstance(value, kinds[rule]) or isinstance(value, bool)
            case "properties":
                bad = any(
                    [*(fault for key in value for fault in faults(value[key], rule.get(key, {}), f"{where}.{key}"))]
                )
            case "additionalProperties":
                bad = rule is False and not value.keys() <= schema["properties"].keys()
            case "items":
                bad = any(fault for entry in value for fault in faults(entry, rule, where))
            case "anyOf":
                bad = all(list(faults(value, option, where)) for option in rule)
            case "enum":
                bad = value not in rule
            case "const":
                bad = value != rule
            case "minItems":
                bad = len(value) < rule
            case "maxItems":
                bad = len(value) > rule
            case "minimum":
                bad = isinstance(value, int | float) and value < rule
            case "maximum":
                bad = isinstance(value, int | float) and value > rule
            case "exclusiveMinimum":
                bad = isinstance(value, int | float) and value <= rule
            case "exclusiveMaximum":
                bad = isinstance(value, int | float) and value >= rule
            case _:
                raise AssertionError(f"{where}: the schema has the word {word}, which this test does not know")
        if bad:
            yield f"{where}: {word} {rule}"


@pytest.mark.parametrize("name", bundled_configs())
def test_the_schema_lets_bundled_configs_through(name):
    data = parse_document(bundled_configs()[name].read_text(encoding="utf-8"), name).data
    assert list(faults(data, SCHEMA)) == []


def test_the_schema_lets_the_starter_through():
    assert list(faults(parse_document(starter_config(), "it").data, SCHEMA)) == []


@pytest.mark.parametrize(
    "data",
    [{"seed": 1}, {"seeds": []}, {"seeds": [-1]}, {"fit": {"steps": "x"}}, {"fit": {"losses": {"egde": 1}}}]
    + [{"normalise": "Box"}, {"source": {"levels": 9}}, {"source": {"radius": 0}}, {"measure": {"samples": 99}}],
)
def test_the_schema_refuses_what_the_models_refuse(data):
    assert list(faults(data, SCHEMA))


def test_the_schema_describes_every_key():
    for part in (SCHEMA, *SCHEMA["$defs"].values()):
        for key, entry in part["properties"].items():
            referred = SCHEMA["$defs"].get(entry.get("$ref", "").removeprefix("#/$defs/"), {})
            assert entry.get("description") or referred.get("description"), key
