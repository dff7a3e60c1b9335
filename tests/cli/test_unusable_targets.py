"""Targets that cannot be used: each fails its own trials, the others run, and a rerun tries them again."""

import json
import shutil

import pytest

from meshfit.config.loading import load_experiment
from meshfit.experiment.plan import plan
from tests.cli import invoke, refused, trials_in_this_process
from tests.cli.processes import contents
from tests.loops import over
from tests.small import config_file

CONFIG = """\
targets: [ellipsoid.ply, broken.ply, gone.obj]
schemes: [loop]
seeds: [0, 1]
source: {mesh: octahedron, levels: 1}
fit: {steps: 2, samples: 100}
measure: {samples: 200, points: 200}
device: cpu
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config_file(tmp_path, CONFIG)
    (tmp_path / "broken.ply").write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    return tmp_path


def run(*options):
    with trials_in_this_process():
        return invoke("run", "small.yaml", "-q", *options)


def test_other_targets_run_and_a_rerun_tries_again(folder):
    ran = run()
    assert ran.code == 1
    assert ran.err.count("(2 trials fail, the others run)") == 2
    assert "4 of 6 trials failed" in ran.err
    assert "Trials: 2 of 6 complete, 4 input unusable" in ran.out
    failures = [json.loads(path.read_text()) for path in sorted(folder.glob("runs/small/*/*/*/failure.json"))]
    assert [(record["target"], record["kind"], record["seed"]) for record in failures] == [
        (target, "input", seed) for target in ("broken", "gone") for seed in (0, 1)
    ]
    assert len({record["identity"] for record in failures}) == 4
    assert "its header has no 'end_header'" in failures[0]["message"]
    assert "gone.obj: no such file" in failures[2]["message"]
    status = invoke("status").out
    assert "2 complete · 4 failed" in status
    assert "failed: input (4)" in status

    kept = contents(folder / "runs", "result.json")
    shutil.copy("ellipsoid.ply", "broken.ply")
    again = run()
    assert again.code == 1
    assert "Trials: 4 of 6 complete, 2 input unusable" in again.out
    assert {path: content for path, content in contents(folder / "runs", "result.json").items() if path in kept} == kept
    assert len(list(folder.glob("runs/small/broken/*/*"))) == 2, "the failures are gone"
    assert json.loads(next(folder.glob("runs/small/gone/*/*/failure.json")).read_text())["attempts"] == 2
    shutil.copy("ellipsoid.ply", "gone.ply")
    repaired = run("--set", "targets=ellipsoid.ply,broken.ply", "--name", "small")
    assert (repaired.code, repaired.err) == (0, "")


def test_a_dry_run_names_them_and_runs_nothing(folder):
    ran = invoke("run", "small.yaml", "--dry-run", "--json", "--cluster", "tcp://none:1")
    assert ran.code == 0
    content = json.loads(ran.out)
    assert (content["complete"], content["to_run"], content["unusable"]) == (0, 2, 4)
    assert ["fault" in row for row in content["trials"]] == [False] * 2 + [True] * 4
    ran = invoke("run", "small.yaml", "--dry-run", "--cluster", "tcp://none:1")
    assert "6 trials: 0 complete, 2 to run, 4 whose target cannot be used" in ran.out
    assert not (folder / "runs").exists()


@over(
    ("targets", "words"),
    [
        ("broken.ply", "its header has no 'end_header'"),
        ("ellipsoid.ply,bunyn", "'bunyn' is neither a target nor a file: did you mean 'bunny'?"),
    ],
)
def test_a_config_that_must_be_wrong_is_refused(folder, targets, words):
    assert words in refused("run", "small.yaml", "--targets", targets)
    assert not (folder / "runs").exists()


def test_all_faults_of_a_config_without_a_usable_target_are_named(folder):
    ran = invoke("run", "small.yaml", "--targets", "broken.ply,gone.obj")
    assert (ran.code, ran.err.count("\n")) == (2, 2)


def test_a_search_over_all_targets_is_refused_without_one_of_them(folder):
    pytest.importorskip("optuna")
    sweep = ["--set", "sweep.ranges.fit.steps={linear: [1, 3], integer: true}"]
    ran = invoke("tune", "small.yaml", "--metric", "distance.mean", "--trials", 2, *sweep)
    assert (ran.code, ran.out) == (2, "")
    assert "end_header" in ran.err
    assert not list(folder.glob("runs/*/*/*/*/failure.json"))


def test_an_unusable_target_changes_no_other_trial(folder):
    with_others = plan([load_experiment("small.yaml")])
    alone = plan([load_experiment("small.yaml", ["targets=ellipsoid.ply"])])
    assert [trial.identity for trial in with_others if not trial.fault] == [trial.identity for trial in alone]
    assert [trial.seed for trial in with_others if trial.fault] == [0, 1, 0, 1]


def test_fits_of_which_none_has_a_target_end_with_exit_code_2(folder):
    ran = invoke("fit", "broken.ply", "gone.obj", "-o", "out/")
    assert (ran.code, ran.err.count("error:")) == (2, 2)
