"""`meshfit table`: the table again, from the result files alone."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli.console import err, out, say_error
from meshfit.cli.options import SHOWN, Baseline, Metrics, RunDirs

DEVIATES = 1


class Format(StrEnum):
    """How a table is written."""

    RICH = "rich"
    MD = "md"
    CSV = "csv"
    LATEX = "latex"
    JSON = "json"


def table(
    runs: RunDirs,
    format: Annotated[  # noqa: A002
        Format,
        typer.Option(
            "--format",
            "-f",
            help="`rich`, for a terminal; `md` or `latex`, with the notes in full; `csv` or `json`.",
            metavar="FORMAT",
            rich_help_panel=SHOWN,
        ),
    ] = Format.RICH,
    metrics: Metrics = None,
    baseline: Baseline = None,
    check: Annotated[
        Path | None,
        typer.Option("--check", help="Compare with an expected file; exit 1 where it deviates.", metavar="FILE"),
    ] = None,
) -> int:
    """Print the table of some runs, from their files alone.

    Schemes by targets; each cell is the mean (median) [95 % interval] over the seeds, differences follow.

    Examples:
        meshfit table runs/table1

        meshfit table runs/table1 --metric distance.mean --metric f_score.f1

        meshfit table runs/table1 --format latex > table1.tex

        meshfit table runs/table1 --check configs/expected/table1.json
    """
    from meshfit.cli.tables import show_tables
    from meshfit.experiment.plan_file import with_planned_names
    from meshfit.experiment.store import read_results
    from meshfit.report.own_schemes import told_apart

    results = told_apart(with_planned_names(read_results(runs)))
    if check is not None:
        return _check(runs, results, check)
    show_tables(results, metrics, baseline=baseline, format_name=format.value)
    return 0


def _check(runs: list[Path], results: list[dict[str, object]], path: Path) -> int:
    from meshfit.report.expected import check
    from meshfit.report.expected_file import read_expected
    from meshfit.report.table import build_tables

    expected = read_expected(path)
    metrics = dict.fromkeys(wanted.metric for wanted in expected.tables)
    deviations = check([table for metric in metrics for table in build_tables(results, metric)], expected)
    for deviation in deviations:
        say_error(str(deviation))
    cells = sum(len(wanted.cells) for wanted in expected.tables)
    where = ", ".join(map(str, runs))
    if deviations:
        err.print(f"{where}: {len(deviations)} deviations from {path}", soft_wrap=True, markup=False)
        return DEVIATES
    out.print(f"{where}: all {cells} cells are as {path} expects", soft_wrap=True, markup=False)
    return 0
