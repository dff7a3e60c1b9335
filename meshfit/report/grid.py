"""A result table laid out in cells of text, the same for every format that people read."""

from dataclasses import dataclass

from meshfit.measuring.metrics import METRICS
from meshfit.report.numbers import mean_and_spread
from meshfit.report.paper import PAPER_METRIC, paper_value
from meshfit.report.table import ResultTable

MISSING = "–"


@dataclass(frozen=True)
class Column:
    """A column: our figures for a target, or the paper's."""

    target: str
    heading: str
    paper: bool = False


@dataclass(frozen=True)
class Entry:
    """The text of one place in the table, and whether it is the best of its column."""

    text: str
    best: bool = False


def columns(table: ResultTable) -> list[Column]:
    """The columns: each target, and the paper's numbers beside it where the paper has some."""
    found = []
    for target, title in table.targets.items():
        found.append(Column(target, title))
        if any(shown_paper_value(table, target, scheme) is not None for scheme in table.schemes):
            found.append(Column(target, f"paper's {target}", paper=True))
    return found


def entry(table: ResultTable, scheme: str, column: Column) -> Entry:
    """What stands in a row and a column."""
    if column.paper:
        value = shown_paper_value(table, column.target, scheme)
        return Entry("" if value is None else f"{value}")
    summary = table.cells.get((column.target, scheme))
    if summary is None:
        return Entry(MISSING)
    text = mean_and_spread(summary, whole=METRICS[table.metric].format in ("d", ""))
    return Entry(text, best=table.best.get(column.target) == scheme)


def shown_paper_value(table: ResultTable, target: str, scheme: str) -> float | None:
    """The paper's number, where it has one and the table is of the metric that it may stand beside."""
    return paper_value(target, scheme) if table.metric == PAPER_METRIC else None
