"""The parent of an external tool: a script of the standard library alone, which leaves no process behind.

It starts the tool in a session of its own, and kills the tool and all its descendants when the tool has ended, when its
memory exceeds a limit, or when standard input ends: because the caller closed it, or died.

Arguments: a JSON file with `command`, `folder`, `environment`, `memory_mb` (or null) and `report`. The report, a JSON
file, has `code` (that of `subprocess`, or null if the tool could not be started), `error`, `seconds`, `peak_mb` and
`too_large`.
"""

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

_SECONDS_BETWEEN_CHECKS = 0.02
_SECONDS_BETWEEN_SCANS = 0.25
_PR_SET_CHILD_SUBREAPER = 36


def main() -> None:
    """Run the tool, and write the report."""
    task: dict[str, Any] = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    _adopt_orphans()
    ended = threading.Event()
    threading.Thread(target=_wait_for_end_of_input, args=(ended,), daemon=True).start()
    report = {"code": None, "error": None, "too_large": False} | _supervise(task, ended)
    path = Path(task["report"])
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(report), encoding="utf-8")
    unfinished.replace(path)
    os._exit(0)  # the thread may still be reading


def _supervise(task: dict[str, Any], ended: threading.Event) -> dict[str, Any]:
    start = time.monotonic()
    try:
        tool = subprocess.Popen(  # noqa: S603  the caller's command, without a shell
            task["command"],
            cwd=task["folder"],
            env=task["environment"],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except (OSError, ValueError) as error:
        return {"error": getattr(error, "strerror", None) or str(error), "seconds": 0.0, "peak_mb": None}
    too_large, scan, peak = False, start, 0.0
    while tool.poll() is None and not ended.is_set():
        now = time.monotonic()
        if now >= scan:
            used = sum(memory for _, memory in _descendants(os.getpid()).values())
            peak, scan = max(peak, used), now + _SECONDS_BETWEEN_SCANS
            too_large = task["memory_mb"] is not None and used > task["memory_mb"]
        if too_large:
            break
        time.sleep(_SECONDS_BETWEEN_CHECKS)
    seconds = time.monotonic() - start
    code = tool.poll()
    _kill_descendants(tool.pid)
    tool.wait()
    return {"code": code, "seconds": seconds, "peak_mb": max(peak, _largest_child()) or None, "too_large": too_large}


def _adopt_orphans() -> None:
    """Become the parent of descendants whose parents end, so that they are found; on Linux only."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _wait_for_end_of_input(ended: threading.Event) -> None:
    with suppress(OSError):
        while os.read(0, 4096):
            pass
    ended.set()


def _kill_descendants(group: int) -> None:
    """Kill the tool's process group, and all that have left it, until there are none."""
    for _ in range(100):
        if hasattr(os, "killpg"):
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(group, signal.SIGKILL)
        others = _descendants(os.getpid())
        for pid in others:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)
        with suppress(ChildProcessError, AttributeError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        if not others:
            return
        time.sleep(_SECONDS_BETWEEN_CHECKS)


def _descendants(ancestor: int) -> dict[int, tuple[int, float]]:
    """Return the parent and the memory in MB of each descendant that is not a zombie."""
    processes = _of_proc() if Path("/proc/self/stat").exists() else _of_ps()
    found: dict[int, tuple[int, float]] = {}
    above = {ancestor}
    while above:
        children = {pid for pid, (parent, _) in processes.items() if parent in above} - found.keys()
        found |= {pid: processes[pid] for pid in children}
        above = children
    return found


def _of_proc() -> dict[int, tuple[int, float]]:
    page, processes = os.sysconf("SC_PAGE_SIZE"), dict[int, tuple[int, float]]()
    for entry in os.listdir("/proc"):  # noqa: PTH208  called often
        if entry.isdigit():
            with suppress(OSError, ValueError, IndexError):
                text = Path("/proc", entry, "stat").read_text(encoding="utf-8", errors="replace")
                fields = text.rpartition(")")[2].split()
                if fields[0] not in "ZX":
                    processes[int(entry)] = int(fields[1]), int(fields[21]) * page / 1e6
    return processes


def _of_ps() -> dict[int, tuple[int, float]]:
    processes: dict[int, tuple[int, float]] = {}
    with suppress(OSError, ValueError):
        listing = subprocess.Popen(["/bin/ps", "-A", "-o", "pid=,ppid=,rss="], stdout=subprocess.PIPE, text=True)
        for line in listing.communicate()[0].splitlines():
            pid, parent, kilobytes = line.split()
            if int(pid) != listing.pid:
                processes[int(pid)] = int(parent), int(kilobytes) * 1024 / 1e6
    return processes


def _largest_child() -> float:
    """Return the peak memory in MB of the largest process that has ended; 0 where the system does not report it."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * unit / 1e6


if __name__ == "__main__":
    main()
