"""`meshfit export`: a row for each trial, for pandas and its like."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli.console import out
from meshfit.cli.options import RunDirs
from meshfit.errors import StoreError


def export(
    runs: RunDirs,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The file to write: .csv or .parquet.", metavar="FILE")
    ],
) -> int:
    """Write a row a trial, with every metric and every setting.

    Trials that are complete or failed have one. Columns are called as in configs and tables: fit.losses.edge,
    hausdorff.symmetric; lists are JSON. Parquet needs the extra: pip install 'meshfit[parquet]'.

    Examples:
        meshfit export runs/table1 -o results.csv

        meshfit export runs -o results.parquet
    """
    from meshfit.experiment.status.scan import scan_experiments
    from meshfit.report.tables.export import columns_of, encoder, rows_of, write_rows
    from meshfit.units import count_text

    encoder(output)  # now, and not when all has been read
    rows = rows_of(scan_experiments(runs, datetime.now(UTC)))
    if not rows:
        raise StoreError(f"no trial under {', '.join(map(str, runs))} is complete or failed")
    columns = columns_of(rows)
    write_rows(rows, columns, output)
    out.print(f"wrote {output}: {count_text(len(rows), 'trial')}, {len(columns)} columns", soft_wrap=True, markup=False)
    return 0
