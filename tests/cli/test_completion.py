"""Completion in shells: as they ask for it, through environment variables."""

import os
import subprocess
import sys

import pytest

from meshfit.cli import completions
from meshfit.config.loading import bundled_configs
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.targets import NAMED_TARGETS
from meshfit.subdivision.registry import SCHEMES
from tests.runs import complete

RUN = "import sys; sys.argv[0] = 'meshfit'; from meshfit.cli.main import main; main()"


def completed(line, shell="bash", folder="."):
    """What a shell offers for the last word of a line."""
    words = line.split(" ")
    asked = {"COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    asked |= {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        env=os.environ | asked | {"_MESHFIT_COMPLETE": f"complete_{shell}"},
        cwd=folder,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert done.stderr == ""
    return done.stdout.splitlines()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "mine.yaml").touch()
    (tmp_path / "head.obj").touch()
    (tmp_path / "notes.txt").touch()
    complete(tmp_path / "runs")
    return tmp_path


def test_commands_and_options_are_completed():
    assert completed("meshfit sch") == ["schemes", "schema"]
    assert completed("meshfit run x --me") == ["--metric"]


NAMES = {
    "meshfit run ": {*bundled_configs(), "mine.yaml"},
    "meshfit schemes ": {*SCHEMES, "mine.yaml"},
    "meshfit compare loop --targets bunny,": {f"bunny,{name}" for name in (*NAMED_TARGETS, "head.obj")},
    "meshfit measure ": {*NAMED_TARGETS, "head.obj"},
    "meshfit table runs --metric ": set(METRICS),
    "meshfit table runs --format ": {"rich", "md", "csv", "latex", "json"},
    "meshfit run x --transfer ": {"auto", "shared", "returned"},
    "meshfit table ": {"runs"},
}


@pytest.mark.parametrize("line", NAMES)
def test_values_are_completed(line, folder):
    assert {value for value in completed(line, folder=folder) if not value.endswith(os.sep)} == NAMES[line]


def test_the_keys_of_settings_are_completed_of_both_engines():
    assert completed("meshfit run x --set fit.optimizer.m") == ["fit.optimizer.momentum="]
    assert completed("meshfit run x --set fit.conn") == ["fit.connectivity="]


def test_the_folder_of_a_trial_is_found_where_there_is_no_choice(folder):
    (found,) = completed("meshfit show ru", folder=folder)
    assert (folder / found / "result.json").is_file()
    complete(folder / "runs", target="cow")
    assert completed("meshfit show ru", folder=folder) == ["runs/small/bunny", "runs/small/cow"]


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_are_told_what_values_mean(shell):
    (line,) = completed("meshfit schemes butter", shell)
    assert "butterfly" in line
    assert SCHEMES["butterfly"].title in line


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_has_a_script_to_install(shell):
    environment = os.environ | {"_MESHFIT_COMPLETE": f"source_{shell}"}
    done = subprocess.run([sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=False)
    assert f"_MESHFIT_COMPLETE=complete_{shell}" in done.stdout


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
