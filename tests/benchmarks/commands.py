"""Benchmarked commands, in a module without torch, whose memory would otherwise count as theirs."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Literal

from tests.benchmarks.timing import Benchmark

_RUNS = "MESHFIT_BENCHMARK_RUNS"
"""Variable of the environment with the folder of the run directories that commands are timed on."""


@contextmanager
def run_directories(benchmarks: Iterable[str]) -> Iterator[None]:
    """Write the run directories of some benchmarks, beforehand: else their memory would be that of the writer."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ[_RUNS] = folder
        for option in {option for name, option in _DIRECTORIES.items() if any(name in each for each in benchmarks)}:
            make = [
                sys.executable,
                "-m",
                "tests.benchmarks.synthetic",
                str(Path(folder, option)),
                "--trials",
                *option.split(),
            ]
            subprocess.run(make, check=True)
        yield


def _command(*arguments: str, limit: float = 0.4, repeat: int = 7, clock: Literal["wall", "cpu"] = "wall") -> Benchmark:
    run = partial(subprocess.run, [sys.executable, "-m", "meshfit", *arguments], check=True, capture_output=True)
    return Benchmark(run, repeat, clock=clock, limit=limit)


def _on_runs(command: str, trials: str, *options: str, limit: float = 2.0, repeat: int = 5) -> Benchmark:
    """A command on a run directory, with the options in front of the path that it writes."""
    folder = Path(os.environ[_RUNS])
    output = [*options, str(folder / f"{command}.csv")] if options else []
    return _command(command, str(folder / trials), *output, limit=limit, repeat=repeat, clock="cpu")


_DIRECTORIES = {"3,000 trials": "3000", "500 targets": "500 --apart"}
COMMANDS: dict[str, Callable[[], Benchmark]] = {
    "meshfit --help": lambda: _command("--help"),
    "meshfit schemes": lambda: _command("schemes"),
    "meshfit status, 3,000 trials": lambda: _on_runs("status", "3000"),
    "meshfit table, 3,000 trials": lambda: _on_runs("table", "3000"),
    "meshfit export, 3,000 trials": lambda: _on_runs("export", "3000", "--output"),
    "meshfit report, 500 targets": lambda: _on_runs("report", "500 --apart", "--output", limit=60, repeat=1),
}
