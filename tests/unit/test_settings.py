"""The base of settings: strict, frozen, merged key by key."""

import json

import numpy as np
import pytest
from pydantic import ValidationError

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.source_settings import SourceSettings
from meshfit.errors import ConfigError
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.measuring.settings import MeasureSettings
from meshfit.settings import build, deep_merge, dotted, override
from tests.loops import over


def test_settings_cannot_be_changed_and_can_be_hashed():
    settings = ExperimentSettings()
    with pytest.raises(ValidationError, match="frozen"):
        settings.seeds = (1,)
    assert hash(settings) == hash(ExperimentSettings())


def test_override_changes_only_what_is_named():
    settings = override(FirstOrderSettings(), {"losses": {"edge": 0.5}, "steps": 3})
    assert settings.losses.edge == 0.5
    assert settings.steps == 3
    assert (
        settings.model_copy(update={"losses": FirstOrderSettings().losses, "steps": FirstOrderSettings().steps})
        == FirstOrderSettings()
    )


def test_override_checks_what_it_changes():
    with pytest.raises(ConfigError, match=r'^losses\.edge: expected a number, got "x"$'):
        override(FirstOrderSettings(), {"losses": {"edge": "x"}})
    with pytest.raises(ConfigError, match=r"^stpes: no such key: did you mean 'steps'\?"):
        override(FirstOrderSettings(), {"stpes": 1})


def test_merging_goes_down_into_mappings_and_replaces_all_else():
    data = {"a": {"b": 1, "c": {"d": 2}}, "e": [1, 2], "f": 5}
    assert deep_merge(data, {"a": {"c": {"x": 9}}, "e": [3], "f": {"g": 1}}) == {
        "a": {"b": 1, "c": {"d": 2, "x": 9}},
        "e": [3],
        "f": {"g": 1},
    }
    assert deep_merge(data, {"a": None}) == {"a": None, "e": [1, 2], "f": 5}
    assert data == {"a": {"b": 1, "c": {"d": 2}}, "e": [1, 2], "f": 5}


def test_where_is_asked_for_the_key_at_fault():
    with pytest.raises(ConfigError, match=r"^<\('losses', 'edge'\)>losses\.edge: expected .* 0 or more, got -1$"):
        build(FirstOrderSettings, {"losses": {"edge": -1}}, lambda key: f"<{key}>")


@over(
    "data",
    [
        {"fit": {"steps": 1e2}},
        {"seeds": [1e0, 3.0], "jobs": 2.0},
        {"fit": {"method": "gauss-newton", "verts": 1e3}},
        {"fit": {"optimizer": {"schedule": {"every": 1e2}}}, "source": {"levels": 2.0}},
    ],
)
def test_a_whole_number_is_an_integer_wherever_one_is_expected(data):
    """Trials are then those of the same settings with integers, by their identity."""

    def as_integers(value):
        if isinstance(value, dict):
            return {key: as_integers(inner) for key, inner in value.items()}
        if isinstance(value, list):
            return [as_integers(inner) for inner in value]
        return int(value) if isinstance(value, float) else value

    dumped = [build(ExperimentSettings, each).model_dump_json() for each in (data, as_integers(data))]
    assert dumped[0] == dumped[1]


@over("value", [1.5, 1e30, "1_000", "1,000", True])
def test_other_values_are_not_integers(value):
    with pytest.raises(ConfigError) as caught:
        build(FirstOrderSettings, {"steps": value})
    remedy = "; write 1000" if isinstance(value, str) else ""
    assert str(caught.value) == f"steps: expected an integer, got {json.dumps(value)}{remedy}"


def test_integers_are_numbers_and_lists_are_tuples_but_nothing_else_is_bent():
    settings = build(ExperimentSettings, {"source": {"radius": 2, "centre": [0, 1, 2]}, "seeds": [3]})
    assert settings.source == SourceSettings(radius=2.0, centre=(0.0, 1.0, 2.0))
    assert settings.seeds == (3,)
    assert isinstance(settings.source.radius, float)
    for bad in ({"seeds": "3"}, {"seeds": {"a": 3}}, {"source": {"radius": "2"}}, {"dtype": 32}, {"source": []}):
        with pytest.raises(ConfigError):
            build(ExperimentSettings, bad)


def test_numpy_scalars_are_as_good_as_pythons():
    assert build(MeasureSettings, {"samples": np.int64(500), "f_score_tau": np.float64(0.5)}).samples == 500


@over(
    ("key", "text"),
    [
        ((), ""),
        (("fit",), "fit"),
        (("fit", "losses", "edge"), "fit.losses.edge"),
        (("seeds", 2), "seeds[2]"),
        (("a", 0, "b"), "a[0].b"),
    ],
)
def test_keys_are_written_with_dots_and_brackets(key, text):
    assert dotted(key) == text


def test_long_findings_are_cut_short():
    with pytest.raises(ConfigError) as caught:
        build(FirstOrderSettings, {"steps": list(range(1000))})
    assert str(caught.value).startswith("steps: expected an integer, got [0, 1, 2, ")
    assert str(caught.value).endswith(" …")
    assert len(str(caught.value)) < 150


def test_json_gives_back_the_settings():
    settings = override(ExperimentSettings(), {"source": {"centre": None}, "fit": {"optimizer": {"lr": 1 / 3}}})
    assert build(ExperimentSettings, json.loads(json.dumps(settings.model_dump(mode="json")))) == settings
