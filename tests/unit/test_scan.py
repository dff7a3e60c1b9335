import json
import os
from collections import Counter

import pytest

from meshfit.errors import MeshfitWarning, StoreError
from meshfit.experiment.status.scan import SCANNED_STATUSES, scan_experiments
from meshfit.experiment.trial_status import TrialStatus
from tests.runs import NOW, begun, complete, failed, held, write_plan


def counts(*roots):
    return {
        experiment.name: {state.value: count for state, count in experiment.counts.items() if count}
        for experiment in scan_experiments(roots, NOW)
    }


@pytest.fixture
def runs(tmp_path):
    complete(tmp_path, seed=0)
    failed(tmp_path, seed=1)
    begun(tmp_path, seed=2)
    complete(tmp_path, seed=9)
    write_plan(tmp_path / "small", [{"seed": seed} for seed in range(5)] + [{"target": "cow", "seed": 7}])
    complete(tmp_path, experiment="old", target="cow")
    return tmp_path


def test_each_experiment_has_its_trials_planned_ones_included(runs):
    with held(next(runs.glob("small/bunny/loop/seed-2-*"))):
        assert counts(runs) == {
            "old": {"complete": 1},
            "small": {"complete": 2, "running": 1, "failed": 1, "waiting": 3},
        }
    assert counts(runs)["small"]["interrupted"] == 1


def test_a_root_may_be_any_folder_and_none_counts_twice(runs):
    whole = counts(runs)
    assert counts(runs / "small") == {"small": whole["small"]}
    assert counts(runs, runs / "small", runs / "small/bunny") == whole
    assert counts(runs / "small/bunny")["small"]["waiting"] == 2
    assert counts(next(runs.glob("small/bunny/loop/seed-1-*"))) == {"small": {"failed": 1}}


def test_folders_are_called_as_they_were_asked_for(runs, monkeypatch):
    monkeypatch.chdir(runs / "small/bunny")
    (experiment,) = scan_experiments([runs / "small/bunny/loop/../../../small"], NOW)
    assert experiment.name == "small"
    for root in (".", "loop", "../../small", ".."):
        (experiment,) = scan_experiments([type(runs)(root)], NOW)
        assert experiment.name == "small"
        found = [trial.path for trial in experiment.trials if trial.status is TrialStatus.COMPLETE]
        assert all(os.path.relpath(path, root) == str(path.relative_to(root)) for path in found)
        assert len(found) == 2


def test_what_the_plan_says_of_a_trial_is_known_and_the_rest_is_read_off_its_folder(tmp_path):
    scheme = "interp-loop:alpha=0.5"
    begun(tmp_path, scheme=scheme, seed=3)
    (found,) = scan_experiments([tmp_path], NOW)[0].trials
    assert (found.scheme, found.seed, len(found.identity)) == ("interp-loop-alpha-0.5", 3, 10)
    write_plan(tmp_path / "small", [{"scheme": scheme, "seed": 3, "variant": "stiff"}])
    (found,) = scan_experiments([tmp_path], NOW)[0].trials
    assert (found.scheme, found.seed, len(found.identity)) == (scheme, 3, 64)
    assert found.label == "bunny · interp-loop:alpha=0.5 · stiff · seed 3"


def test_a_plan_alone_makes_an_experiment(tmp_path):
    write_plan(tmp_path / "small", [{"seed": 0}, {"seed": 1}])
    assert counts(tmp_path) == {"small": {"waiting": 2}}


PLANNED = {"folder": "a", "identity": "b", "target": "c", "target_title": "c", "scheme": "loop", "seed": 0}
PLANNED |= {"variant": "", "steps": 9}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (b"{", "not valid JSON"),
        (b"[]", "expected a JSON object, got a list"),
        ({"schema_version": 2}, "got schema_version 2, expected 1; the next `meshfit run` rewrites it"),
        ({"trials": [{"folder": "a"}]}, "not a plan: no trials.0.identity"),
        ({"trials": 3}, "not a plan: trials is 3, expected a list"),
        ({"trials": ["a"]}, 'not a plan: trials.0 is "a", expected an object'),
        ({"workers": "two"}, 'not a plan: workers is "two", expected a whole number'),
        ({"trials": [PLANNED | {"folder": "/etc"}]}, "the folder '/etc' is not inside the experiment's"),
        ({"trials": [PLANNED | {"folder": "../x"}]}, "the folder '../x' is not inside the experiment's"),
        ({"trials": [PLANNED | {"origin": 3}]}, "not a plan: no origins.3"),
        ({"trials": [PLANNED | {"seed": 1.5}]}, "not a plan: trials.0.seed is 1.5, expected a whole number"),
        ({"view": {"up": "w"}}, 'not a plan: view.up is "w"'),
    ],
)
def test_a_damaged_plan_is_one_clear_line(tmp_path, change, message):
    complete(tmp_path)
    write_plan(tmp_path / "small", [{"seed": 0}])
    path = tmp_path / "small/plan.json"
    path.write_bytes(
        change if isinstance(change, bytes) else json.dumps(json.loads(path.read_text()) | change).encode()
    )
    with pytest.warns(MeshfitWarning) as caught:
        (found,) = scan_experiments([tmp_path], NOW)
    assert found.counts[TrialStatus.COMPLETE] == 1
    (text,) = (str(warning.message) for warning in caught)
    assert text.startswith(f"trials that have not begun are not known: {path}: ")
    assert text.endswith("; the next `meshfit run` rewrites it")
    assert message in text
    assert "\n" not in text


def test_a_place_without_trials_is_refused(tmp_path):
    with pytest.raises(StoreError, match=r"no trial under .*; `meshfit run` makes them"):
        scan_experiments([tmp_path], NOW)


def test_states_add_up(runs):
    for experiment in scan_experiments([runs], NOW):
        assert experiment.counts == {
            state: Counter(t.status for t in experiment.trials)[state] for state in SCANNED_STATUSES
        }
        assert sum(map(len, map(experiment.of, SCANNED_STATUSES))) == len(experiment.trials)
