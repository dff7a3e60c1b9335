"""Result tables of run directories in Python: as text, as HTML in a notebook, and for pandas."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from typing import Any

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError
from meshfit.experiment.status.missing import missing_results
from meshfit.experiment.status.results import scan_with_results
from meshfit.experiment.storage.plan_file import in_planned_order
from meshfit.experiment.storage.result import read_results
from meshfit.experiment.storage.run_directory import Result
from meshfit.optional import import_pandas
from meshfit.printable import described, printable_html
from meshfit.report.tables.formats.data import to_csv
from meshfit.report.tables.formats.terminal import to_text
from meshfit.report.tables.grouping import distinguish_definitions
from meshfit.report.tables.layout import Column, columns_of, row_labels, row_names
from meshfit.report.tables.table import Table, build_tables, merge_tables


@dataclass(frozen=True)
class ResultTables:
    """The result tables of some runs, as `meshfit table` prints them: schemes are rows, and targets columns.

    Attributes:
        tables: one for each experiment whose results cannot share a table.

    Example:
        >>> import meshfit
        >>> nothing = meshfit.ResultTables(tables=())
        >>> len(nothing.tables)
        0
    """

    tables: tuple[Table, ...]

    def __repr__(self) -> str:
        """Return the tables as text."""
        return to_text(self.tables).rstrip()

    def _repr_html_(self) -> str:
        """Return the tables as HTML, for notebooks; the best of each column is bold."""
        return "".join(_html(table) for table in self.tables)

    def to_csv(self) -> str:
        """Return one line per cell as CSV."""
        return to_csv(self.tables)

    def to_pandas(self) -> Any:  # noqa: ANN401  pandas is optional
        """Return a pandas DataFrame of one row per cell, with means, intervals and comparisons.

        Raises:
            ConfigError: pandas is not installed.
        """
        return import_pandas().read_csv(StringIO(self.to_csv()))


@no_type_check
def read_tables(
    *runs: str | os.PathLike[str], metrics: Sequence[str] = (), baseline: str | None = None
) -> ResultTables:
    """Read the result tables of run directories.

    Args:
        *runs: run directories, such as `runs/table1`.
        metrics: dotted names of metrics, or a single one; by default the Hausdorff distance.
        baseline: the scheme that others are compared with; by default the first.

    Example:
        >>> import meshfit
        >>> try:
        ...     meshfit.read_tables("runs/table1", metrics=["distance.mean"])
        ... except meshfit.MeshfitError as error:
        ...     print("run `meshfit run table1` first")
        run `meshfit run table1` first

    Raises:
        ConfigError: no such metric, or a baseline that has no results.
        StoreError: a run directory that does not exist or holds no results.
    """
    for run in runs:
        if not isinstance(run, str | os.PathLike):
            raise ConfigError(f"runs: expected the paths of run directories, got {described(run)}")
    metrics = [metrics] if isinstance(metrics, str) else metrics
    if not isinstance(metrics, list | tuple) or not all(isinstance(metric, str) for metric in metrics):
        raise ConfigError(f"metrics: expected a list of names, such as ['distance.mean'], got {described(metrics)}")
    if baseline is not None and not isinstance(baseline, str):
        raise ConfigError(f"baseline: expected the name of a scheme, got {described(baseline)}")
    records = read_records([Path(run) for run in runs])
    return ResultTables(tuple(merge_tables(build_tables(records, *metrics, baseline=baseline))))


def read_records(roots: Sequence[Path]) -> list[Result]:
    """Read every result under some run directories, and which of their planned trials are missing, in planned order.

    Raises:
        StoreError: no such directory, or neither a complete nor a planned trial in any of them.
    """
    experiments, results = scan_with_results(roots, datetime.now(UTC), required=False)
    missing = missing_results(experiments, results)
    if not results and not missing:
        read_results(roots)  # says what is wrong
    return distinguish_definitions(in_planned_order([*results, *missing]))


def _html(table: Table) -> str:
    columns, names = columns_of(table), row_names(table)
    head = "".join(f"<th>{printable_html(text)}</th>" for text in (*names, *(column.heading for column in columns)))
    lines = "".join(
        f"<tr>{''.join(_cells(columns, labels, index))}</tr>" for index, labels in enumerate(row_labels(table))
    )
    metrics = printable_html(", ".join(table.metric_title(metric) for metric in table.metrics))
    caption = f"<caption>{printable_html(table.title)}: {metrics}</caption>"
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>"


def _cells(columns: Sequence[Column], labels: Sequence[str], index: int) -> Iterator[str]:
    yield from (f"<th>{printable_html(label)}</th>" for label in labels)
    for column in columns:
        cell = column.cells[index]
        text = printable_html(" ".join(filter(None, (cell.text, cell.interval))))
        yield f"<td>{f'<b>{text}</b>' if cell.best else text}</td>"
