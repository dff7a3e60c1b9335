"""`make bench-compare OLD=a.json NEW=b.json`: two files that `make bench` wrote, side by side."""

import argparse
import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tests.benchmarks.timing import seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    paths = parser.parse_args()
    old, new = (json.loads(path.read_text(encoding="utf-8")) for path in (paths.old, paths.new))
    console = Console(width=150)
    console.print(compared(old["benchmarks"], new["benchmarks"]))
    for name, content in ((paths.old, old), (paths.new, new)):
        console.print(f"[dim]{name}: {', '.join(f'{key} {value}' for key, value in content['machine'].items())}[/]")


def compared(old: dict[str, Any], new: dict[str, Any]) -> Table:
    """A line for each benchmark of either; change of CPU time, in which other work on the machine shows least."""
    table = Table(box=None, pad_edge=False)
    for column in ("what", "old CPU", "new CPU", "change", "old ratio", "new ratio", "old memory", "new memory"):
        table.add_column(column, justify="left" if column == "what" else "right")
    for name in dict.fromkeys([*old, *new]):
        before, after = old.get(name), new.get(name)
        change = f"{after['ours']['cpu'] / before['ours']['cpu'] - 1:+.0%}" if before and after else ""
        cpus = [seconds(one["ours"]["cpu"]) if one else "" for one in (before, after)]
        ratios = [f"{one['ratio']:.1f} ×" if one and one["ratio"] else "" for one in (before, after)]
        memory = [f"{one['memory_mb']:.0f} MB" if one else "" for one in (before, after)]
        table.add_row(name, *cpus, change, *ratios, *memory)
    return table


if __name__ == "__main__":
    main()
