"""`meshfit expect`: write down what a reproduction has to come out at."""

import json
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import DEFAULT_METRIC, RunDirs


def expect(
    runs: RunDirs,
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write.", metavar="FILE")],
    metrics: Annotated[
        list[str] | None,
        typer.Option(
            "--metric",
            help="A metric to write down; may be repeated.",
            show_default=DEFAULT_METRIC,
            metavar="NAME",
            autocompletion=completions.metrics,
        ),
    ] = None,
) -> int:
    """Write the file that `meshfit table --check` compares with.

    It holds each cell, its spread over the seeds, and a tolerance that follows from it.

    Example:
        meshfit expect runs/table1 -o configs/expected/table1.json
    """
    from meshfit.experiment.store import read_results, write_atomically
    from meshfit.report.expected import expectation
    from meshfit.report.own_schemes import told_apart
    from meshfit.report.table import build_tables

    results = told_apart(read_results(runs))
    tables = [table for metric in metrics or [DEFAULT_METRIC] for table in build_tables(results, metric)]
    write_atomically(output, json.dumps(expectation(tables), indent=2) + "\n")
    cells = sum(len(table.cells) for table in tables)
    out.print(f"wrote {output}: {cells} cells", soft_wrap=True, markup=False)
    return 0
