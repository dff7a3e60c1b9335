"""`meshfit expect`: write the expected values that `meshfit table --check` compares with."""

import json
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import split_metrics, takes_run_dirs
from meshfit.measuring.metrics import DEFAULT_METRIC


@takes_run_dirs
def expect(
    runs: list[Path],
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write.", metavar="FILE")],
    metrics: Annotated[
        list[str] | None,
        typer.Option(
            "--metric",
            help="A metric to include, or several: a,b. May be repeated.",
            show_default=DEFAULT_METRIC,
            metavar="NAME,...",
            autocompletion=completions.listed_metrics,
            callback=split_metrics,
        ),
    ] = None,
) -> int:
    """Write expected values for `meshfit table --check`.

    For each cell, the file has the mean, its spread over the seeds, and a tolerance derived from the spread.

    Example:
        meshfit expect runs/table1 -o configs/expected/table1.json
    """
    from meshfit.experiment.storage.plan_file import in_planned_order
    from meshfit.experiment.storage.result import read_results
    from meshfit.experiment.storage.run_directory import write_atomically
    from meshfit.report.tables.expected import expectation
    from meshfit.report.tables.grouping import distinguish_definitions
    from meshfit.report.tables.table import build_tables

    tables = build_tables(distinguish_definitions(in_planned_order(read_results(runs))), *(metrics or ()))
    write_atomically(output, json.dumps(expectation(tables), indent=2) + "\n")
    cells = sum(len(table.cells) for table in tables)
    out.print(f"wrote {output}: {cells} cells", soft_wrap=True, markup=False)
    return 0
