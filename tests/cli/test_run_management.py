"""Run management on the command line: status, show, export and clean after real runs, and their refusals."""

import contextlib
import csv
import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet
import pytest

from tests.cli import answered, invoke, refused, trials_in_this_process
from tests.cli.processes import contents, start, wait_until
from tests.runs import begun, complete, write_plan
from tests.small import CONFIG, config_file

BAD_LR = ("--set", "seeds=[0]", "--set", "schemes=[loop]", "--set", "fit.optimizer.lr=1e30", "--name", "small")


@pytest.fixture(scope="module")
def failed_too(small_run, tmp_path_factory):
    """A folder in which the small experiment was run, and one more trial, which failed."""
    folder = tmp_path_factory.mktemp("ran")
    shutil.copytree(small_run[0], folder, dirs_exist_ok=True)
    with trials_in_this_process(), contextlib.chdir(folder):
        assert invoke("run", "small.yaml", "-q", *BAD_LR).code == 1
    return folder


@pytest.fixture
def copied(failed_too, tmp_path, monkeypatch):
    shutil.copytree(failed_too, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_status_after_a_real_run(copied):
    out = answered("status")
    assert out.splitlines()[0].startswith("small  4 complete · 1 failed")
    assert "failed: " in out
    assert "ellipsoid · loop · seed 0" in out
    assert "the fit diverged at step" in out
    assert re.search(r"runs/small/ellipsoid/loop/seed-0-\w{10}/(trial\.log|failure\.json)\n", out)
    (experiment,) = json.loads(answered("status", "runs/small", "--json"))
    assert (experiment["counts"]["complete"], experiment["counts"]["failed"]) == (4, 1)
    (trial,) = (trial for trial in experiment["trials"] if trial["state"] == "failed")
    assert trial["failure"]["message"].startswith("the fit diverged at step")


def test_show_after_a_real_run(copied):
    folder = next(Path("runs").glob("small/*/interp-loop/seed-1-*"))
    out = answered("show", folder)
    assert out == answered("show", folder / "result.ply") == answered("show", folder.name.rpartition("-")[2])
    assert out.startswith("ellipsoid · interp-loop · seed 1  complete\n")
    for words in ("Hausdorff distance", "steps: 20", "mesh: octahedron", "trace.csv", "identity", "device cpu"):
        assert words in out
    assert "lr: 1.0" not in out
    assert "lr: 1.0" in answered("show", folder, "--all")
    plain = json.loads(answered("show", folder, "--json"))
    assert plain["result"] == json.loads((folder / "result.json").read_text())
    assert {file["name"] for file in plain["files"]} == {p.name for p in folder.iterdir() if p.name != ".lock"}


def test_show_a_failed_trial_says_why_and_where_to_look(copied):
    (path,) = (copied / "runs").rglob("failure.json")
    out = answered("show", path)
    assert "seed 0  failed" in out
    assert "the fit diverged at step" in out
    assert "see " in out.partition("failure")[2]
    assert "lr: 1.0e+30" in out
    assert "last_good.ply" in out


def test_export_after_a_real_run(copied):
    assert answered("export", "runs", "-o", "out.csv").startswith("wrote out.csv: 5 trials, ")
    answered("export", "runs/small", "-o", "out.parquet")
    with (copied / "out.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    table = pyarrow.parquet.read_table("out.parquet")
    assert table.column_names == list(rows[0])
    assert [row["state"] for row in rows] == table["state"].to_pylist()
    for row, found in zip(rows, table.to_pylist(), strict=True):
        if row["state"] == "complete":
            result = json.loads((copied / row["folder"] / "result.json").read_text())
            assert found["hausdorff.symmetric"] == float(row["hausdorff.symmetric"]) == result["hausdorff"]["symmetric"]
            assert found["fit.steps"] == int(row["fit.steps"]) == 20


def test_clean_removes_what_failed_and_leaves_what_is_complete(copied):
    before = contents(copied / "runs", "result.json", "result.ply", "trace.csv", "config.yaml")
    out = answered("clean", "runs", "--failed", "--dry-run")
    assert re.search(r"^failed: ellipsoid · loop · seed 0, .* kB  runs/small/", out)
    assert "would remove 1 trial, " in out
    assert re.fullmatch(r"removed 1 trial, [\d.]+ kB\n", answered("clean", "runs", "--failed"))
    after = contents(copied / "runs", "result.json", "result.ply", "trace.csv", "config.yaml")
    assert len(contents(copied / "runs", "result.json")) == 4
    assert after.items() <= before.items()
    assert "4 complete" in answered("status")
    assert answered("clean", "runs", "--failed", "--partial") == "removed 0 trials, 0 B\n"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_real_run_is_seen_running_then_interrupted_and_goes_on_after_a_clean(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    long = CONFIG.replace("steps: 20", "steps: 100000").replace("[loop, interp-loop]", "[loop]")
    process = start("run", config_file(tmp_path, long), "-j", 1, "--set", "seeds=[0]", folder=tmp_path)
    wait_until(lambda: bool(list((tmp_path / "runs").rglob("source.ply"))), process)
    (experiment,) = json.loads(answered("status", "--json"))
    assert [trial["state"] for trial in experiment["trials"]] == ["running"]
    assert "1 running" in answered("status")
    assert answered("clean", "runs", "--failed", "--partial") == "removed 0 trials, 0 B\nkept 1 running trial\n"
    process.kill()
    process.communicate(timeout=60)
    wait_until_state("interrupted")
    assert "removed 1 trial and 1 target of no trial, " in answered("clean", "runs", "--partial")
    assert list((tmp_path / "runs").rglob("seed-*")) == []


def wait_until_state(state):
    idle = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        wait_until(lambda: json.loads(answered("status", "--json"))[0]["counts"][state] == 1, idle, 30)
    finally:
        idle.kill()
        idle.wait()


@pytest.mark.parametrize("command", [("status",), ("export", "-o", "x.csv"), ("clean", "--failed")])
def test_where_there_is_nothing_one_line_says_so(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    assert refused(*command, "runs") == "error: runs: no such run directory; `meshfit run` makes one"
    (tmp_path / "runs").mkdir()
    assert refused(*command, "runs").startswith("error: no trial under runs; `meshfit run` makes them")
    write_plan(tmp_path / "runs/small", [])
    (tmp_path / "runs/small/plan.json").write_text("{")
    assert refused(*command, "runs").startswith("error: runs/small/plan.json: not valid JSON")


def test_what_is_not_allowed_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    begun(tmp_path / "runs")
    assert refused("clean", "runs") == "error: expected --failed, --partial or both"
    assert "allowed: .csv, .parquet" in refused("export", "runs", "-o", "out.xlsx")
    assert "no trial under runs is complete or failed" in refused("export", "runs", "-o", "out.csv")
    assert "4 or more digits of its identity; the trials are: " in refused("show", "abc")
    assert "Missing option '--output'" in refused("export", "runs")


@pytest.mark.parametrize("command", [("status", "runs"), ("show", "runs"), ("clean", "runs", "--failed")])
def test_none_of_it_waits_for_a_heavy_library(tmp_path, command):
    folder = complete(tmp_path / "runs")
    arguments = [str(folder) if command[0] == "show" and text == "runs" else text for text in command]
    heavy = "{'torch', 'trimesh', 'pymeshlab', 'scipy', 'pykdtree', 'pyvista', 'igl', 'pyarrow'}"
    code = f"import sys; sys.argv = {['meshfit', *arguments]!r}\nfrom meshfit.cli.main import run_app\nrun_app()\n"
    code += f"print(sorted({heavy} & sys.modules.keys()))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert found.stdout.splitlines()[-1] == "[]"
