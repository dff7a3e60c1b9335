import json

import pytest

from meshfit.experiment.status.eta import seconds_left
from meshfit.experiment.status.scan import scan_experiments
from tests.runs import NOW, begun, complete, failed, held, write_plan, write_progress


def left(runs):
    (experiment,) = scan_experiments([runs], NOW)
    return seconds_left(experiment)


def planned(runs, *trials, **options):
    write_plan(runs / "small", trials, **options)


def test_nothing_is_left_where_all_is_complete_or_failed(tmp_path):
    complete(tmp_path, seed=0)
    failed(tmp_path, seed=1)
    planned(tmp_path, {"seed": 0}, {"seed": 1})
    assert left(tmp_path) == 0


def test_trials_need_what_those_of_the_same_target_and_scheme_needed_shared_among_workers(tmp_path):
    complete(tmp_path, seed=0, fit_seconds=10, measure_seconds=2)
    complete(tmp_path, seed=1, fit_seconds=14, measure_seconds=4)
    complete(tmp_path, target="cow", fit_seconds=1000)
    planned(tmp_path, *({"seed": seed} for seed in range(6)), {"target": "cow"}, workers=2)
    assert left(tmp_path) == pytest.approx(4 * (12 + 3) / 2)


def test_others_are_scaled_by_their_steps(tmp_path):
    complete(tmp_path, fit_seconds=10, measure_seconds=2)  # of 2000 steps
    planned(tmp_path, {"target": "cow"}, steps=6000, workers=1)
    assert left(tmp_path) == pytest.approx(30 + 2)


def test_the_last_trial_is_not_shared_among_idle_workers(tmp_path):
    complete(tmp_path, fit_seconds=10, measure_seconds=2)
    planned(tmp_path, {"seed": 0}, {"seed": 1}, workers=8)
    assert left(tmp_path) == pytest.approx(12)


def test_variants_are_told_apart(tmp_path):
    complete(tmp_path, seed=0, fit_seconds=10, measure_seconds=0)
    complete(tmp_path, seed=1, fit_seconds=90, measure_seconds=0)
    variants = ({"seed": 0, "variant": "a"}, {"seed": 1, "variant": "b"}, {"seed": 2, "variant": "b"})
    planned(tmp_path, *variants, workers=1)
    assert left(tmp_path) == pytest.approx(90)


def test_complete_trials_that_the_plan_does_not_hold_count_only_where_no_other_does(tmp_path):
    complete(tmp_path, seed=0, fit_seconds=500, measure_seconds=0)
    planned(tmp_path, {"seed": 1}, {"seed": 2}, workers=1)
    assert left(tmp_path) == pytest.approx(1000)
    complete(tmp_path, seed=1, fit_seconds=20, measure_seconds=0)
    assert left(tmp_path) == pytest.approx(20)


def test_running_trials_count_by_their_step(tmp_path):
    complete(tmp_path, seed=0, fit_seconds=10, measure_seconds=2)
    fitting, measuring = begun(tmp_path, seed=1), begun(tmp_path, seed=2)
    write_progress(fitting, step=1500, steps=2000)
    write_progress(measuring, step=2000, steps=2000, phase="measuring")
    planned(tmp_path, *({"seed": seed} for seed in range(3)), workers=1)
    with held(fitting, measuring):
        assert left(tmp_path) == pytest.approx(10 / 4 + 2 + 2)


def test_where_none_is_complete_running_ones_tell_their_pace(tmp_path):
    folder = begun(tmp_path, seed=0)
    write_progress(folder, running=100, step=500, steps=2000)
    planned(tmp_path, {"seed": 0}, {"seed": 1}, workers=1)
    with held(folder):
        assert left(tmp_path) == pytest.approx(300 + 400)


def test_those_of_one_batch_share_its_time(tmp_path):
    folders = [begun(tmp_path, seed=seed) for seed in range(4)]
    for folder in folders:
        write_progress(folder, running=100, step=500, steps=2000)
    planned(tmp_path, *({"seed": seed} for seed in range(4)), workers=1)
    with held(*folders):
        assert left(tmp_path) == pytest.approx(300)


@pytest.mark.parametrize("content", ["{", "{}", '{"seconds": {"fit": null}}'])
def test_unknown_where_nothing_can_be_known(tmp_path, content):
    folder = complete(tmp_path, seed=0)
    (folder / "result.json").write_text(content)
    planned(tmp_path, {"seed": 0}, {"seed": 1})
    assert left(tmp_path) is None
    with held(begun(tmp_path, seed=1)):
        assert left(tmp_path) is None


def test_without_a_plan_what_was_begun_is_left(tmp_path):
    complete(tmp_path, seed=0, fit_seconds=10, measure_seconds=2)
    begun(tmp_path, seed=1)
    assert left(tmp_path) == pytest.approx(12)


def test_results_of_the_second_engine_count_too(tmp_path):
    folder = complete(tmp_path, seed=0, method="gauss-newton")
    assert json.loads((folder / "result.json").read_text())["fit"]["steps"] == 90
    planned(tmp_path, {"seed": 0}, {"seed": 1}, steps=90, workers=1)
    assert left(tmp_path) == pytest.approx(11)
