"""`meshfit table`: print result tables, or check them against expected values."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from meshfit.cli.console import err, out, print_error
from meshfit.cli.options import OUTPUT, Baseline, Labels, Metrics, Partial, takes_run_dirs
from meshfit.errors import ConfigError
from meshfit.experiment.storage.run_directory import Result
from meshfit.units import count_text

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.report.tables.style import Style
    from meshfit.report.tables.table import Table

_DEVIATES = _INCOMPLETE = 1


@takes_run_dirs
def table(
    runs: list[Path],
    format: Annotated[  # noqa: A002  the name of the option
        Literal["rich", "md", "csv", "latex", "json"],
        typer.Option(
            "--format",
            "-f",
            help="`rich` for a terminal, `md` or `latex` for documents, `csv` or `json` for programs.",
            metavar="FORMAT",
            rich_help_panel=OUTPUT,
        ),
    ] = "rich",
    metrics: Metrics = None,
    baseline: Baseline = None,
    cells: Annotated[
        Literal["mean", "mean-sd", "mean-ci", "full"],
        typer.Option(
            "--cells",
            help="`mean` alone, with standard deviation, with 95 % interval, or in `full`, with median and interval.",
            metavar="CELLS",
            rich_help_panel=OUTPUT,
        ),
    ] = "full",
    notes: Annotated[
        Literal["none", "short", "full"],
        typer.Option(
            "--notes",
            help="`none` for the table alone, `short` for its marks and exceptions, `full` with all comparisons.",
            metavar="NOTES",
            rich_help_panel=OUTPUT,
        ),
    ] = "full",
    digits: Annotated[
        int | None,
        typer.Option(
            "--digits",
            min=1,
            max=12,
            help="Significant digits of a mean.",
            show_default="as many as its spread supports",
            metavar="N",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    transpose: Annotated[
        bool, typer.Option("--transpose", help="Targets as rows, schemes as columns.", rich_help_panel=OUTPUT)
    ] = False,
    labels: Labels = None,
    partial: Partial = False,
    check: Annotated[
        Path | None,
        typer.Option("--check", help="Compare with expected values; exit 1 if any cell deviates.", metavar="FILE"),
    ] = None,
) -> int:
    """Print the result table of run directories.

    Schemes are rows, targets are columns. A cell is the mean (median) [95 % interval] over the seeds; differences
    between schemes follow. For a paper, choose what cells and notes contain, and how schemes and targets are named.

    Trials of the latest plan that have no result are named, each with the reason, and make the exit code 1.

    Examples:
        meshfit table runs/table1
        meshfit table runs/table1 --metric distance.mean --metric f_score.f1
        meshfit table runs/table1 --format latex > table1.tex
        meshfit table runs/table1 -f latex --cells mean-sd --notes short --label interp-loop="Interp. Loop"
        meshfit table runs/table1 --check configs/expected/table1.json
    """
    from meshfit.report.tables.read import read_records
    from meshfit.report.tables.style import Style

    results = read_records(runs)
    if check is not None:
        return _check(runs, results, check)
    style = Style(cells=cells, notes=notes, transpose=transpose, digits=digits)
    tables = show_tables(results, metrics, baseline=baseline, format_name=format, style=style, labels=labels or ())
    return 0 if partial else exit_code_of(tables)


def exit_code_of(tables: Sequence["Table"]) -> int:
    """Return the exit code of a command that shows tables, and report planned trials without a result."""
    from meshfit.report.tables.heads import trial_line

    for line in filter(None, map(trial_line, tables)):
        remedy = "`meshfit run` runs the others; --partial accepts the table without them"
        err.print(f"{line.partition(': ')[2]}; {remedy}", soft_wrap=True, markup=False)
    return _INCOMPLETE if any(table.num_missing for table in tables) else 0


def _check(runs: Sequence[Path], results: Sequence[Result], path: Path) -> int:
    from meshfit.report.tables.expected import check, read_expected
    from meshfit.report.tables.table import build_tables

    expected = read_expected(path)
    tables = build_tables(results, *(expected_table.metric for expected_table in expected.tables))
    deviations = check(tables, expected)
    for deviation in deviations:
        print_error(str(deviation))
    where = ", ".join(map(str, runs))
    if deviations:
        err.print(f"{where}: {count_text(len(deviations), 'deviation')} from {path}", soft_wrap=True, markup=False)
        return _DEVIATES
    cells = sum(len(expected_table.cells) for expected_table in expected.tables)
    out.print(f"{where}: all {cells} cells match {path}", soft_wrap=True, markup=False)
    return 0


def show_tables(
    results: Sequence[Result],
    metrics: Sequence[str] | None,
    *,
    baseline: str | None = None,
    format_name: str = "rich",
    style: "Style | None" = None,
    labels: Sequence[str] = (),
) -> list["Table"]:
    """Print the tables of results to stdout, and return them.

    Args:
        results: results, and records of missing ones, from `distinguish_definitions`, of `in_planned_order`.
        metrics: names of metrics; by default the Hausdorff distance.
        baseline: the scheme that others are compared with; by default the first.
        format_name: a name in `FORMATS`, or `rich` to print with colour.
        style: what is printed; by default everything.
        labels: names to print, each as NAME=LABEL.

    Raises:
        ConfigError: no such metric, or a baseline or a label of something that has no results.
    """
    from meshfit.report.tables.formats import FORMATS
    from meshfit.report.tables.formats.terminal import TablesView
    from meshfit.report.tables.style import Style
    from meshfit.report.tables.table import build_tables, merge_tables, styled

    merged = merge_tables(build_tables(results, *(metrics or ()), baseline=baseline))
    merged = styled(merged, style or Style(), labels)
    if format_name == "rich":
        out.print(TablesView(merged))
    else:
        typer.echo(FORMATS[format_name](merged), nl=False)
    return merged


def check_display(trials: Sequence["Trial"], metrics: Sequence[str] | None, baseline: str | None) -> None:
    """Refuse, before trials are run, a metric or baseline whose table could not be shown afterwards.

    Raises:
        ConfigError: no such metric, or a baseline that is not among the planned schemes.
        SchemeError: the baseline is not a scheme.
    """
    from meshfit.measuring.metrics import require_metric
    from meshfit.report.tables.grouping import distinguish_definitions, resolve_scheme
    from meshfit.specs import suggest

    for metric in metrics or ():
        require_metric(metric)
    if baseline is None:
        return
    results = distinguish_definitions([{"scheme": trial.scheme, "settings": trial.plain_settings} for trial in trials])
    planned, scheme = dict.fromkeys(result["scheme"] for result in results), resolve_scheme(results, baseline)
    if scheme not in planned:
        raise ConfigError(f"baseline '{baseline}' is not among the schemes: {suggest(scheme, planned)}")
