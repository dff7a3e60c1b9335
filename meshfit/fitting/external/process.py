"""Run a command under its supervisor: with limits of time and memory, in a minimal environment, its output bounded."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from meshfit.printable import printable

_SUPERVISOR = Path(__file__).with_name("supervisor.py")
_SECONDS_BETWEEN_POLLS = 0.1
_SECONDS_TO_END = 30.0
_HEAD, _TAIL = 8_000, 24_000
_PASSED_ON = (
    *("PATH", "HOME", "USER", "LOGNAME", "LANG", "LANGUAGE", "TZ", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH"),
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "IGL_NUM_THREADS", "CUDA_VISIBLE_DEVICES"),
    *("SYSTEMROOT", "USERPROFILE", "PATHEXT"),
)


@dataclass(frozen=True)
class Limits:
    """Limits of a process: seconds, and MB of memory of it and all its descendants together; None for none."""

    seconds: float
    memory_mb: float | None = None


@dataclass(frozen=True)
class Ended:
    """An ended process.

    Attributes:
        code: exit code, or minus the number of the signal that ended it; None if it was stopped, or did not start.
        error: the reason why it could not be started; None if it was.
        seconds: duration.
        peak_memory_mb: peak memory of the process and its descendants; None where the system does not report it.
        output: beginning and end of standard output and error, with control characters as escapes.
        timed_out: whether it was stopped at the time limit.
        too_large: whether it was stopped at the memory limit.
    """

    code: int | None
    error: str | None
    seconds: float
    peak_memory_mb: float | None
    output: str
    timed_out: bool
    too_large: bool


def environment_of(names: Sequence[str], folder: Path) -> dict[str, str]:
    """Return the environment of a tool: paths, language and threads, and the named variables; no others."""
    kept = {name: value for name, value in os.environ.items() if name in (*_PASSED_ON, *names)}
    kept |= {name: value for name, value in os.environ.items() if name.startswith("LC_")}
    return kept | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder)) | {"PYTHONHASHSEED": "0"}


def run_process(
    command: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    limits: Limits,
    on_wait: Callable[[], None] = lambda: None,
) -> Ended:
    """Run a command in a folder, without a shell, and wait for it; nothing that it started outlives this call.

    Args:
        command: the program and its arguments.
        folder: its working directory; the files of the supervisor are next to it.
        environment: all of its environment.
        limits: of time and memory.
        on_wait: called several times a second; if it raises, the command is stopped.
    """
    task, report = (folder.with_name(f"{folder.name}-{name}.json") for name in ("task", "report"))
    report.unlink(missing_ok=True)
    content = {
        "command": list(command),
        "folder": str(folder),
        "environment": dict(environment),
        "memory_mb": limits.memory_mb,
        "report": str(report),
    }
    task.write_text(json.dumps(content), encoding="utf-8")
    timed_out, start = False, time.monotonic()
    supervisor = subprocess.Popen(  # noqa: S603  our own script
        [sys.executable, "-I", "-S", str(_SUPERVISOR), str(task)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    assert supervisor.stdin is not None  # noqa: S101  as asked for above
    assert supervisor.stdout is not None  # noqa: S101
    output = _Output(supervisor.stdout)
    try:
        while supervisor.poll() is None and not timed_out:
            try:
                supervisor.wait(_SECONDS_BETWEEN_POLLS)
            except subprocess.TimeoutExpired:
                on_wait()
                timed_out = time.monotonic() - start > limits.seconds
    finally:
        supervisor.stdin.close()
        try:
            supervisor.wait(_SECONDS_TO_END)
        except subprocess.TimeoutExpired:
            supervisor.kill()
            supervisor.wait()
        text = output.close()
    return _ended(report, text, time.monotonic() - start, timed_out=timed_out)


def _ended(report: Path, output: str, seconds: float, *, timed_out: bool) -> Ended:
    try:
        content = json.loads(report.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # the supervisor was killed
        return Ended(-9, None, seconds, None, output, timed_out=timed_out, too_large=False)
    values = (content["code"], content["error"], float(content["seconds"]), content["peak_mb"], output)
    return Ended(*values, timed_out=timed_out and content["code"] is None, too_large=bool(content["too_large"]))


class _Output:
    """Beginning and end of a stream, read by a thread."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._head, self._tail, self._dropped = stream, bytearray(), bytearray(), 0
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while content := os.read(self._stream.fileno(), 1 << 16):
            room = _HEAD - len(self._head)
            self._head += content[:room]
            self._tail += content[room:] if room > 0 else content
            excess = max(0, len(self._tail) - _TAIL)
            del self._tail[:excess]
            self._dropped += excess

    def close(self) -> str:
        """Wait for the end of the stream, and return what is kept of it."""
        self._thread.join(_SECONDS_TO_END)
        if not self._thread.is_alive():
            self._stream.close()
        gap = f"\n[{self._dropped:,} bytes left out]\n".encode() if self._dropped else b""
        text = bytes(self._head + gap + self._tail).decode("utf-8", errors="replace")
        lines = [line.rstrip() for line in text.replace("\r\n", "\n").replace("\r", "\n").split("\n")]
        return printable("\n".join(lines).strip("\n"), keep="\n\t")
