"""Commands that are benchmarked, apart from other cases: a process that has loaded torch would lend them its size."""

import subprocess
import sys
from collections.abc import Callable
from functools import partial

from tests.benchmarks.timing import Benchmark


def _command(*arguments: str) -> Benchmark:
    command = [sys.executable, "-m", "meshfit", *arguments]
    return Benchmark(partial(subprocess.run, command, check=True, capture_output=True), 7, limit=0.4)


COMMANDS: dict[str, Callable[[], Benchmark]] = {
    "meshfit --help": lambda: _command("--help"),
    "meshfit schemes": lambda: _command("schemes"),
}
