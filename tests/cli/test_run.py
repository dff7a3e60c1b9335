"""`meshfit run`, `compare`, `table` and `expect` on small experiments."""

import csv
import io
import json
import re
import shutil
from pathlib import Path

import pytest

from meshfit.cli import experiments
from meshfit.config.loading import load_experiment, with_axes
from meshfit.subdivision.registry import canonical
from tests.cli import answered, invoke, refused, trials_in_this_process
from tests.cli.processes import contents
from tests.loops import over
from tests.small import config_file

SMALL = ("--config", "small.yaml")


@pytest.fixture
def complete(small_run, monkeypatch):
    """The folder of the complete experiment, which must not be changed."""
    monkeypatch.chdir(small_run[0])
    return small_run[0]


@pytest.fixture
def copied(small_run, tmp_path, monkeypatch):
    shutil.copytree(small_run[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_run_ends_in_a_table_and_a_second_run_does_nothing(small_run, complete, monkeypatch):
    out, err = small_run[1]
    assert "Hausdorff distance" in out
    assert "interp-loop" in out
    assert "[4/4]" in err
    assert "Results: runs/small" in out
    before = contents(complete / "runs", "result.json")
    assert len(before) == 4
    monkeypatch.setattr("tests.cli.WIDTH", 120)
    assert invoke("run", "small.yaml").out == out
    assert contents(complete / "runs", "result.json") == before


def test_dry_run_prints_what_is_complete_and_writes_nothing(complete):
    out = invoke("run", "small.yaml", "--dry-run", "--json", "--set", "seeds=[1, 2]", "--cluster", "tcp://none:1").out
    assert [row["complete"] for row in json.loads(out)["trials"]] == [True, False, True, False]
    out = invoke("run", "small.yaml", "--dry-run", "--runs", "elsewhere", "--cluster", "tcp://none:1").out
    assert "4 trials: 0 complete, 4 to run" in out
    assert not (complete / "elsewhere").exists()


def test_a_dry_run_of_many_trials_lists_the_first_of_them(complete, monkeypatch):
    monkeypatch.setattr(experiments, "_MOST_LISTED", 3)
    lines = invoke("run", "small.yaml", "--dry-run", "--seeds", "4", "--cluster", "tcp://none:1").out.splitlines()
    assert [" · loop · seed" in line for line in lines] == [True] * 3 + [False] * 2
    assert lines[3:] == ["and 5 more, which --json lists", "8 trials: 4 complete, 4 to run"]


def test_dry_run_estimates_the_time_from_complete_trials(complete):
    out = invoke("run", "small.yaml", "--dry-run", "--set", "seeds=[1, 2]").out
    assert re.search(r"about .* on \d+ workers?, estimated from 2 complete trials", out)


@pytest.mark.slow
def test_dry_run_estimates_the_time_by_a_probe(complete):
    out = invoke("run", "small.yaml", "--dry-run", "--runs", "elsewhere").out
    assert re.search(r"about .* on \d+ workers?, estimated from a probe of 1 trial", out)
    assert not (complete / "elsewhere").exists()


def test_json_goes_to_stdout_alone(complete):
    results = json.loads(invoke("run", "small.yaml", "--json").out)
    assert [result["scheme"] for result in results] == ["loop", "loop", "interp-loop", "interp-loop"]
    assert all(result["hausdorff"]["symmetric"] > 0 for result in results)


def test_compare_runs_what_is_missing_and_pairs_by_seed(copied):
    before = contents(copied / "runs/small", "result.json", "plan.json", "trial.log")
    with trials_in_this_process():
        out, err = invoke("compare", "loop", "butterfly:tension=0.05", *SMALL, "--seeds", "2")[1:]
    assert "butterfly:tension=0.05" in out
    assert "paired by seed" in out
    assert "significant" in out
    assert err.startswith("copied 2 complete trials of small\n")
    assert "[4/4]" in err
    assert contents(copied / "runs/small", "result.json", "plan.json", "trial.log") == before
    (own,) = (copied / "runs").glob("small-*")
    assert own.name == "small-loop-vs-butterfly-tension-0.05"
    assert "Results: runs/small-loop-vs-butterfly-tension-0.05\n" in out
    assert len(contents(own, "result.json")) == 4
    for path, content in contents(own, "result.json").items():
        assert json.loads(content)["experiment"] == own.name
        if "/loop/" in path:
            first, second = json.loads(before[path]), json.loads(content)
            assert first | {"experiment": own.name} == second
    rows = list(csv.DictReader(io.StringIO(answered("table", "runs", "--format", "csv"))))
    assert [row["scheme"] for row in rows] == ["loop", "interp-loop", "butterfly:tension=0.05"]


def test_what_compares_something_else_has_a_folder_of_its_own(copied):
    """Other targets, schemes or sweeps; seeds and settings stay with the experiment."""
    shutil.copy("ellipsoid.ply", "odd name.ply")
    for arguments, name in (
        ((), "small"),
        (("--seeds", 1), "small"),
        (("--set", "fit.steps=3"), "small"),
        (("--schemes", "loop,interp-loop"), "small"),
        (("--set", "schemes=[interp-loop, loop]"), "small"),
        (("--schemes", "interp-loop,loop"), "small"),
        (("--targets", "ellipsoid.ply"), "small"),
        (("--schemes", "loop"), "small-loop"),
        (("--set", "schemes=[interp-loop:alpha=0.5, loop]"), "small-interp-loop-alpha-0.5-loop"),
        (("--targets", "odd name.ply,ellipsoid.ply"), "small-odd-name-ellipsoid"),
        (("--set", "targets=[odd name.ply]", "--schemes", "loop"), "small-odd-name-loop"),
        (("--set", "sweep={fit.losses.edge: [0.1, 0.2]}"), "small-sweep"),
        (("--schemes", "loop", "--name", "mine"), "mine"),
        (("--name", "small"), "small"),
    ):
        rows = json.loads(answered("run", "small.yaml", "--dry-run", "--json", "--cluster", "tcp://none:1", *arguments))
        folders = {Path(row["folder"]).parts[1] for row in rows["trials"] if not row["complete"]}
        assert folders <= {name}, arguments
        if name not in ("small", "small-loop", "mine"):
            assert folders == {name}
    many = ",".join(f"interp-loop:alpha=0.{n}" for n in range(1, 10))
    rows = json.loads(answered("run", "small.yaml", "--dry-run", "--json", "--cluster", "x", "--schemes", many))
    (name,) = {Path(row["folder"]).parts[1] for row in rows["trials"]}
    assert len(name) == 80
    for wrong in ("", "a/b", "..", ".hidden", "-x", " x", "a\nb", "x" * 300):
        assert "expected the name of one folder" in refused("run", "small.yaml", f"--name={wrong}")
    assert "expected one config, got 2" in refused("run", "small.yaml", "small.yaml", "--name", "x")


def test_trials_of_another_experiment_are_copied_whole_and_never_run_twice(copied):
    first = next(Path("runs/small").glob("*/loop/seed-0-*"))
    (first / "snapshots").mkdir()
    shutil.copy(first / "result.ply", first / "snapshots/step-000020.ply")
    (first / ".result.ply.abcdefgh").write_text("half")
    damaged = next(Path("runs/small").glob("*/loop/seed-1-*"))
    (damaged / "result.json").write_text("{}")
    with trials_in_this_process():
        ran = invoke("run", "small.yaml", "--schemes", "loop", "--name", "mine")
        assert ran.err.startswith("copied 1 complete trial of small\n")
        second = Path("runs/mine") / first.relative_to("runs/small")
        names = {str(path.relative_to(first)) for path in first.rglob("*") if path.is_file()}
        found = {str(path.relative_to(second)) for path in second.rglob("*") if path.is_file()}
        assert found == names - {".result.ply.abcdefgh"}
        for name in ("result.ply", "source.ply", "trace.csv", "config.yaml", "snapshots/step-000020.ply"):
            assert (second / name).read_bytes() == (first / name).read_bytes()
        assert f"copied from {first}" in (second / "trial.log").read_text()
        assert "copied" not in (first / "trial.log").read_text()
        before = contents(Path("runs/small"), "result.ply", "result.json")
        assert invoke("run", "small.yaml", "--schemes", "loop", "--name", "mine", "--force", "-q").code == 0
    assert contents(Path("runs/small"), "result.ply", "result.json") == before


def test_a_failing_trial_is_named_the_others_go_on_and_the_exit_code_is_1(copied):
    with trials_in_this_process():
        ran = invoke("run", "small.yaml", "-q", "--set", "schemes=[loop]", "--set", "fit.optimizer.lr=1e30")
    assert ran.code == 1
    assert "2 of 2 trials failed\ndiverged: the fit diverged at step" in ran.err
    assert "  ellipsoid · loop · seed 0  runs" in ran.err
    assert "failure.json" in ran.err
    assert len(contents(copied / "runs", "result.json")) == 4


def test_table_is_made_from_the_files_alone(copied):
    (copied / "ellipsoid.ply").unlink()
    (copied / "small.yaml").unlink()
    rows = list(csv.DictReader(io.StringIO(answered("table", "runs", "--format", "csv"))))
    assert {row["scheme"] for row in rows} == {"loop", "interp-loop"}
    for text in ("md", "latex", "json", "rich"):
        assert "interp-loop" in answered("table", "runs/small", "--format", text, "--metric", "distance.mean")


def test_several_metrics_stand_in_one_table(complete):
    metrics = ("--metric", "hausdorff.symmetric", "--metric", "f_score.f1")
    for command in (("table", "runs"), ("run", "small.yaml")):
        out = invoke(*command, *metrics).out
        assert out.count("Cells: mean (median)") == 1
        assert "Hausdorff distance (smaller is better); F-score (larger is better)" in out
    out = answered("table", "runs", "--format", "csv", *metrics, "--metric", "f_score.f1")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert [row["metric"] for row in rows] == ["hausdorff.symmetric"] * 2 + ["f_score.f1"] * 2


def test_differences_are_from_the_baseline(complete):
    for command in (
        ("table", "runs"),
        ("run", "small.yaml"),
        ("compare", "loop", "interp-loop", *SMALL, "--name", "small"),
    ):
        assert "Difference from loop" in invoke(*command).out
        assert "Difference from interp-loop" in invoke(*command, "--baseline", "interp-loop:alpha=1").out


def test_variations_of_an_experiment_are_rows_of_one_table(copied):
    before = answered("table", "runs", "--format", "json")
    with trials_in_this_process():
        assert invoke("run", "small.yaml", "-q", "--set", "fit.steps=10").code == 0
    out = answered("table", "runs")
    assert out.count("Cells: ") == 1
    assert [line.strip() for line in out.splitlines() if re.fullmatch(r"steps=\d+ *", line)] == ["steps=10", "steps=20"]
    after = answered("table", "runs", "--format", "json")
    (alone,), both = json.loads(before)["tables"], json.loads(after)["tables"]
    assert [table["settings"]["fit.steps"] for table in both] == [10, 20]
    assert both[1]["cells"] == alone["cells"]
    assert both[1]["differences"] == alone["differences"]


def test_check_is_green_on_its_own_numbers_and_red_on_others(copied):
    answered("expect", "runs", "-o", "expected.json")
    assert "all 2 cells match expected.json" in answered("table", "runs", "--check", "expected.json")
    expected = json.loads((copied / "expected.json").read_text())
    expected["tables"][0]["cells"][0]["mean"] *= 3
    (copied / "expected.json").write_text(json.dumps(expected))
    ran = invoke("table", "runs", "--check", "expected.json")
    assert ran.code == 1
    assert re.match("error: ellipsoid, .*: found .*, expected .* ± .*\n", ran.err)


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


def planned(*arguments):
    rows = json.loads(answered("run", "small.yaml", "--dry-run", "--json", "--cluster", "tcp://none:1", *arguments))
    trials = [(row["target"], row["scheme"], row["seed"]) for row in rows["trials"]]
    return [list(dict.fromkeys(values)) for values in zip(*trials, strict=True)]


@over(
    ("arguments", "targets", "schemes", "seeds"),
    [
        (("--targets", "two.ply,bunny"), ["two.ply", "bunny"], ["loop", "interp-loop"], [0, 1]),
        (("--targets", "a,b.ply"), ["a,b.ply"], ["loop", "interp-loop"], [0, 1]),
        (("--schemes", "midpoint"), ["ellipsoid.ply"], ["midpoint"], [0, 1]),
        (
            ("--schemes", "interp-loop:alpha=0.5,valence3=zorin, loop", "--seeds", "3"),
            ["ellipsoid.ply"],
            ["interp-loop:valence3=zorin,alpha=0.5", "loop"],
            [0, 1, 2],
        ),
        (("--seeds", "4,0"), ["ellipsoid.ply"], ["loop", "interp-loop"], [4, 0]),
        (("--seeds", "7,"), ["ellipsoid.ply"], ["loop", "interp-loop"], [7]),
        (("--set", "targets=two.ply,bunny"), ["two.ply", "bunny"], ["loop", "interp-loop"], [0, 1]),
        (("--set", "targets=[two.ply,bunny]"), ["two.ply", "bunny"], ["loop", "interp-loop"], [0, 1]),
        (("--set", "targets=a,b.ply", "--set", "schemes=loop"), ["a,b.ply"], ["loop"], [0, 1]),
        (("--set", "seeds=5,6,7", "--schemes", "loop"), ["ellipsoid.ply"], ["loop"], [5, 6, 7]),
        (("--set", "seeds=5,6", "--seeds", "1"), ["ellipsoid.ply"], ["loop", "interp-loop"], [0]),
    ],
)
def test_targets_schemes_and_seeds_are_chosen_on_the_command_line(
    tmp_path, monkeypatch, arguments, targets, schemes, seeds
):
    monkeypatch.chdir(tmp_path)
    config_file(tmp_path)
    for name in ("two.ply", "a,b.ply"):
        shutil.copy("ellipsoid.ply", name)
    found = planned(*arguments)
    assert [Path(target).name for target in found[0]] == targets
    assert sorted(found[1]) == sorted(canonical(scheme) for scheme in schemes)
    assert found[1:] == [[canonical(scheme) for scheme in schemes], seeds]


def test_whole_numbers_of_seeds_are_written_as_in_a_config(tmp_path):
    loaded = load_experiment(str(config_file(tmp_path)))
    for text, seeds in (("1e1", tuple(range(10))), ("2.0", (0, 1)), ("1e2,7", (100, 7))):
        assert with_axes(loaded, seeds=text).settings.seeds == seeds


def test_other_settings_that_are_lists_need_no_brackets(tmp_path):
    path = str(config_file(tmp_path))
    settings = load_experiment(path, ["source.centre=1,2.5,-3", "sweep.fit.steps=5,6"]).settings
    assert settings.source.centre == (1, 2.5, -3)
    assert settings.sweep == {"fit": {"steps": [5, 6]}}


@over(
    ("arguments", "message"),
    [
        (("--seeds", "0"), "--seeds: expected a number of seeds, 1 to 100,000, or a list such as 4,7, got '0'"),
        (("--seeds", "two"), "--seeds: expected a number of seeds, 1 to 100,000, or a list such as 4,7, got 'two'"),
        (("--seeds", "1,x"), '--seeds: seeds[1]: expected an integer, got "x"'),
        (("--seeds", "1,1"), "--seeds: seeds: duplicate entry 1"),
        (("--targets", ","), "--targets: targets: expected at least one entry, got []"),
        (("--targets", "buny"), "did you mean 'bunny'?"),
        (("--schemes", "lop"), "did you mean 'loop'?"),
        (("--set", "seeds=3"), "--set: seeds: expected a list, such as [a, b], got 3"),
        (("--set", "fit.steps=3,4"), '--set: fit.steps: expected an integer, got "3,4"'),
        (("--set", 'targets="a,b"'), '--set: targets: expected a list, such as [a, b], got "a,b"'),
    ],
)
def test_bad_choices_are_refused(tmp_path, arguments, message):
    assert message in refused("run", config_file(tmp_path), "--runs", tmp_path / "runs", *arguments)


def test_every_fault_is_a_line_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config_file(tmp_path, "seeds: [x]\nsteps: 5\n")
    ran = invoke("run", "small.yaml")
    assert (ran.code, ran.out) == (2, "")
    starts = ["error: small.yaml, line 1: seeds[0]: ", "error: small.yaml, line 2: steps: no such key"]
    assert [line.startswith(start) for line, start in zip(ran.err.splitlines(), starts, strict=True)] == [True, True]
    ran = invoke("run", "quickstart", "--targets", "gone.obj,bunny,buny,gone.ply")
    assert (ran.code, ran.out) == (2, "")
    assert [re.match("error: .*?(gone.obj|buny|gone.ply)", line)[1] for line in ran.err.splitlines()] == (
        ["gone.obj", "buny", "gone.ply"]
    )
