"""Colours: those of the terminal, readable on white and black, never the only sign, and off on request."""

import os
import re
import subprocess
import sys

import pytest

from tests.runs import begun, complete, failed, write_plan

# Bold, italic, their ends; red, green, magenta, cyan, their end. No dim, yellow, blue, white, black, no fixed shade.
ALLOWED = {"0", "1", "3", "22", "23", "31", "32", "35", "36", "39"}
CODES = re.compile(r"\x1b\[([\d;]*)m")
COMMANDS = ("--help", "nonsense", "table RUNS", "status RUNS", "show TRIAL")
OTHERS = ("run --help", "schemes", "schemes loop")
DRIVER = """
import sys
from meshfit.cli.main import main
for command in sys.argv[1:]:
    sys.argv = ["meshfit", *command.split()]
    try:
        main()
    except SystemExit:
        print("\\0", flush=True)
"""


def printed(commands, **environment):
    """The output of each command, stdout and stderr together."""
    plain = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "FORCE_COLOR", "COLORTERM")}
    done = subprocess.run(
        [sys.executable, "-c", DRIVER, *commands],
        env=plain | {"COLUMNS": "80", "TERM": "xterm-256color", "PYTHONUNBUFFERED": "1"} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        check=True,
    )
    return done.stdout.split("\0\n")[:-1]


def outputs(folder, commands):
    """The output of each command with colours, without a terminal, and with NO_COLOR."""
    for seed in range(3):
        for scheme in ("loop", "interp-loop"):
            complete(folder, scheme=scheme, seed=seed)
    failed(folder, target="cow")
    begun(folder, target="cow", seed=1)
    write_plan(folder / "small", [{"target": "cow", "seed": 2}])
    trial = next((folder / "small" / "bunny" / "loop").iterdir())
    filled = [command.replace("RUNS", str(folder)).replace("TRIAL", str(trial)) for command in commands]
    ways = ({"FORCE_COLOR": "1"}, {}, {"FORCE_COLOR": "1", "NO_COLOR": "1"})
    return zip(commands, *(printed(filled, **more) for more in ways), strict=True)


@pytest.mark.parametrize("commands", [COMMANDS, pytest.param(OTHERS, marks=pytest.mark.slow)], ids=["most", "others"])
def test_colours_are_few_and_say_nothing_that_words_do_not(tmp_path, commands):
    for command, coloured, plain, unwanted in outputs(tmp_path, commands):
        codes = {code for found in CODES.findall(coloured) for code in found.split(";")}
        assert codes & {"1", "31", "36"}, command
        assert codes <= ALLOWED, command
        assert "\x1b" not in plain, command
        assert CODES.sub("", coloured) == plain, command
        if "--help" not in command:
            assert not re.search(r"[ \t]$", plain, flags=re.MULTILINE), command
        assert {code for found in CODES.findall(unwanted) for code in found.split(";")} <= {"0", "1", "3"}, command
