"""Colour: the terminal's own, readable on white and on black, never the only sign, and gone where it is not wanted."""

import os
import re
import subprocess
import sys

import pytest

from tests.runs import begun, complete, failed, write_plan

# Bold, italic, their ends; red, green, magenta, cyan, their end. No dim, yellow, blue, white, black, no fixed shade.
ALLOWED = {"0", "1", "3", "22", "23", "31", "32", "35", "36", "39"}
CODES = re.compile(r"\x1b\[([\d;]*)m")
COMMANDS = (["--help"], ["run", "--help"], ["schemes"], ["schemes", "loop"], ["nonsense"])
OF_RUNS = ("table", "status", "show")


def printed(*arguments, **environment):
    """What is printed, on stdout and stderr together."""
    plain = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "FORCE_COLOR", "COLORTERM")}
    done = subprocess.run(
        [sys.executable, "-c", "from meshfit.cli.main import main; main()", *map(str, arguments)],
        env=plain | {"COLUMNS": "80", "TERM": "xterm-256color"} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        check=False,
    )
    return done.stdout


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for seed in range(3):
        for scheme in ("loop", "interp-loop"):
            complete(folder, scheme=scheme, seed=seed)
    failed(folder, target="cow")
    begun(folder, target="cow", seed=1)
    write_plan(folder / "small", [{"target": "cow", "seed": 2}])
    return folder


def arguments_of(command, runs):
    if command[0] not in OF_RUNS:
        return command
    return [command[0], next((runs / "small" / "bunny" / "loop").iterdir()) if command[0] == "show" else runs]


@pytest.mark.parametrize("command", [*COMMANDS, *([name] for name in OF_RUNS)], ids=" ".join)
def test_colours_are_few_and_say_nothing_that_words_do_not(command, runs):
    arguments = arguments_of(command, runs)
    coloured = printed(*arguments, FORCE_COLOR="1")
    codes = {code for found in CODES.findall(coloured) for code in found.split(";")}
    assert codes & {"1", "31", "36"}
    assert codes <= ALLOWED
    plain = printed(*arguments)
    assert "\x1b" not in plain
    assert CODES.sub("", coloured) == plain
    assert not re.search(r"[ \t]$", plain, flags=re.MULTILINE)
    unwanted = printed(*arguments, FORCE_COLOR="1", NO_COLOR="1")
    assert {code for found in CODES.findall(unwanted) for code in found.split(";")} <= {"0", "1", "3"}
