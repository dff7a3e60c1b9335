"""Run meshfit as a user does: in its own process, with signals, output and exit code."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

ENVIRONMENT = os.environ | {"COLUMNS": "120", "NO_COLOR": "1", "PYTHONWARNINGS": "default"}


def start(*arguments: object, folder: Path, environment: Mapping[str, str] | None = None) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "meshfit", *map(str, arguments)],
        cwd=folder,
        env=ENVIRONMENT | dict(environment or {}),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_heed_signals,  # noqa: PLW1509  no threads here
    )


def _heed_signals() -> None:
    """A shell that runs the tests in the background may ignore some, and processes started here would inherit that."""
    for name in ("SIGINT", "SIGHUP", "SIGQUIT"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)


def meshfit(*arguments: object, folder: Path, code: int = 0) -> tuple[str, str]:
    """Run a command to its end; its output, once its exit code is what it should be."""
    process = start(*arguments, folder=folder)
    out, err = process.communicate(timeout=120)
    assert process.returncode == code, f"exit {process.returncode}\n{out}\n{err}"
    assert "Traceback" not in err
    return out, err


def wait_until(condition: Callable[[], bool], process: subprocess.Popen[str], seconds: float = 120) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, "the process ended before what it was waited for"
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.1)


def contents(runs: Path, *names: str) -> dict[str, bytes]:
    """The bytes of the files of these names in all trials, by their path."""
    return {str(path.relative_to(runs)): path.read_bytes() for name in names for path in sorted(runs.rglob(name))}


def _words(path: Path) -> list[str]:
    """The words of the file of a thread, which may have ended."""
    try:
        return path.read_text().split()
    except OSError:
        return []


def workers_of(parent: int) -> list[int]:
    if sys.platform == "linux":  # a process of its own costs much more
        return [int(pid) for path in Path(f"/proc/{parent}/task").glob("*/children") for pid in _words(path)]
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(parent)], capture_output=True, text=True, check=False)
    return [int(pid) for pid in found.stdout.split()]
