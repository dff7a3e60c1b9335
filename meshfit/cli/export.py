"""`meshfit export`: export trials as records, for pandas and other programs."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli.console import out
from meshfit.cli.options import takes_run_dirs
from meshfit.errors import StoreError
from meshfit.units import count_text


@takes_run_dirs
def export(
    runs: list[Path],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The file to write: .csv or .parquet.", metavar="FILE")
    ],
) -> int:
    """Export one row per trial with all metrics and settings.

    Completed and failed trials are included; others are counted. Columns are named as in configs and tables:
    fit.losses.edge, hausdorff.symmetric; lists are JSON. Parquet requires the extra: pip install 'meshfit[parquet]'.

    Examples:
        meshfit export runs/table1 -o results.csv
        meshfit export runs -o results.parquet
    """
    from meshfit.experiment.status.missing import count_unfinished
    from meshfit.experiment.status.results import scan_with_results
    from meshfit.report.tables.export import columns_of, encoder, records_of, write_records

    encoder(output)  # refuse an unknown format before reading
    experiments, results = scan_with_results(runs, datetime.now(UTC))
    records = records_of(experiments, results)
    if not records:
        raise StoreError(f"no trial under {', '.join(map(str, runs))} is complete or failed")
    columns = columns_of(records)
    write_records(records, columns, output)
    trials = count_text(len(records), "trial")
    out.print(f"wrote {output}: {trials}, {len(columns)} columns", soft_wrap=True, markup=False)
    if others := count_unfinished(experiments):
        left_out = ", ".join(f"{count} {state}" for state, count in others.items())
        out.print(f"left out, without a result: {left_out}", markup=False)
    return 0
