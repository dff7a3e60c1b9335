"""External tools as trials: permission for the commands of a config, failures, provenance, and every view of a run."""

import csv
import json
import sys
from pathlib import Path

import pytest

from meshfit.config.loading import load_experiment
from meshfit.experiment.plan import plan
from meshfit.experiment.running.backends import Remote
from meshfit.experiment.running.scheduler import run_trials
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.report.html.charts import read_curves
from tests.cli import answered, invoke, refused, trials_in_this_process
from tests.inline import Inline
from tests.small import ellipsoid

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")

SCRIPT = """
import shutil, sys, time
print('tool says', sys.argv[3], flush=True)
if sys.argv[3] == 'crash':
    sys.exit('no licence')
if sys.argv[3] == 'hang':
    time.sleep(60)
shutil.copy(*sys.argv[1:3])
"""


def config(folder, *modes, seeds="[0, 1]"):
    ellipsoid(folder)
    (folder / "tool.py").write_text(SCRIPT, encoding="utf-8")
    command = f"[{sys.executable}, -I, -S, tool.py, '{{source}}', '{{result}}'"
    variants = "".join(
        f"    {mode}:\n      fit: {{method: external, command: {command}, {mode}], time_limit: 1,\n"
        f"        version_command: [echo, tool 1.2]}}\n"
        for mode in modes
    )
    text = (
        f"targets: [ellipsoid.ply]\nschemes: [loop]\nseeds: {seeds}\nsource: {{mesh: octahedron, levels: 2}}\n"
        f"measure: {{samples: 500, points: 500}}\ndevice: cpu\nsweep:\n  variants:\n{variants}"
    )
    path = folder / "tools.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MESHFIT_ALLOW_COMMANDS", "1")  # trials run in this process as in a remote worker
    return tmp_path


def test_commands_need_permission_and_nothing_is_written_without_it(here):
    config(here, "ok")
    line = refused("run", "tools.yaml")
    assert "fit.command: the config runs a program on this machine: echo 'tool 1.2'; " in line
    assert "tool.py '{source}' '{result}' ok; if you trust it, give --allow-commands" in line
    assert not (here / "runs").exists()
    assert refused("run", "tools.yaml", "--json") == line
    assert "--allow-commands" in refused("compare", "loop", "midpoint", "--config", "tools.yaml")
    for setting in ("allow_commands=true", "fit.allow_commands=true"):
        assert "no such key" in refused("run", "tools.yaml", "--set", setting)
    inline = ("--set", "fit={method: external, command: [cp, '{source}', '{result}']}")
    assert "program on this machine: cp '{source}' '{result}'; if" in refused("run", "quickstart", *inline)
    assert "1 to run" in invoke("run", "tools.yaml", "--dry-run").out


def test_trials_of_tools_run_fail_and_are_shown(here):
    config(here, "ok", "crash", "hang")
    with trials_in_this_process():
        ran = invoke("run", "tools.yaml", "--allow-commands")
    assert ran.code == 1
    assert "2 of 3 trials failed" in ran.err
    assert "tool: tool.py ended with exit code 1: no licence" in ran.err
    assert "time-limit: tool.py was stopped after 1 s; raise fit.time_limit" in ran.err
    assert "by several tools" in ran.out or "by the command" in ran.out
    (folder,) = (path.parent for path in Path("runs").rglob("result.json"))
    result = json.loads((folder / "result.json").read_text())
    assert result["tool"] == {"name": "tool.py", "version": "tool 1.2"}
    assert result["seconds"]["fit"] > 0
    assert (folder / "result.ply").read_bytes() == (folder / "source.ply").read_bytes()
    assert not (folder / "trace.csv").exists()
    assert "  | tool says ok" in (folder / "trial.log").read_text()
    logs = [path.with_name("trial.log").read_text() for path in Path("runs").rglob("failure.json")]
    assert len(logs) == 2
    assert all("  | tool says " in log for log in logs)
    assert read_curves({0: {0: result | {"folder": str(folder)}}}) == ([], [])  # a page has no curves of it
    # The config of the trial alone repeats it, with its limits, and with permission.
    assert load_experiment(str(folder / "config.yaml")).settings.fit.time_limit == 1
    assert "--allow-commands" in refused("run", folder / "config.yaml", "--force")
    # Complete trials need no permission, and views cope without a trace.
    assert invoke("export", "runs", "-o", "all.csv").code == 0
    rows = list(csv.DictReader((here / "all.csv").read_text().splitlines()))
    assert [row["tool.version"] for row in rows if row["state"] == "complete"] == ["tool 1.2"]
    assert "time-limit" in invoke("status", "runs").out
    assert "tool        tool.py, version tool 1.2\n" in answered("show", str(folder))
    assert "a fit by another tool has no steps to animate" in refused("animate", str(folder), "-o", "x.mp4")
    assert "reach-for-the-spheres" in answered("schema")


