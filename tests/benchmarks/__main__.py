"""`make bench`: print a table of timings, write it to a file, and exit with 1 if one misses its goal."""

import argparse
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import track

from tests.benchmarks.apart import names, outcome_of
from tests.benchmarks.commands import run_directories
from tests.benchmarks.report import machine, table_of, write
from tests.benchmarks.timing import Outcome


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=Path("bench.json"), help="file for the figures")
    parser.add_argument("--only", default="", help="part of the names of the benchmarks to run")
    options = parser.parse_args()
    chosen = [name for name in names() if options.only in name]
    outcomes: dict[str, Outcome] = {}
    with run_directories(chosen):
        for name in track(chosen, "timing", console=Console(stderr=True)):
            outcomes[name] = outcome_of(name)
            write(options.json, outcomes)
    console = Console(width=170)
    console.print(table_of(outcomes))
    console.print(f"[dim]{', '.join(f'{key} {value}' for key, value in machine().items())}[/]")
    return int(any(outcome.short for outcome in outcomes.values()))


if __name__ == "__main__":
    sys.exit(main())
