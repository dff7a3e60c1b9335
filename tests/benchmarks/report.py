"""Benchmarks as tables and as files."""

import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.table import Table

from tests.benchmarks.timing import Outcome, seconds

_CPU_INFO = Path("/proc/cpuinfo")


def table_of(outcomes: Mapping[str, Outcome]) -> Table:
    """A line for each benchmark."""
    table = Table(box=None, pad_edge=False)
    columns = ("what", "median", "±", "CPU", "set against", "its CPU", "ratio", "asked", "memory")
    for column in columns:
        table.add_column(column, justify="left" if column in ("what", "set against") else "right")
    for name, outcome in outcomes.items():
        ours, other = outcome.ours, outcome.other
        ratio = "" if outcome.ratio is None else f"{outcome.ratio:.1f} ×"
        asked = f"[red]{outcome.asked}: short[/]" if outcome.short else outcome.asked
        times = (seconds(ours.wall), seconds(ours.spread), seconds(ours.cpu))
        others = (outcome.other_name, seconds(other.cpu) if other else "")
        table.add_row(name, *times, *others, ratio, asked, f"{outcome.memory_mb:.0f} MB")
    return table


def write(path: Path, outcomes: Mapping[str, Outcome]) -> None:
    """The figures as JSON, with the machine that they are of."""
    content = {"machine": machine(), "benchmarks": {name: asdict(outcome) for name, outcome in outcomes.items()}}
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def machine() -> dict[str, Any]:
    """What was measured on."""
    model = platform.processor() or platform.machine()
    if _CPU_INFO.is_file():
        names = [line for line in _CPU_INFO.read_text().splitlines() if line.startswith("model name")]
        model = names[0].partition(":")[2].strip() if names else model
    packages = {name: version(name) for name in ("meshfit", "torch", "numpy", "pykdtree")}
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
    } | packages
