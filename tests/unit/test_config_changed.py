from meshfit.config.experiment import ExperimentSettings, default_settings, non_default_settings
from meshfit.fitting.settings import METHODS
from meshfit.settings import build, override


def plain(**changes):
    settings = override(ExperimentSettings(), changes)
    return settings.model_dump(mode="json", exclude={"jobs", "threads", "view"})


def test_nothing_is_changed_in_the_defaults_of_any_engine():
    assert non_default_settings(plain()) == {}
    for method in METHODS:
        assert non_default_settings(default_settings(method)) == (
            {} if method == "first-order" else {"fit": {"method": method}}
        )


def test_what_is_changed_is_nested_as_in_a_config():
    found = plain(seeds=[3], fit={"steps": 20, "losses": {"edge": 0.5}}, source={"centre": None})
    assert non_default_settings(found) == {
        "seeds": [3],
        "source": {"centre": None},
        "fit": {"steps": 20, "losses": {"edge": 0.5}},
    }


def test_each_engine_is_compared_with_its_own_defaults():
    wanted = {"fit": {"method": "gauss-newton", "verts": 500}}
    settings = build(ExperimentSettings, wanted)
    assert non_default_settings(settings.model_dump(mode="json")) == wanted | {
        "jobs": "auto",
        "threads": "auto",
        "view": {"up": "auto"},
    }
    assert build(ExperimentSettings, non_default_settings(settings.model_dump(mode="json"))) == settings


def test_settings_that_are_not_known_any_more_are_shown():
    assert non_default_settings({"old": 1, "fit": {"gone": 2}}) == {"old": 1, "fit": {"gone": 2}}
    assert non_default_settings({"fit": 3}) == {"fit": 3}