def test_the_same_bytes_again_and_another_script_is_another_trial(here):
    config(here, "ok")
    with trials_in_this_process():
        assert invoke("run", "tools.yaml", "--allow-commands").code == 0
        (first,) = Path("runs").rglob("result.ply")
        content = first.read_bytes()
        assert invoke("run", "tools.yaml", "--allow-commands", "--force").code == 0
        assert first.read_bytes() == content
        assert invoke("run", "tools.yaml", "--runs", "runs").code == 0  # complete, so that no command is run
        (here / "tool.py").write_text(f"{SCRIPT}\n# changed\n", encoding="utf-8")
        assert "--allow-commands" in refused("run", "tools.yaml")
        assert invoke("run", "tools.yaml", "--allow-commands").code == 0
    assert len(list(Path("runs").rglob("result.ply"))) == 2


def test_the_identity_depends_on_the_script_and_not_on_its_folder(here):
    identities = []
    for name in ("one", "two"):
        (here / name).mkdir()
        (trial,) = plan([load_experiment(str(config(here / name, "ok")))])
        identities.append(trial.identity)
    assert identities[0] == identities[1]
    limited = load_experiment(str(config(here, "ok")), ["sweep.variants.ok.fit.time_limit=9"])
    assert plan([limited])[0].identity == identities[0]


def test_tools_without_random_numbers_run_once(here):
    (trial,) = plan([load_experiment(str(config(here, "ok")))])
    assert trial.seed == 0
    both = config(here, "ok", "'{seed}'")
    assert [trial.seed for trial in plan([load_experiment(str(both))])] == [0, 0, 1]
    with trials_in_this_process():
        ran = invoke("run", "tools.yaml", "--allow-commands")
    assert ran.code == 0
    assert "- Without random numbers, and so run once: ok\n" in ran.out
    assert "Fewer seeds" not in ran.out


def test_a_worker_runs_commands_only_if_it_was_started_to(here, monkeypatch):
    trials = plan([load_experiment(str(config(here, "ok")))])
    store = RunDirectory(here / "runs")
    monkeypatch.delenv("MESHFIT_ALLOW_COMMANDS")
    from meshfit.errors import ClusterError, ConfigError

    with pytest.raises(ClusterError, match="start workers with MESHFIT_ALLOW_COMMANDS=1"):
        run_trials(trials, store, remote=Remote(Inline()), allow_commands=True)
    monkeypatch.setenv("MESHFIT_ALLOW_COMMANDS", "1")
    with pytest.raises(ConfigError, match="--allow-commands"):
        run_trials(trials, store, remote=Remote(Inline()))
    assert not list((here / "runs").rglob("result.json"))


def test_a_program_that_is_missing_is_named_before_anything_starts(here):
    path = config(here, "ok")
    path.write_text(path.read_text().replace(f"[{sys.executable}, ", "[no-such-program, "), encoding="utf-8")
    line = refused("run", "tools.yaml", "--allow-commands")
    assert line.endswith("fit.command: no-such-program: no such program on this machine")
