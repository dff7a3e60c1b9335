"""The layout of a table as text: columns of cells, and blocks of columns that fit a width."""

from collections.abc import Container, Iterator
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap

from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.numbers import format_mean
from meshfit.report.tables.paper_numbers import published_value
from meshfit.report.tables.table import Row, Table

MISSING = "–"
GAP = 2
"""Blanks between two columns."""
_LEAST_FOR_LABELS = 20


@dataclass(frozen=True)
class TextCell:
    """The text of a cell.

    Attributes:
        text: mean and median.
        interval: confidence interval of the mean; empty if there is none.
        best: whether the row is the best of its column.
        not_significant: whether a comparison of the row in this column is not significant.
    """

    text: str
    interval: str = ""
    best: bool = False
    not_significant: bool = False


@dataclass(frozen=True)
class Column:
    """A column of text: our values of a metric on a target, or those of the paper.

    Attributes:
        metric: dotted name of the metric.
        target: the target.
        heading: full heading.
        group: heading shared with neighbouring columns: the target's title if there are several metrics, else empty.
        subheading: heading below that of the group.
        paper: whether the values are those of the paper.
        cells: from top to bottom.
    """

    metric: str
    target: str
    heading: str
    group: str
    subheading: str
    paper: bool
    cells: tuple[TextCell, ...]

    def cell_width(self, mark: int) -> int:
        """Return the width of the cells, in which a mark takes so many characters."""
        marked = any(cell.best or cell.not_significant for cell in self.cells)
        return max(len(line) for cell in self.cells for line in (cell.text, cell.interval)) + mark * marked

    def heading_lines(self, mark: int) -> list[str]:
        """Wrap the heading to the width of the cells, or of its longest word, if that is longer."""
        parts = list(filter(None, (self.group, self.subheading)))
        width = max(self.cell_width(mark), *(len(word) for part in parts for word in part.split()))
        return [line for part in parts for line in wrap(part, width, break_on_hyphens=False)]

    def width(self, mark: int) -> int:
        """Return the width of the column."""
        return max(self.cell_width(mark), *map(len, self.heading_lines(mark)))


def columns_of(table: Table) -> list[Column]:
    """Lay out each metric on each target, followed by the paper's numbers where there are any."""
    several = len(table.metrics) > 1
    # With several variations, each of the paper's numbers would be repeated.
    with_paper = len(table.variations) == 1
    not_significant = {
        (comparison.metric, comparison.target, comparison.row)
        for comparison in table.comparisons
        if comparison.difference.significant is False
    }
    columns = []
    for target, title in table.targets.items():
        group = title if several else ""
        for metric in table.metrics:
            name = METRICS[metric].title
            heading, subheading = (f"{title}: {name}", name) if several else (title, title)
            cells = tuple(_cell(table, metric, target, row, not_significant) for row in table.rows)
            columns.append(Column(metric, target, heading, group, subheading, paper=False, cells=cells))
            paper = [published_value(metric, target, row.scheme) if with_paper else None for row in table.rows]
            if any(value is not None for value in paper):
                cells = tuple(TextCell("" if value is None else f"{value}") for value in paper)
                heading = f"paper's {target}"
                subheading = "paper's" if several else heading
                columns.append(Column(metric, target, heading, group, subheading, paper=True, cells=cells))
    return columns


def _cell(table: Table, metric: str, target: str, row: Row, not_significant: Container[object]) -> TextCell:
    place = metric, target, row
    if place not in table.cells:
        return TextCell(MISSING)
    text, interval = format_mean(table.cells[place], whole=METRICS[metric].whole)
    best = table.best.get((metric, target)) == row
    return TextCell(text, interval, best=best, not_significant=place in not_significant)


def row_names(table: Table) -> tuple[str, ...]:
    """Return what names a row: its scheme, its variation, or both where the table has several of both."""
    if len(table.variations) == 1:
        return ("scheme",)
    return ("variation",) if len(table.schemes) == 1 else ("variation", "scheme")


def row_labels(table: Table, row: Row) -> tuple[str, ...]:
    """Return the name of a row, in as many parts as `row_names` has."""
    parts = {"variation": table.variations[row.variation].name, "scheme": row.scheme}
    return tuple(parts[name] for name in row_names(table))


def row_groups(table: Table) -> list[tuple[str, list[tuple[int, str]]]]:
    """Group rows by their variation: its name, and the index and label of each row.

    The name is empty where one label is enough for a row.
    """
    groups: dict[str, list[tuple[int, str]]] = {}
    for index, row in enumerate(table.rows):
        *above, label = row_labels(table, row)
        groups.setdefault("".join(above), []).append((index, label))
    return list(groups.items())


@dataclass(frozen=True)
class Label:
    """The label of a row, or the name of the variation of the rows below.

    Attributes:
        lines: its text.
        row: index of the row; None for the name of a variation.
    """

    lines: tuple[str, ...]
    row: int | None


@dataclass(frozen=True)
class Block:
    """Columns that fit side by side, with the labels of their rows.

    Attributes:
        heading: heading of the labels.
        labels: from top to bottom.
        columns: from left to right.
        mark: width of the mark of a cell.
    """

    heading: str
    labels: tuple[Label, ...]
    columns: tuple[Column, ...]
    mark: int

    @property
    def label_width(self) -> int:
        """Width of the labels."""
        return max(len(self.heading), *(len(line) for label in self.labels for line in label.lines))

    @property
    def width(self) -> int:
        """Width of the block."""
        return self.label_width + sum(GAP + column.width(self.mark) for column in self.columns)


def blocks_of(table: Table, width: int, mark: int = GAP) -> Iterator[Block]:
    """Break a table into blocks; the columns of a target, or at least of a metric on it, stay together.

    Args:
        table: the table to lay out.
        width: characters that fit side by side.
        mark: width of the mark of a cell.
    """
    heading, labels = row_names(table)[-1], tuple(_labels(table, max(_LEAST_FOR_LABELS, width // 3)))

    def block(columns: list[Column]) -> Block:
        return Block(heading, labels, tuple(columns), mark)

    together: list[list[Column]] = []
    for _, on_target in groupby(columns_of(table), key=lambda column: column.target):
        columns = list(on_target)
        if block(columns).width <= width:
            together.append(columns)
        else:
            together += [list(of_metric) for _, of_metric in groupby(columns, key=lambda column: column.metric)]
    shown: list[Column] = []
    for columns in together:
        if shown and block(shown + columns).width > width:
            yield block(shown)
            shown = []
        shown = shown + columns
    yield block(shown)


def _labels(table: Table, width: int) -> Iterator[Label]:
    for name, rows in row_groups(table):
        if name:
            yield Label(tuple(wrap(name, width)), None)
        indent = " " * GAP if name else ""
        for index, label in rows:
            yield Label(tuple(wrap(label, width, initial_indent=indent, subsequent_indent=indent)), index)
