"""The layout of a table as text: columns of cells, and blocks of columns that fit a width."""

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap

from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.grouping import Missing
from meshfit.report.tables.numbers import format_mean
from meshfit.report.tables.paper_numbers import published_value
from meshfit.report.tables.table import Row, Table

MISSING = "–"
NOT_SIGNIFICANT = "≈"
"""Mark of a cell without a significant difference."""
SHORTFALL = "†"
"""Mark of a cell with a result that lacks something of its target."""
FEWER = "‡"
"""Mark of a cell over fewer runs than planned, since others have no result."""
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
        short: whether a result lacks something of its target.
        fewer: whether planned runs of the cell have no result.
    """

    text: str
    interval: str = ""
    best: bool = False
    not_significant: bool = False
    short: bool = False
    fewer: bool = False

    def marks(self, best: str = "") -> str:
        """Return the marks of the cell, of which `best` is that of the best cell of a column."""
        first = best if self.best else NOT_SIGNIFICANT if self.not_significant else ""
        return first + (SHORTFALL if self.short else "") + (FEWER if self.fewer else "")


@dataclass(frozen=True)
class Column:
    """A column of text: our values of a metric on a target, or those of the paper.

    Attributes:
        metric: dotted name of the metric.
        place: the target, or the row of the table's model in a transposed table.
        heading: full heading.
        group: heading shared with neighbouring columns if there are several metrics, else empty.
        subheading: heading below that of the group.
        paper: whether the values are those of the paper.
        cells: from top to bottom.
    """

    metric: str
    place: str
    heading: str
    group: str
    subheading: str
    paper: bool
    cells: tuple[TextCell, ...]

    @property
    def marks_width(self) -> int:
        """Width of the marks of the cells, each one character, with a blank before them."""
        longest = max(len(cell.marks("*")) for cell in self.cells)
        return longest and 1 + longest

    def cell_width(self, *, marks: bool) -> int:
        """Return the width of the cells, with or without room for marks."""
        width = max(len(line) for cell in self.cells for line in (cell.text, cell.interval))
        return width + (self.marks_width if marks else 0)

    def heading_lines(self, *, marks: bool) -> list[str]:
        """Wrap the heading to the width of the cells, or of its longest word, if that is longer."""
        parts = list(filter(None, (self.group, self.subheading)))
        width = max(self.cell_width(marks=marks), *(len(word) for part in parts for word in part.split()))
        return [line for part in parts for line in wrap(part, width, break_on_hyphens=False)]

    def width(self, *, marks: bool) -> int:
        """Return the width of the column."""
        return max(self.cell_width(marks=marks), *map(len, self.heading_lines(marks=marks)))


_Places = Sequence[tuple[str, Row]]
"""Target and row of each cell of a column."""


def columns_of(table: Table) -> list[Column]:
    """Lay out each metric on each target, followed by the paper's numbers where there are any.

    In a transposed table, each metric of each row of the table's model is a column, and targets are rows.
    """
    not_significant = {
        (comparison.metric, comparison.target, comparison.row)
        for comparison in table.comparisons
        if comparison.difference.significant is False
    }
    across: list[tuple[str, _Places]]
    if table.style.transpose:
        across = [(" · ".join(row_titles(table, row)), [(each, row) for each in table.targets]) for row in table.rows]
    else:
        across = [(title, [(target, row) for row in table.rows]) for target, title in table.targets.items()]
    columns = []
    for title, places in across:
        for metric in table.metrics:
            cells = tuple(_cell(table, metric, target, row, not_significant) for target, row in places)
            columns.append(_column(table, title, metric, places, cells))
            paper = [_published(table, metric, *place) for place in places]
            if any(paper):
                columns.append(_paper_column(table, title, metric, places, tuple(map(TextCell, paper))))
    return columns


def _column(table: Table, title: str, metric: str, places: _Places, cells: tuple[TextCell, ...]) -> Column:
    name = table.metric_title(metric)
    several = len(table.metrics) > 1
    heading, group, subheading = (f"{title}: {name}", title, name) if several else (title, "", title)
    return Column(metric, _key(table, places), heading, group, subheading, paper=False, cells=cells)


def _paper_column(table: Table, title: str, metric: str, places: _Places, cells: tuple[TextCell, ...]) -> Column:
    several = len(table.metrics) > 1
    heading = f"paper's {title if table.style.transpose else places[0][0]}"
    subheading = "paper's" if several else heading
    return Column(metric, _key(table, places), heading, title if several else "", subheading, paper=True, cells=cells)


def _key(table: Table, places: _Places) -> str:
    target, row = places[0]
    return f"{row.variation} {row.scheme}" if table.style.transpose else target


def _published(table: Table, metric: str, target: str, row: Row) -> str:
    """The paper's number for a cell; none in styles without it, or where several variations would repeat it."""
    if len(table.variations) > 1 or table.style.cells != "full":
        return ""
    value = published_value(metric, target, row.scheme)
    return "" if value is None else f"{value}"


