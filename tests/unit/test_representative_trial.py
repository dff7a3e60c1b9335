import pytest

from meshfit.errors import ConfigError, SchemeError
from meshfit.report.figures.representative_trial import select_trials
from tests.runs import place, result_of

METRIC = "hausdorff.symmetric"


def results(*names, **facts):
    return [result_of(*each, **facts) | {"folder": str(place(*each))} for each in names]


def grid(seeds, targets=("bunny", "cow"), schemes=("interp-loop", "loop")):
    return results(*((target, scheme, seed) for target in targets for scheme in schemes for seed in seeds))


@pytest.mark.parametrize(("seeds", "median"), [([0], 0), ([0, 1, 2], 1), ([5, 3, 1, 8], 3), ([9, 2], 2)])
def test_the_median_seed_stands_for_all(seeds, median):
    picked = select_trials(grid(seeds), METRIC)
    assert [each.title for each in picked] == ["the bunny", "the cow"]
    for target in picked:
        assert [pick.scheme for pick in target.trials] == ["loop", "interp-loop"]
        for pick in target.trials:
            assert (pick.seed, pick.seeds, pick.value) == (median, len(seeds), 0.1 + median / 3)
            assert pick.folder.name.startswith(f"seed-{median}-")
            assert pick.folder.parent.name == pick.scheme


def test_targets_and_schemes_are_those_asked_for_in_that_order():
    picked = select_trials(grid([0]), METRIC, targets=["cow", "bunny"], schemes=["interp-loop", "loop"])
    assert [each.title for each in picked] == ["the cow", "the bunny"]
    assert [pick.scheme for pick in picked[0].trials] == ["interp-loop", "loop"]
    assert len(select_trials(grid([0]), METRIC, targets=["cow"], schemes=["loop"])[0].trials) == 1


def test_other_settings_are_other_rows_below_their_target_and_say_so():
    both = grid([0]) + results(("cow", "loop", 0), experiment="other", steps=7)
    titles = [each.title for each in select_trials(both, METRIC, targets=["cow", "bunny"])]
    assert titles == ["the cow (small)", "the cow (other)", "the bunny (small)"]
    swept = grid([0]) + results(("cow", "loop", 0), steps=7)
    titles = [each.title for each in select_trials(swept, METRIC)]
    assert len(set(titles)) == 3
    assert titles[-1] == "the cow (steps=7)"


def test_what_is_not_there_is_refused():
    with pytest.raises(ConfigError, match="target 'cwo': did you mean 'cow'"):
        select_trials(grid([0]), METRIC, targets=["cwo"])
    with pytest.raises(ConfigError, match="scheme 'butterfly'"):
        select_trials(grid([0]), METRIC, schemes=["butterfly"])
    with pytest.raises(SchemeError):
        select_trials(grid([0]), METRIC, schemes=["lop"])
    with pytest.raises(ConfigError, match="not a metric"):
        select_trials(grid([0]), "size")
