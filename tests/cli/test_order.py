"""One order and one number: every table of a run directory has the order of the config, and the same cells."""

import csv
import json
import shutil
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from meshfit.experiment.status.scan import scan_experiments
from meshfit.experiment.storage.plan_file import in_planned_order
from meshfit.experiment.storage.result import read_results
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron
from meshfit.report.figures.representative_trial import select_trials
from meshfit.report.tables.grouping import distinguish_definitions
from meshfit.subdivision.refine import subdivide
from tests.cli import answered, invoke, trials_in_this_process

METRICS = ("hausdorff.symmetric", "distance.mean")
# Neither alphabetical, nor the order of the paper or of the registry of schemes.
TARGETS, SCHEMES, SEEDS = ("zeta", "alpha", "mu"), ("midpoint", "loop", "interp-loop"), (10, 2, 1)
CONFIG = f"""\
targets: [{", ".join(f"{target}.ply" for target in TARGETS)}]
schemes: [{", ".join(SCHEMES)}]
seeds: [{", ".join(map(str, SEEDS))}]
source: {{mesh: octahedron, levels: 1}}
fit: {{steps: 3, samples: 60}}
measure: {{samples: 200, points: 200}}
device: cpu
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("order")
    ball = subdivide(octahedron(), "loop", 2)
    for width, target in enumerate(TARGETS, start=1):
        save_mesh(Mesh(ball.verts * np.array([1.0, 0.8, 0.3 * width]), ball.faces), folder / f"{target}.ply")
    (folder / "c.yaml").write_text(CONFIG)
    with pytest.MonkeyPatch.context() as patch, trials_in_this_process():
        patch.chdir(folder)
        printed = invoke("run", "c.yaml", *options("--metric", METRICS)).out
    return folder, printed


@pytest.fixture
def folder(finished, tmp_path, monkeypatch):
    shutil.copytree(finished[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def options(name, values):
    return [word for value in values for word in (name, value)]


def table(*arguments):
    return answered("table", "runs/c", *options("--metric", METRICS), *arguments)


def order_of_table():
    content, other = json.loads(table("--format", "json", "--partial"))["tables"]
    assert (content["targets"], content["schemes"]) == (other["targets"], other["schemes"])
    return [target["title"] for target in content["targets"]], content["schemes"]


def test_run_and_table_print_the_same(finished, folder):
    printed = finished[1].partition("\n\nResults: ")[0].rstrip()
    assert printed == table().rstrip()
    again = invoke("run", "c.yaml", *options("--metric", METRICS)).out
    assert again == finished[1]


def test_every_cell_is_that_of_its_trials(folder):
    tables = json.loads(table("--format", "json"))["tables"]
    cells = {
        (content["metric"]["name"], cell["target_title"], cell["scheme"]): cell
        for content in tables
        for cell in content["cells"]
    }
    assert len(cells) == len(METRICS) * len(TARGETS) * len(SCHEMES)
    results = [json.loads(path.read_text()) for path in Path("runs").rglob("result.json")]
    for (metric, target, scheme), cell in cells.items():
        group, key = metric.split(".")
        of_cell = [each for each in results if each["target"] == target and each["scheme"] == scheme]
        values = [each[group][key] for each in sorted(of_cell, key=lambda each: each["seed"])]
        assert len(values) == len(SEEDS)
        low, high = scipy.stats.t.interval(0.95, 2, np.mean(values), scipy.stats.sem(values))
        assert cell["interval"] == pytest.approx([low, high], rel=1e-9)


def test_the_order_is_that_of_the_config_everywhere(folder):
    assert order_of_table() == (list(TARGETS), list(SCHEMES))
    answered("export", "runs", "-o", "all.csv")
    with Path("all.csv").open() as file:
        rows = [(row["target"], row["scheme"]) for row in csv.DictReader(file)]
    assert list(dict.fromkeys(rows)) == [(target, scheme) for target in TARGETS for scheme in SCHEMES]
    (experiment,) = scan_experiments([Path("runs")], datetime.now(UTC))
    assert [(trial.target, trial.scheme) for trial in experiment.trials] == rows
    selected = select_trials(distinguish_definitions(in_planned_order(read_results([Path("runs")]))), METRICS[0])
    assert [group.title for group in selected] == list(TARGETS)
    assert [trial.scheme for trial in selected[0].trials] == list(SCHEMES)


def test_the_order_is_kept_where_trials_are_missing_and_by_runs_of_a_part(folder):
    shutil.rmtree(f"runs/c/{TARGETS[0]}/{SCHEMES[0]}")
    assert order_of_table() == (list(TARGETS), list(SCHEMES))
    with trials_in_this_process():
        invoke("run", "c.yaml", "--set", f"schemes=[{SCHEMES[1]}]", "--set", "seeds=[1, 5]", "--name", "c")
    plan = json.loads(Path("runs/c/plan.json").read_text())
    assert (plan["targets"], plan["schemes"]) == (list(TARGETS), list(SCHEMES))
    assert order_of_table() == (list(TARGETS), list(SCHEMES))


def test_a_changed_order_is_taken_over_without_a_trial_to_run(folder):
    Path("c.yaml").write_text(CONFIG.replace("[midpoint, loop, interp-loop]", "[interp-loop, loop, midpoint]"))
    printed = invoke("run", "c.yaml", *options("--metric", METRICS)).out
    assert order_of_table() == (list(TARGETS), list(SCHEMES[::-1]))
    assert printed.partition("\n\nResults: ")[0].rstrip() == table().rstrip()


def test_a_damaged_result_takes_its_trial_out_of_the_table_and_is_repeated(folder):
    path = next(Path("runs").rglob("seed-2-*/result.json"))
    before = path.read_bytes()
    path.write_bytes(before[:100])
    ran = invoke("table", "runs")
    assert ran.code == 1
    assert ran.err.startswith(f"warning: left out: {path}: not valid JSON: ")
    assert "\n26 of 27 complete, 1 damaged; " in ran.err
    assert "Missing, damaged: 1 run" in " ".join(ran.out.split())
    assert "26 complete · 1 damaged" in answered("status")
    planned = invoke("run", "c.yaml", "--dry-run")
    assert "26 complete, 1 to run" in planned.out
    assert planned.err.startswith(f"warning: {path}: not valid JSON: ")
    assert planned.err.endswith("; the trial is repeated\n")
    with trials_in_this_process():
        assert invoke("run", "c.yaml").code == 0
    metrics = json.loads(before)["hausdorff"]
    assert json.loads(path.read_bytes())["hausdorff"] == metrics
