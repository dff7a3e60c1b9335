"""Scan of run directories with their results."""

from collections import Counter

import pytest

from meshfit.errors import MeshfitWarning
from meshfit.experiment.status import results as module
from meshfit.experiment.status.results import scan_with_results
from meshfit.experiment.storage import run_directory
from meshfit.experiment.trial_status import TrialStatus
from tests.runs import NOW, complete, failed, write_plan


@pytest.fixture
def runs(tmp_path):
    for seed in range(3):
        complete(tmp_path, seed=seed)
    failed(tmp_path, seed=3)
    write_plan(tmp_path / "small", [{"seed": seed} for seed in range(5)])
    return tmp_path


def test_each_result_is_read_once(runs, monkeypatch):
    reads = Counter()
    read_json = run_directory.read_json
    monkeypatch.setattr(run_directory, "read_json", lambda path: reads.update([path]) or read_json(path))
    (experiment,), results = scan_with_results([runs], NOW)
    assert [result["seed"] for result in results] == [0, 1, 2]
    assert [trial.status for trial in experiment.trials] == [TrialStatus.COMPLETE] * 3 + ["failed", "waiting"]
    assert {path: count for path, count in reads.items() if path.name == "result.json"} == {
        trial.path / "result.json": 1 for trial in experiment.of(TrialStatus.COMPLETE)
    }


def test_a_trial_that_ends_during_the_scan_has_its_result(runs, monkeypatch):
    scan = module.scan_experiments
    monkeypatch.setattr(
        module, "scan_experiments", lambda *args, **options: complete(runs, seed=4) and scan(*args, **options)
    )
    (experiment,), results = scan_with_results([runs], NOW)
    assert len(experiment.of(TrialStatus.COMPLETE)) == len(results) == 4


def test_a_damaged_result_is_left_out_with_a_warning(runs):
    (complete(runs, seed=5) / "result.json").write_text("{")
    with pytest.warns(MeshfitWarning, match="left out"):
        (experiment,), results = scan_with_results([runs], NOW)
    assert len(results) == 3
    assert len(experiment.of(TrialStatus.DAMAGED)) == 1
