"""Fixtures of the command tests: one real run, and shell completion."""

import pytest

from tests.cli import answered
from tests.cli.processes import meshfit
from tests.small import config_file


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """A folder in which the small experiment was run in a process of its own, with its stdout and stderr."""
    folder = tmp_path_factory.mktemp("complete")
    return folder, meshfit("run", config_file(folder), folder=folder)


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
