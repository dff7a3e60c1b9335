"""Errors that nobody foresaw: one line, and a file with the traceback."""

import logging
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from meshfit.cli.console import EXIT_INTERRUPTED, exit_code_of
from meshfit.cli.crash_report import EXIT_CRASHED
from meshfit.experiment.storage.failure import FailureKind, failure_kind
from meshfit.library_output import TRACEBACK_VARIABLE
from tests.cli.processes import ENVIRONMENT


@pytest.fixture
def crash(monkeypatch, tmp_path, capsys):
    """A function that lets a command raise an error, and returns its exit code and its stderr."""
    monkeypatch.delenv(TRACEBACK_VARIABLE, raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["meshfit", "measure", "a b.ply"])

    def command_raising(error):
        def command():
            raise error

        code = exit_code_of(command)
        return code, capsys.readouterr().err

    return command_raising


def test_an_unexpected_error_is_one_line_that_names_a_file_with_its_traceback(crash):
    code, err = crash(ZeroDivisionError("by\nnothing [red]\x1b[31m" + 1000 * "!"))
    assert code == EXIT_CRASHED
    assert re.match(r"error: unexpected ZeroDivisionError: by nothing \[red\]\\x1b\[31m!+…; this is an error", err)
    assert err.count("\n") == 1
    assert len(err) < 500
    saved = Path(re.search(r"its traceback is in (\S+)", err)[1]).read_text(encoding="utf-8")
    assert "command: meshfit measure 'a b.ply'" in saved
    assert "in command_raising" not in saved
    assert ", in command\n" in saved
    assert "ZeroDivisionError" in saved


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("[enforce fail] can't allocate memory: 9 bytes")])
def test_lack_of_memory_is_one_line(crash, error):
    code, err = crash(error)
    assert code == EXIT_CRASHED
    assert err.startswith("error: not enough memory; use smaller meshes or fewer workers")
    assert err.count("\n") == 1


def test_a_traceback_that_cannot_be_saved_is_shown_on_demand(crash, monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    _, err = crash(KeyError("x"))
    assert err.endswith(f"cannot be saved: No such file or directory; {TRACEBACK_VARIABLE}=1 shows it\n")
    monkeypatch.setenv(TRACEBACK_VARIABLE, "1")
    _, err = crash(KeyError("x"))
    assert err.startswith("Traceback (most recent call last)")
    assert err.count("error:") == 1


def test_other_ends_of_a_command_are_left_alone(crash, tmp_path):
    assert crash(KeyboardInterrupt()) == (EXIT_INTERRUPTED, "interrupted\n")
    with pytest.raises(SystemExit):
        crash(SystemExit(3))
    assert not list(tmp_path.iterdir())


def test_lack_of_memory_while_libraries_are_imported_is_one_line(tmp_path):
    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (160 * 10**6, 160 * 10**6))

    command = [sys.executable, "-m", "meshfit", "targets"]
    environment = ENVIRONMENT | {"TMPDIR": str(tmp_path)}
    done = subprocess.run(
        command, env=environment, preexec_fn=limit, capture_output=True, text=True, check=False, timeout=100
    )
    assert re.fullmatch(r"error: not enough memory; .*\n", done.stderr), done.stderr
    assert done.returncode == EXIT_CRASHED


@pytest.mark.parametrize(("command", "megabytes"), [("run", 800), ("fit", 400), ("measure", 400), ("table", 100)])
def test_a_limit_that_libraries_cannot_be_loaded_in_is_named_at_once(command, megabytes):
    """At 100 MB OpenBLAS would end the process with a line of its own; a run at 800 MB would not end."""

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (megabytes * 10**6, megabytes * 10**6))

    done = subprocess.run(
        [sys.executable, "-m", "meshfit", command, "x"],
        env=ENVIRONMENT,
        preexec_fn=limit,
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    expected = (
        rf"error: not enough memory: meshfit {command} needs [\d,]+ MB of .*, and the limit is {megabytes} MB; .*\n"
    )
    assert re.fullmatch(expected, done.stderr), done.stderr
    assert done.returncode == EXIT_CRASHED


def test_a_library_that_cannot_be_mapped_is_lack_of_memory():
    unloadable = ImportError("libQt5Widgets.so.5: failed to map segment from shared object")
    assert failure_kind(unloadable) is FailureKind.OUT_OF_MEMORY
    assert failure_kind(ImportError("no module")) is FailureKind.ERROR


def test_libraries_log_nothing_and_their_threads_die_quietly():
    code = (
        "import logging, sys, threading, meshfit.__main__ as entry; sys.argv = ['meshfit', 'targets']\n"
        "def noise():\n logging.getLogger('trimesh').error('noise'); thread = threading.Thread(target=lambda: 1 / 0)\n"
        " thread.start(); thread.join()\n"
        "import meshfit.cli.main as main; main.run_app = lambda: noise() or 0\nentry.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, check=False, timeout=100)
    assert (done.returncode, done.stderr) == (0, b"")
    assert logging.root.manager.disable == 0  # of the tests' own process
