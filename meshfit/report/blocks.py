"""A sheet in blocks of as many columns as fit side by side, each cell in lines of text, for any format."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap

from meshfit.report.grid import Column, Entry, columns, entries, row_groups, row_names
from meshfit.report.sheet import Sheet

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
    entries: tuple[Entry, ...]
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
