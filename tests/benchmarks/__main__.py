"""`make bench`: print a table of timings, and exit 1 where a ratio falls short of its target."""

import sys

import torch
from rich.console import Console
from rich.table import Table

from tests.benchmarks.cases import cases
from tests.benchmarks.timing import Outcome, run


def main() -> int:
    torch.set_num_threads(1)
    outcomes = [run(case) for case in cases()]
    table = Table(box=None, pad_edge=False)
    for column in ("what", "wall", "±", "CPU", "twin", "twin's CPU", "times faster"):
        table.add_column(column, justify="left" if column in ("what", "twin") else "right")
    for outcome in outcomes:
        table.add_row(*_row(outcome))
    Console(width=150).print(table)
    return int(any(_falls_short(outcome) for outcome in outcomes))


def _falls_short(outcome: Outcome) -> bool:
    target, ratio = outcome.benchmark.target, outcome.ratio
    return target is not None and ratio is not None and ratio < target


def _row(outcome: Outcome) -> tuple[str, ...]:
    twin = outcome.twin
    ratio = "" if outcome.ratio is None else f"{outcome.ratio:.1f}" + (" short" if _falls_short(outcome) else "")
    times = (_time(outcome.ours.wall), _time(outcome.ours.spread), _time(outcome.ours.cpu))
    return (outcome.benchmark.name, *times, outcome.benchmark.twin_name, _time(twin.cpu) if twin else "", ratio)


def _time(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 1 else f"{seconds * 1000:.1f} ms"


if __name__ == "__main__":
    sys.exit(main())
