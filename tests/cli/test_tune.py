"""`meshfit tune`: a search over the run directory, in real trials."""

import json
import signal
from datetime import UTC, datetime

import pytest

from meshfit.config.loading import load_experiment
from meshfit.config.strict_yaml import parse_document
from meshfit.experiment.plan import plan
from meshfit.report.html.page import read_report, render_page
from tests.cli import answered, invoke, refused, trials_in_this_process
from tests.cli.processes import contents, start, wait_until
from tests.small import config_file

pytest.importorskip("optuna")
CONFIG = """\
targets: [ellipsoid.ply]
schemes: [loop]
source: {mesh: octahedron, levels: 1}
fit: {samples: 100, steps: 6}
measure: {samples: 200, points: 200}
device: cpu
sweep:
  ranges:
    fit.steps: {linear: [0, 6], integer: true}
    fit.optimizer.lr: {log: [0.1, 1.0e+9]}
"""


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    """A folder with a search of 20 points, and what it printed."""
    folder = tmp_path_factory.mktemp("tuned")
    config_file(folder, CONFIG)
    with trials_in_this_process(), pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return folder, invoke("tune", "small.yaml", "--metric", "distance.mean", "--trials", 20, "-o", "best.yaml")


def test_the_best_settings_are_printed_and_written_as_a_config_of_the_best_trial(tuned, monkeypatch):
    folder, ran = tuned
    monkeypatch.chdir(folder)
    assert ran.code == 0, ran.err
    (search,) = [json.loads(path.read_text()) for path in folder.glob("runs/small-tune/search-*.json")]
    told = search["points"][:20]
    best = min((point for point in told if point["state"] == "complete"), key=lambda point: point["values"])
    failed = [point for point in told if point["state"] == "failed"]
    assert failed, "a learning rate of 1e9 diverges"
    assert f"best settings of 20 points, {len(failed)} failed" in ran.out
    assert f"{best['values'][0]:.4g}" in ran.out.splitlines()[2]
    assert "[20/20]" in ran.err
    (trial,) = plan([load_experiment("best.yaml")])
    folders = [path.parent.name for path in folder.glob("runs/small-tune/ellipsoid/loop/*/result.json")]
    assert trial.folder.name in folders
    assert len(folders) == 21 - len(failed), "each point was run once, and the config's own settings"
    assert parse_document((folder / "best.yaml").read_text(), "it").data["fit"]["steps"] == best["changes"]["fit.steps"]


def test_the_same_command_runs_nothing_and_more_trials_continue(tuned, monkeypatch):
    folder, _ = tuned
    monkeypatch.chdir(folder)
    command = ("tune", "small.yaml", "--metric", "distance.mean")
    before = contents(folder / "runs", "result.json") | contents(folder / "runs", "failure.json")
    with trials_in_this_process():
        again = json.loads(answered(*command, "--trials", 20, "--json", "-q"))
        assert contents(folder / "runs", "result.json") | contents(folder / "runs", "failure.json") == before
        more = json.loads(answered(*command, "--trials", 24, "--json", "-q"))
    assert more["points"][:20] == again["points"]
    assert len(more["points"]) == 24
    front = json.loads(invoke("tune", "small.yaml", "--metric", "distance.mean,f_score.f1", "--dry-run", "--json").out)
    assert front == {"points": 100, "tried": 0, "fits": 100} | {"seconds": front["seconds"]}


