"""Fixtures of the command tests: one real run, and shell completion."""

import json

import pytest
from filelock import FileLock

from meshfit.cli import console
from tests.cli import answered
from tests.cli.processes import meshfit
from tests.small import config_file


@pytest.fixture(autouse=True)
def in_time(monkeypatch):
    """Keep messages that appear only after some seconds from appearing on a slow machine."""
    monkeypatch.setattr(console, "_SECONDS_UNTIL_SAID", 600.0)


@pytest.fixture(scope="session")
def small_run(tmp_path_factory, worker_id):
    """A folder in which the small experiment was run in a process of its own, with its stdout and stderr.

    The workers of pytest-xdist share it.
    """
    root = tmp_path_factory.getbasetemp()
    folder = (root if worker_id == "master" else root.parent) / "complete"
    printed = folder.with_name("complete.json")
    with FileLock(folder.with_name("complete.lock")):
        if not printed.is_file():
            folder.mkdir()
            printed.write_text(
                json.dumps(meshfit("run", config_file(folder), "-j", 1, folder=folder)), encoding="utf-8"
            )
    return folder, tuple(json.loads(printed.read_text(encoding="utf-8")))


@pytest.fixture
def completed(monkeypatch):
    """A function that returns what a shell offers for the last word of a line."""

    def complete_line(line, shell="bash"):
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
        monkeypatch.setenv("_TYPER_COMPLETE_ARGS", line)
        monkeypatch.setenv("_TYPER_COMPLETE_FISH_ACTION", "get-args")
        monkeypatch.setenv("_MESHFIT_COMPLETE", f"complete_{shell}")
        return answered().splitlines()

    return complete_line
