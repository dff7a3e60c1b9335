import csv
import io
import json
import re
import shutil

import pytest

from tests.cli import refused
from tests.cli.processes import contents, meshfit
from tests.small import config_file


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A folder in which the small experiment was run, and what that printed."""
    folder = tmp_path_factory.mktemp("complete")
    return folder, meshfit("run", config_file(folder), folder=folder)


SMALL = ("--config", "small.yaml")


@pytest.fixture
def copied(complete, tmp_path):
    shutil.copytree(complete[0], tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_run_ends_in_a_table_and_a_second_run_does_nothing(complete):
    folder, (out, err) = complete
    assert "Hausdorff distance" in out
    assert "interp-loop" in out
    assert "[4/4]" in err
    assert "Results: runs/small" in out
    before = contents(folder / "runs", "result.json")
    assert len(before) == 4
    again, _ = meshfit("run", "small.yaml", folder=folder)
    assert again == out
    assert contents(folder / "runs", "result.json") == before


@pytest.mark.slow
def test_dry_run_tells_what_is_complete_and_writes_nothing(complete):
    folder, _ = complete
    out, _ = meshfit("run", "small.yaml", "--dry-run", "--runs", "elsewhere", folder=folder)
    assert "4 trials: 0 complete, 4 to run" in out
    assert not (folder / "elsewhere").exists()
    out, _ = meshfit("run", "small.yaml", "--dry-run", "--json", "--set", "seeds=[1, 2]", folder=folder)
    assert [row["complete"] for row in json.loads(out)["trials"]] == [True, False, True, False]


def test_json_goes_to_stdout_alone(complete):
    out, _ = meshfit("run", "small.yaml", "--json", folder=complete[0])
    results = json.loads(out)
    assert [result["scheme"] for result in results] == ["loop", "loop", "interp-loop", "interp-loop"]
    assert all(result["hausdorff"]["symmetric"] > 0 for result in results)


@pytest.mark.slow
def test_compare_runs_what_is_missing_and_pairs_by_seed(copied):
    before = contents(copied / "runs", "result.json")
    arguments = ("compare", "loop", "butterfly:tension=0.05", "--config", "small.yaml", "--seeds", "2")
    out, err = meshfit(*arguments, folder=copied)
    assert "butterfly:tension=0.05" in out
    assert "paired by seed" in out
    assert "significant" in out
    assert "[4/4]" in err
    after = contents(copied / "runs", "result.json")
    assert len(after) == 6
    assert all(after[path] == content for path, content in before.items())


def test_a_failing_trial_is_named_the_others_go_on_and_the_exit_code_is_1(copied):
    arguments = ("run", "small.yaml", "-q", "--set", "seeds=[0]", "--set", "schemes=[loop]")
    _, err = meshfit(*arguments, "--set", "fit.optimizer.lr=1e30", folder=copied, code=1)
    assert "1 of 1 trials failed\ndiverged: the fit diverged at step" in err
    assert "  ellipsoid · loop · seed 0  runs" in err
    assert "failure.json" in err
    assert len(contents(copied / "runs", "result.json")) == 4


def test_table_is_made_from_the_files_alone(copied):
    (copied / "ellipsoid.ply").unlink()
    (copied / "small.yaml").unlink()
    out, _ = meshfit("table", "runs", "--format", "csv", folder=copied)
    rows = list(csv.DictReader(io.StringIO(out)))
    assert {row["scheme"] for row in rows} == {"loop", "interp-loop"}
    for text in ("md", "latex", "json", "rich"):
        out, _ = meshfit("table", "runs/small", "--format", text, "--metric", "distance.mean", folder=copied)
        assert "interp-loop" in out


def test_several_metrics_stand_in_one_table(complete):
    metrics = ("--metric", "hausdorff.symmetric", "--metric", "f_score.f1")
    for command in (("table", "runs"), ("run", "small.yaml")):
        out, _ = meshfit(*command, *metrics, folder=complete[0])
        assert out.count("Cells: mean (median)") == 1
        assert "Hausdorff distance (smaller is better); F-score (larger is better)" in out
    out, _ = meshfit("table", "runs", "--format", "csv", *metrics, "--metric", "f_score.f1", folder=complete[0])
    rows = list(csv.DictReader(io.StringIO(out)))
    assert [row["metric"] for row in rows] == ["hausdorff.symmetric"] * 2 + ["f_score.f1"] * 2


@pytest.mark.slow
def test_differences_are_from_the_baseline(complete):
    for command in (("table", "runs"), ("run", "small.yaml"), ("compare", "loop", "interp-loop", *SMALL)):
        out, _ = meshfit(*command, folder=complete[0])
        assert "Difference from loop" in out
        out, _ = meshfit(*command, "--baseline", "interp-loop:alpha=1", folder=complete[0])
        assert "Difference from interp-loop" in out


@pytest.mark.slow
def test_variations_of_an_experiment_are_rows_of_one_table(copied):
    before, _ = meshfit("table", "runs", "--format", "json", folder=copied)
    meshfit("run", "small.yaml", "-q", "--set", "fit.steps=10", folder=copied)
    out, _ = meshfit("table", "runs", folder=copied)
    assert out.count("Cells: ") == 1
    assert [line.strip() for line in out.splitlines() if re.fullmatch(r"steps=\d+ *", line)] == ["steps=10", "steps=20"]
    after, _ = meshfit("table", "runs", "--format", "json", folder=copied)
    (alone,), both = json.loads(before)["tables"], json.loads(after)["tables"]
    assert [table["settings"]["fit.steps"] for table in both] == [10, 20]
    assert both[1]["cells"] == alone["cells"]
    assert both[1]["differences"] == alone["differences"]


def test_check_is_green_on_its_own_numbers_and_red_on_others(copied):
    meshfit("expect", "runs", "-o", "expected.json", folder=copied)
    out, _ = meshfit("table", "runs", "--check", "expected.json", folder=copied)
    assert "all 2 cells are as expected.json expects" in out
    expected = json.loads((copied / "expected.json").read_text())
    expected["tables"][0]["cells"][0]["mean"] *= 3
    (copied / "expected.json").write_text(json.dumps(expected))
    _, err = meshfit("table", "runs", "--check", "expected.json", folder=copied, code=1)
    assert "ellipsoid" in err
    assert "give or take" in err


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("targets=[buny]", "did you mean 'bunny'?"),
        ("targets=[missing.obj]", "missing.obj: no such file"),
        ("fit.stepz=3", "did you mean 'steps'?"),
        ("device=cuda:99", "is not available"),
        ("device=gpu", "is not a device"),
        ("source.mesh=icosahedrn", "did you mean 'icosahedron'?"),
    ],
)
def test_bad_targets_and_settings_are_refused_before_anything_runs(tmp_path, monkeypatch, override, message):
    monkeypatch.chdir(tmp_path)
    assert message in refused("run", config_file(tmp_path), "--set", override)
    assert not (tmp_path / "runs").exists()


def test_an_unknown_metric_is_refused_before_anything_runs(tmp_path):
    assert "did you mean 'distance.mean'?" in refused(
        "run", config_file(tmp_path), "--runs", tmp_path / "runs", "--metric", "distance.meen"
    )
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("command", [("run",), ("compare", "loop", "interp-loop", "--config")])
@pytest.mark.parametrize(
    ("baseline", "message"),
    [
        ("butterfly", "baseline 'butterfly' is not among the schemes: allowed: loop, interp-loop"),
        ("interp-loop:alpha=0.5", "did you mean 'interp-loop'?"),
        ("loopy", "'loopy' is not a scheme: did you mean 'loop'?"),
    ],
)
def test_a_baseline_that_is_not_run_is_refused_before_anything_runs(tmp_path, command, baseline, message):
    arguments = (*command, config_file(tmp_path), "--runs", tmp_path / "runs")
    assert message in refused(*arguments, "--baseline", baseline)
    assert not (tmp_path / "runs").exists()


def test_a_place_that_cannot_be_written_is_one_clear_line(tmp_path):
    (tmp_path / "file").write_text("")
    assert "cannot be created" in refused("run", config_file(tmp_path), "--runs", tmp_path / "file")
