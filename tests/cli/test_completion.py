"""Shell completion, as shells ask for it: through environment variables."""

import os
import subprocess
import sys

import pytest

from meshfit.cli import completions
from meshfit.config.loading import bundled_configs
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.io.files import FORMATS, READABLE_FORMATS
from meshfit.mesh.targets import NAMED_TARGETS
from meshfit.subdivision.registry import SCHEMES
from tests.cli import answered
from tests.runs import complete

MESHES = ("head.obj", "Head.PLY", "scan.stl.gz", "part.3mf")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").touch()
    for name in (*MESHES, "notes.txt", "notes.gz"):
        (tmp_path / name).touch()
    complete(tmp_path / "runs")
    return tmp_path


def test_a_shell_asks_through_the_environment():
    asked = {"COMP_WORDS": "meshfit sch", "COMP_CWORD": "1", "_MESHFIT_COMPLETE": "complete_bash"}
    code = "import sys; sys.argv = ['meshfit']; from meshfit.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | asked, capture_output=True, text=True, check=False
    )
    assert (done.stdout.splitlines(), done.stderr) == (["schemes", "schema"], "")


def test_options_are_completed(completed):
    assert completed("meshfit run x --me") == ["--metric"]


NAMES = {
    "meshfit run ": {*bundled_configs(), "mine.yaml"},
    "meshfit schemes ": {*SCHEMES, "mine.yaml"},
    "meshfit compare loop --targets bunny,": {f"bunny,{name}" for name in (*NAMED_TARGETS, *MESHES)},
    "meshfit measure ": {*NAMED_TARGETS, *MESHES},
    "meshfit table runs --metric ": set(METRICS),
    "meshfit table runs --format ": {"rich", "md", "csv", "latex", "json"},
    "meshfit run x --transfer ": {"auto", "shared", "returned"},
    "meshfit table ": {"runs"},
    "meshfit subdivide in.ply out.ply --format ": {suffix[1:] for suffix in READABLE_FORMATS},
    "meshfit subdivide in.ply out.ply --output-format ": {suffix[1:] for suffix in FORMATS},
}


@pytest.mark.parametrize("line", NAMES)
def test_values_are_completed(line, completed, folder):
    assert {value for value in completed(line) if not value.endswith(os.sep)} == NAMES[line]


def test_the_keys_of_settings_are_completed_of_both_engines(completed):
    assert completed("meshfit run x --set fit.optimizer.m") == ["fit.optimizer.momentum="]
    assert completed("meshfit run x --set fit.conn") == ["fit.connectivity="]


def test_the_folder_of_a_trial_is_found_where_there_is_no_choice(completed, folder):
    (found,) = completed("meshfit show ru")
    assert (folder / found / "result.json").is_file()
    complete(folder / "runs", target="cow")
    assert completed("meshfit show ru") == ["runs/small/bunny", "runs/small/cow"]


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_the_meaning_of_values(completed, shell):
    (line,) = completed("meshfit schemes butter", shell)
    assert "butterfly" in line
    assert SCHEMES["butterfly"].title in line


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_has_a_script_to_install(monkeypatch, shell):
    monkeypatch.setenv("_MESHFIT_COMPLETE", f"source_{shell}")
    assert f"_MESHFIT_COMPLETE=complete_{shell}" in answered()


def test_what_is_not_there_completes_to_nothing():
    assert completions.folders("no/such/place") == []
    assert completions.configs("no/such/place") == []


def test_completing_loads_no_heavy_library():
    heavy = "{'torch', 'trimesh', 'pymeshlab', 'scipy', 'igl', 'pyvista'}"
    names = "configs", "schemes", "targets", "metrics", "settings", "folders", "trials"
    code = f"import sys; from meshfit.cli import completions as c; [getattr(c, n)('') for n in {names}]"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; print(sorted({heavy} & sys.modules.keys()))"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "[]\n"
