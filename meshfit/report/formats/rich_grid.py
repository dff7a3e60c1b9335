"""The cells of a sheet for a terminal, in blocks of as many columns as fit side by side."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap

from rich.text import Text

from meshfit.report.grid import Column, Entry, columns, entries, row_groups, row_names
from meshfit.report.sheet import Sheet

BEST, ALIKE = "*", "≈"
_GAP = "  "
_LEAST_FOR_LABELS = 20

Styled = tuple[str, str]
"""Text and its style."""


@dataclass(frozen=True)
class _Drawn:
    """A column of text: its heading, and the lines of each of its cells, all of the same width."""

    width: int
    heading: list[Styled]
    cells: list[list[Styled]]


def grid_view(sheet: Sheet, width: int) -> Iterator[Text]:
    """The lines to print, in so many columns; below each block an empty one."""
    labels = _labels(sheet, max(_LEAST_FOR_LABELS, width // 3))
    # A heading of rows has no cells beside it.
    places = [place for heading, rows in row_groups(sheet) for place in [None] * bool(heading) + [at for at, _ in rows]]
    shown: list[_Drawn] = []
    for _, group in groupby(columns(sheet), key=lambda column: (column.target, column.metric)):
        more = [_drawn(sheet, column, places) for column in group]
        if shown and labels.width + sum(len(_GAP) + column.width for column in [*shown, *more]) > width:
            yield from _block([labels, *shown])
            shown = []
        shown += more
    yield from _block([labels, *shown])


def _block(parts: Sequence[_Drawn]) -> Iterator[Text]:
    height = max(len(column.heading) for column in parts)
    blank = [[("", "")] * (height - len(column.heading)) for column in parts]
    yield from _lines(parts, [[*above, *column.heading] for above, column in zip(blank, parts, strict=True)])
    yield Text("─" * (sum(len(_GAP) + column.width for column in parts) - len(_GAP)))
    for row in zip(*(column.cells for column in parts), strict=True):
        yield from _lines(parts, row)
    yield Text()


def _lines(parts: Sequence[_Drawn], cells: Sequence[Sequence[Styled]]) -> Iterator[Text]:
    """A row: as many lines as its tallest cell has."""
    for place in range(max(map(len, cells))):
        line = [cell[place] if place < len(cell) else ("", "") for cell in cells]
        padded = [(text.ljust(column.width), style) for (text, style), column in zip(line, parts, strict=True)]
        text = Text(_GAP).join(Text(text, style) for text, style in padded)
        text.rstrip()
        yield text


def _labels(sheet: Sheet, most: int) -> _Drawn:
    """The first column, its labels below the variation that they belong to."""
    cells: list[list[Styled]] = []
    for heading, rows in row_groups(sheet):
        if heading:
            cells.append([(line, "bold") for line in wrap(heading, most)])
        indent = _GAP if heading else ""
        cells += [
            [(line, "") for line in wrap(label, most, initial_indent=indent, subsequent_indent=indent)]
            for _, label in rows
        ]
    name = row_names(sheet)[-1]
    return _Drawn(max(len(name), *(len(line) for cell in cells for line, _ in cell)), [(name, "bold")], cells)


def _drawn(sheet: Sheet, column: Column, places: Sequence[int | None]) -> _Drawn:
    found = entries(sheet, column)
    numbers = max(len(line) for entry in found for line in (entry.text, entry.interval))
    marks = len(_GAP) if any(entry.best or entry.alike for entry in found) else 0
    heading = _heading(sheet, column, numbers + marks)
    width = max(numbers + marks, *map(len, heading))
    style = "italic" if column.paper else ""
    cells = [[] if place is None else _cell(found[place], width - marks, style) for place in places]
    return _Drawn(width, [(line.rjust(width), "bold") for line in heading], cells)


def _heading(sheet: Sheet, column: Column, width: int) -> list[str]:
    """What stands above a column, broken where its cells end, or where a word of it does, if that is farther right."""
    parts = [sheet.targets[column.target], column.below] if len(sheet.metrics) > 1 else [column.heading]
    longest = max(len(word) for part in parts for word in part.split())
    return [line for part in parts for line in wrap(part, max(width, longest), break_on_hyphens=False)]


def _cell(entry: Entry, width: int, style: str) -> list[Styled]:
    mark = f" {BEST}" if entry.best else f" {ALIKE}" if entry.alike else ""
    first = (entry.text.rjust(width) + mark, "bold green" if entry.best else style)
    return [first, (entry.interval.rjust(width), "green" if entry.best else "")] if entry.interval else [first]
