"""Run meshfit within this process, by the entry point of the console script."""

import contextlib
import io
import sys
from typing import NamedTuple
from unittest import mock

from meshfit.cli import console
from meshfit.cli.main import main
from meshfit.experiment.running.backends import Remote
from tests.inline import Inline

WIDTH = 160


class Ran(NamedTuple):
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


@contextlib.contextmanager
def trials_in_this_process():
    """Run trials here instead of in worker processes, each of which would import torch first."""
    with mock.patch("meshfit.cli.experiments._remote", return_value=contextlib.nullcontext(Remote(Inline()))):
        yield


def _raised(error: BaseException) -> str:
    raise error


def invoke(*arguments: object) -> Ran:
    """Run a command line in this process; unexpected errors, which would be a report to the user, are raised."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["meshfit", *map(str, arguments)]),
        mock.patch.object(sys.modules["__main__"], "__package__", None, create=True),  # not `python -m pytest`
        mock.patch.object(console, "crash_report", _raised),
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
    """Run a command line that has to succeed, and return its output."""
    ran = invoke(*arguments)
    assert (ran.code, ran.err) == (0, "")
    return ran.out


def refused(*arguments: object) -> str:
    """Run a command line that has to be refused with exit code 2 in one line on stderr, and return that line."""
    ran = invoke(*arguments)
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.count("\n") == 1, ran.err
    assert "Traceback" not in ran.err
    return ran.err.removesuffix("\n")