def test_chart_and_report_of_a_search_show_its_history_and_its_best_points(tuned, monkeypatch, tmp_path):
    folder, ran = tuned
    monkeypatch.chdir(folder)
    best = ran.out.splitlines()[2].split()
    printed = answered("chart", "runs/small-tune", "-o", tmp_path / "chart.svg")
    assert printed.splitlines()[2].split() == best
    assert f"<!-- best so far: {best[0]} at point {best[-1]} -->" in (tmp_path / "chart.svg").read_text()
    assert "the search is for distance.mean" in refused(
        *("chart", "runs/small-tune", "-o", tmp_path / "chart.svg", "--metric", "f_score.f1")
    )
    data = read_report([folder / "runs/small-tune"], [], None, datetime.now(UTC))
    assert [table.metrics for table in data.tables] == [("distance.mean",)]
    names = [variation.name for table in data.tables for variation in table.variations]
    assert names[:2] == ["config's own", f"point {best[-1]}"]
    assert len(names) == 6
    page = render_page(data, [], datetime.now(UTC), lambda *_: None)
    assert f"best so far: {best[0]} at point {best[-1]}" in page
    assert all(f"/loop/seed-0-{result['identity'][:10]}" in page for result in data.results), "all trials are listed"


@pytest.mark.slow
def test_kill_9_and_the_same_command_give_the_same_search(tuned, tmp_path):
    folder, _ = tuned
    config_file(tmp_path, CONFIG)
    command = ("tune", "small.yaml", "--metric", "distance.mean", "--trials", 20, "-q", "-j", 1)
    process = start(*command, folder=tmp_path)
    wait_until(lambda: len(list(tmp_path.glob("runs/**/result.json"))) >= 3 or process.poll() is not None, process)
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=60)
    kept = contents(tmp_path / "runs", "result.json")
    process = start(*command, folder=tmp_path)
    process.communicate(timeout=300)
    assert process.returncode == 0
    after = contents(tmp_path / "runs", "result.json")
    assert {path: after[path] for path in kept} == kept
    (undisturbed,) = folder.glob("runs/small-tune/search-*.json")
    told = [json.loads(path.read_text())["points"][:20] for path in (undisturbed, *tmp_path.glob("runs/*/search-*"))]
    assert _told(told[0]) == _told(told[1])


def _told(points):
    return [(point["changes"], point["state"], point["values"]) for point in points]


def test_what_cannot_be_searched_is_refused_in_one_line(tmp_path, monkeypatch):
    config_file(tmp_path, CONFIG)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plain.yaml").write_text("targets: [ellipsoid.ply]\n")
    (tmp_path / "grid.yaml").write_text(CONFIG.replace("ranges:", "source.levels: [1, 2]\n  ranges:"))
    (tmp_path / "wrong.yaml").write_text(CONFIG.replace("fit.optimizer.lr", "fit.optimiser.lr"))
    for arguments, message in (
        (("plain.yaml",), "no ranges to search; give settings and their ranges, such as sweep: {ranges:"),
        (("grid.yaml",), "source.levels: a search varies nothing but its ranges"),
        (("wrong.yaml",), "fit.optimiser: no such key: did you mean 'optimizer'?"),
        (("small.yaml", "--metric", "hausdorf.symmetric"), "did you mean 'hausdorff.symmetric'?"),
        (("small.yaml", "--metric", "quality.faces"), "give --minimise quality.faces or --maximise quality.faces"),
        (("small.yaml", "--trials", 0), "--trials"),
        (("small.yaml", "-o", "best.txt"), "expected a file that ends in .yaml"),
        (("small.yaml", "-o", "no/best.yaml"), "there is no folder no"),
        (("small.yaml", "-o", "small.yaml"), "is the config that is searched; give another path"),
        (("small.yaml", "-o", "plain.yaml"), "exists, and no search wrote it; give another path"),
        (("ellipsoid.ply",), "is a mesh, not a config"),
        (("small.yaml", "--name", "a/b"), "expected the name of one folder"),
    ):
        assert message in refused("tune", *arguments)
    assert "sweep.sample: {points: 200} spreads points over them, and `meshfit tune`" in refused("run", "small.yaml")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(__import__("sys").modules, "optuna", None)
        assert "a search needs optuna, which is not installed: pip install 'meshfit[tune]'" in refused(
            "tune", "small.yaml"
        )
    assert not (tmp_path / "runs").exists()
