"""Benchmarked commands, in a module without torch, whose memory would otherwise count as theirs."""

import atexit
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from tests.benchmarks.timing import Benchmark


def _command(*arguments: str, limit: float = 0.4) -> Benchmark:
    command = [sys.executable, "-m", "meshfit", *arguments]
    return Benchmark(partial(subprocess.run, command, check=True, capture_output=True), 7, clock="wall", limit=limit)


def _table() -> Benchmark:
    from tests.benchmarks.synthetic import write_results

    root = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, root)
    write_results(Path(root))
    return _command("table", root, limit=2)


COMMANDS: dict[str, Callable[[], Benchmark]] = {
    "meshfit --help": lambda: _command("--help"),
    "meshfit schemes": lambda: _command("schemes"),
    "meshfit table, 3,000 results": _table,
}
