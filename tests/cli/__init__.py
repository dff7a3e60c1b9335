"""meshfit within this process: the same entry point as the console script, its output and its exit code."""

import contextlib
import io
import sys
from typing import NamedTuple
from unittest import mock

from meshfit.cli import console
from meshfit.cli.main import main

WIDTH = 160


class Ran(NamedTuple):
    """What a command left behind."""

    code: int
    out: str
    err: str


def invoke(*arguments: object) -> Ran:
    """Run a command line; whatever is not foreseen is raised, as it would be a traceback to the user."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["meshfit", *map(str, arguments)]),
        mock.patch.object(sys.modules["__main__"], "__package__", None, create=True),  # not `python -m pytest`
        mock.patch.object(console.out, "_width", WIDTH),
        mock.patch.object(console.err, "_width", WIDTH),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code
    assert isinstance(code, int)
    return Ran(code, out.getvalue(), err.getvalue())


def answered(*arguments: object) -> str:
    """What is printed by a command line that is done as it was asked."""
    ran = invoke(*arguments)
    assert (ran.code, ran.err) == (0, "")
    return ran.out


def refused(*arguments: object) -> str:
    """What is said of a command line that is refused: one line on stderr, nothing on stdout, exit code 2."""
    ran = invoke(*arguments)
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.count("\n") == 1, ran.err
    assert "Traceback" not in ran.err
    return ran.err.removesuffix("\n")
