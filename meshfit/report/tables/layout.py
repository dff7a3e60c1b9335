"""A sheet laid out in cells of text, the same for every format that people read."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap

from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.comparisons import Row
from meshfit.report.tables.numbers import format_mean
from meshfit.report.tables.paper_numbers import value_beside
from meshfit.report.tables.sheet import Sheet

MISSING = "–"


@dataclass(frozen=True)
class Column:
    """A column: our figures of a metric on a target, or the paper's.

    Attributes:
        metric: dotted name of the metric.
        target: the target.
        heading: what stands above it: the target, and the metric where the sheet has several.
        below: what stands above it where the target's title stands above all its columns.
        paper: whether the figures are the paper's.
    """

    metric: str
    target: str
    heading: str
    below: str
    paper: bool = False


@dataclass(frozen=True)
class TextCell:
    """The text of one place in the table.

    Attributes:
        text: mean and median, or what there is in their place.
        interval: the interval of the mean; empty where there is none.
        best: whether it is the best of its column.
        alike: whether it does not differ significantly from what it is compared with.
    """

    text: str
    interval: str = ""
    best: bool = False
    alike: bool = False


def columns(sheet: Sheet) -> list[Column]:
    """The columns: each metric on each target, and the paper's numbers beside it where the paper has some."""
    found = []
    several = len(sheet.metrics) > 1
    for target, title in sheet.targets.items():
        for metric in sheet.metrics:
            name = METRICS[metric].title
            found.append(Column(metric, target, f"{title}: {name}" if several else title, name))
            if any(shown_paper_value(sheet, metric, target, row.scheme) is not None for row in sheet.rows):
                found.append(Column(metric, target, f"paper's {target}", "paper's", paper=True))
    return found


def entries(sheet: Sheet, column: Column) -> list[TextCell]:
    """What stands in a column, row by row."""
    if column.paper:
        values = [shown_paper_value(sheet, column.metric, column.target, row.scheme) for row in sheet.rows]
        return [TextCell("" if value is None else f"{value}") for value in values]
    place = (column.metric, column.target)
    alike = {
        contrast.row
        for contrast in sheet.contrasts
        if (contrast.metric, contrast.target) == place and contrast.paired.significant is False
    }
    return [_entry(sheet, column, row, alike=row in alike) for row in sheet.rows]


def row_names(sheet: Sheet) -> tuple[str, ...]:
    """What it takes to name a row: its scheme, its variation, or both where the sheet has several of both."""
    if len(sheet.variations) == 1:
        return ("scheme",)
    return ("variation",) if len(sheet.schemes) == 1 else ("variation", "scheme")


def row_labels(sheet: Sheet, row: Row) -> tuple[str, ...]:
    """The name of a row, in as many parts as `row_names` has."""
    parts = {"variation": sheet.variations[row.variation], "scheme": row.scheme}
    return tuple(parts[name] for name in row_names(sheet))


def row_groups(sheet: Sheet) -> list[tuple[str, list[tuple[int, str]]]]:
    """Places and labels of rows, below the variation that they share; below no heading where one label names them."""
    labels = [(place, row_labels(sheet, row)) for place, row in enumerate(sheet.rows)]
    found: dict[str, list[tuple[int, str]]] = {}
    for place, (*above, label) in labels:
        found.setdefault("".join(above), []).append((place, label))
    return list(found.items())


def shown_paper_value(sheet: Sheet, metric: str, target: str, scheme: str) -> float | None:
    """The paper's number that stands beside a cell; none where settings vary, since it would stand beside each."""
    return value_beside(metric, target, scheme) if len(sheet.variations) == 1 else None


def _entry(sheet: Sheet, column: Column, row: Row, *, alike: bool) -> TextCell:
    summary = sheet.summary(column.metric, column.target, row)
    if summary is None:
        return TextCell(MISSING)
    text, interval = format_mean(summary, whole=METRICS[column.metric].format in ("d", ""))
    return TextCell(text, interval, best=sheet.best.get((column.metric, column.target)) == row, alike=alike)


GAP = 2
"""Blanks between two columns."""
_LEAST_FOR_LABELS = 20


@dataclass(frozen=True)
class Label:
    """The first of a row: the scheme or variation that it is of, or the variation that rows below it are of.

    Attributes:
        lines: its text.
        place: of the row among the entries of a column; None for a heading of rows.
    """

    lines: tuple[str, ...]
    place: int | None


@dataclass(frozen=True)
class Labels:
    """The first column."""

    heading: str
    labels: tuple[Label, ...]
    width: int


@dataclass(frozen=True)
class Figures:
    """Another column.

    Attributes:
        column: what it is of.
        heading: what stands above it, in lines.
        entries: row by row.
        numbers: how wide its texts are.
        width: how wide the column is, with marks and heading.
    """

    column: Column
    heading: tuple[str, ...]
    entries: tuple[TextCell, ...]
    numbers: int
    width: int


@dataclass(frozen=True)
class Block:
    """Columns that fit side by side."""

    labels: Labels
    figures: tuple[Figures, ...]

    @property
    def width(self) -> int:
        """How wide it is."""
        return self.labels.width + sum(GAP + figures.width for figures in self.figures)


def blocks(sheet: Sheet, width: int, mark: int = GAP) -> Iterator[Block]:
    """Break a sheet into blocks.

    Args:
        sheet: what to lay out.
        width: characters that fit side by side.
        mark: those that the mark of a cell takes.
    """
    labels = _labels(sheet, max(_LEAST_FOR_LABELS, width // 3))
    shown: list[Figures] = []
    for more in _kept_together(sheet, labels, width, mark):
        if shown and Block(labels, (*shown, *more)).width > width:
            yield Block(labels, tuple(shown))
            shown = []
        shown += more
    yield Block(labels, tuple(shown))


def _kept_together(sheet: Sheet, labels: Labels, width: int, mark: int) -> Iterator[list[Figures]]:
    """The columns of a target, if they fit side by side; else those of each metric on it."""
    for _, group in groupby(columns(sheet), key=lambda column: column.target):
        found = [_figures(sheet, column, mark) for column in group]
        if Block(labels, tuple(found)).width <= width:
            yield found
        else:
            yield from (list(same) for _, same in groupby(found, key=lambda figures: figures.column.metric))


def _labels(sheet: Sheet, most: int) -> Labels:
    """The first column, its labels below the variation that they belong to."""
    found = []
    for heading, rows in row_groups(sheet):
        if heading:
            found.append(Label(tuple(wrap(heading, most)), None))
        indent = " " * GAP if heading else ""
        found += [
            Label(tuple(wrap(label, most, initial_indent=indent, subsequent_indent=indent)), place)
            for place, label in rows
        ]
    name = row_names(sheet)[-1]
    return Labels(name, tuple(found), max(len(name), *(len(line) for label in found for line in label.lines)))


def _figures(sheet: Sheet, column: Column, mark: int) -> Figures:
    found = entries(sheet, column)
    numbers = max(len(line) for entry in found for line in (entry.text, entry.interval))
    marked = numbers + mark * any(entry.best or entry.alike for entry in found)
    heading = _heading(sheet, column, marked)
    return Figures(column, tuple(heading), tuple(found), numbers, max(marked, *map(len, heading)))


def _heading(sheet: Sheet, column: Column, width: int) -> list[str]:
    """What stands above a column, broken where its cells end, or where a word of it does, if that is farther right."""
    parts = [sheet.targets[column.target], column.below] if len(sheet.metrics) > 1 else [column.heading]
    longest = max(len(word) for part in parts for word in part.split())
    return [line for part in parts for line in wrap(part, max(width, longest), break_on_hyphens=False)]