def _cell(table: Table, metric: str, target: str, row: Row, not_significant: Container[object]) -> TextCell:
    place = metric, target, row
    missing = table.missing(target, row)
    if place not in table.cells:
        return TextCell(_state(missing) if missing else MISSING)
    style, whole = table.style, METRICS[metric].whole
    text, interval = format_mean(table.cells[place], whole=whole, cells=style.cells, digits=style.digits)
    best = table.best.get((metric, target)) == row
    explained = style.notes != "none"  # without notes, nothing would explain the marks
    not_best = explained and place in not_significant
    short = explained and bool(table.shortfalls(target, row))
    return TextCell(text, interval, best=best, not_significant=not_best, short=short, fewer=explained and bool(missing))


def _state(missing: Mapping[int, Missing]) -> str:
    """Return the state of the trials of a cell, of which none is complete."""
    states = {each.state for each in missing.values()}
    return states.pop() if len(states) == 1 else "none complete"


def row_names(table: Table) -> tuple[str, ...]:
    """Return what names a line: its scheme, its variation, or both where the table has several of both; or target."""
    if table.style.transpose:
        return ("target",)
    return _parts(table)


def _parts(table: Table) -> tuple[str, ...]:
    if len(table.variations) == 1:
        return ("scheme",)
    return ("variation",) if len(table.schemes) == 1 else ("variation", "scheme")


def row_titles(table: Table, row: Row) -> tuple[str, ...]:
    """Return the printed name of a row, in one part or two."""
    parts = {"variation": table.variation_title(row), "scheme": table.scheme_title(row.scheme)}
    return tuple(parts[name] for name in _parts(table))


def row_labels(table: Table) -> list[tuple[str, ...]]:
    """Return the name of each line, in as many parts as `row_names` has."""
    if table.style.transpose:
        return [(title,) for title in table.targets.values()]
    return [row_titles(table, row) for row in table.rows]


def row_groups(table: Table) -> list[tuple[str, list[tuple[int, str]]]]:
    """Group lines by their variation: its name, and the index and label of each line.

    The name is empty where one label is enough for a line.
    """
    groups: dict[str, list[tuple[int, str]]] = {}
    for index, (*above, label) in enumerate(row_labels(table)):
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
        marks: whether the marks of cells take room.
    """

    heading: str
    labels: tuple[Label, ...]
    columns: tuple[Column, ...]
    marks: bool

    @property
    def label_width(self) -> int:
        """Width of the labels."""
        return max(len(self.heading), *(len(line) for label in self.labels for line in label.lines))

    @property
    def width(self) -> int:
        """Width of the block."""
        return self.label_width + sum(GAP + column.width(marks=self.marks) for column in self.columns)


def blocks_of(table: Table, width: int, *, marks: bool = True) -> Iterator[Block]:
    """Break a table into blocks; the columns of a target, or at least of a metric on it, stay together.

    Args:
        table: the table to lay out.
        width: characters that fit side by side.
        marks: whether the marks of cells take room.
    """
    heading, labels = row_names(table)[-1], tuple(_labels(table, max(_LEAST_FOR_LABELS, width // 3)))

    def block(columns: list[Column]) -> Block:
        return Block(heading, labels, tuple(columns), marks)

    together: list[list[Column]] = []
    for _, on_target in groupby(columns_of(table), key=lambda column: column.place):
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
