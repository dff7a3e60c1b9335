"""Tables on stdout, and what can be refused of them before anything is run."""

import json
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import err, out, print_error
from meshfit.cli.options import DEFAULT_METRIC, OUTPUT, Baseline, Metrics, RunDirs
from meshfit.errors import ConfigError
from meshfit.experiment.storage.run_directory import Result

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial


def show_tables(
    results: Sequence[Result],
    metrics: Sequence[str] | None,
    *,
    baseline: str | None = None,
    format_name: str = "rich",
    planned: bool = False,
) -> None:
    """Print the tables of some results to stdout."""
    from meshfit.report.tables.formats import FORMATS
    from meshfit.report.tables.formats.terminal import SheetsView
    from meshfit.report.tables.grouping import target_key
    from meshfit.report.tables.sheet import arrange
    from meshfit.report.tables.table import build_tables

    # The config's order, which is the order that trials were planned in.
    schemes = dict.fromkeys(result["scheme"] for result in results) if planned else ()
    targets = dict.fromkeys(map(target_key, results)) if planned else ()
    order = {"schemes": list(schemes), "targets": list(targets)}
    wanted = dict.fromkeys(metrics or [DEFAULT_METRIC])
    tables = [table for metric in wanted for table in build_tables(results, metric, baseline=baseline, **order)]
    sheets = arrange(tables, planned=planned)
    if format_name == "rich":
        out.print(SheetsView(sheets))
    else:
        typer.echo(FORMATS[format_name](sheets), nl=False)


def check_display(trials: Sequence["Trial"], metrics: Sequence[str] | None, baseline: str | None) -> None:
    """Refuse, before anything is run, what could not be shown once it has been.

    Raises:
        ConfigError: no such metric, or a baseline that is not among the planned schemes.
        SchemeError: the baseline is not a scheme.
    """
    from meshfit.report.tables.grouping import distinguish_definitions, resolve_scheme
    from meshfit.report.tables.table import require_metric
    from meshfit.specs import suggest

    for metric in metrics or ():
        require_metric(metric)
    if baseline is None:
        return
    results = distinguish_definitions([{"scheme": trial.scheme, "settings": trial.plain_settings} for trial in trials])
    planned, wanted = dict.fromkeys(result["scheme"] for result in results), resolve_scheme(results, baseline)
    if wanted not in planned:
        raise ConfigError(f"baseline '{baseline}' is not among the schemes: {suggest(wanted, planned)}")


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
            rich_help_panel=OUTPUT,
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
    from meshfit.experiment.storage.plan_file import with_planned_names
    from meshfit.experiment.storage.result import read_results
    from meshfit.report.tables.grouping import distinguish_definitions

    results = distinguish_definitions(with_planned_names(read_results(runs)))
    if check is not None:
        return _check(runs, results, check)
    show_tables(results, metrics, baseline=baseline, format_name=format.value)
    return 0


def _check(runs: list[Path], results: list[dict[str, object]], path: Path) -> int:
    from meshfit.report.tables.expected import check, read_expected
    from meshfit.report.tables.table import build_tables

    expected = read_expected(path)
    metrics = dict.fromkeys(wanted.metric for wanted in expected.tables)
    deviations = check([table for metric in metrics for table in build_tables(results, metric)], expected)
    for deviation in deviations:
        print_error(str(deviation))
    cells = sum(len(wanted.cells) for wanted in expected.tables)
    where = ", ".join(map(str, runs))
    if deviations:
        err.print(f"{where}: {len(deviations)} deviations from {path}", soft_wrap=True, markup=False)
        return DEVIATES
    out.print(f"{where}: all {cells} cells are as {path} expects", soft_wrap=True, markup=False)
    return 0


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
    from meshfit.experiment.storage.result import read_results
    from meshfit.experiment.storage.run_directory import write_atomically
    from meshfit.report.tables.expected import expectation
    from meshfit.report.tables.grouping import distinguish_definitions
    from meshfit.report.tables.table import build_tables

    results = distinguish_definitions(read_results(runs))
    tables = [table for metric in metrics or [DEFAULT_METRIC] for table in build_tables(results, metric)]
    write_atomically(output, json.dumps(expectation(tables), indent=2) + "\n")
    cells = sum(len(table.cells) for table in tables)
    out.print(f"wrote {output}: {cells} cells", soft_wrap=True, markup=False)
    return 0
