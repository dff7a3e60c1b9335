"""Tables for a terminal: blocks of columns, then the comparisons and notes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from meshfit.report.tables.comparison_text import (
    ComparisonText,
    Section,
    comparison_lines,
    sections_of,
    without_intervals,
)
from meshfit.report.tables.heads import head_lines, setting_lines
from meshfit.report.tables.layout import GAP, Block, Column, blocks_of
from meshfit.report.tables.notes import legend, notes
from meshfit.report.tables.table import Table

_BEST = "*"
_GAP = " " * GAP


def to_text(tables: Sequence[Table], width: int = 80) -> str:
    """Write tables as plain text, without colour."""
    file = StringIO()
    Console(file=file, width=width, color_system=None, force_terminal=False).print(TablesView(tables))
    return "\n".join(line.rstrip() for line in file.getvalue().splitlines()) + "\n"


@dataclass(frozen=True)
class TablesView:
    """Tables for `Console.print`, each with its head, comparisons and notes.

    A table that is wider than the console is broken into blocks of as many columns as fit side by side.
    """

    tables: Sequence[Table]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        """Yield the parts in the order in which they are printed."""
        for place, table in enumerate(self.tables):
            if place:
                yield Text()
            yield Text(table.title, "bold")
            yield from map(Text, [*head_lines(table), *setting_lines(table), ""])
            for block in blocks_of(table, options.max_width):
                yield from _block(block)
                yield Text()
            if without_intervals(table) and (lines := comparison_lines(table)):
                yield from map(Text, [*lines, ""])
            else:
                for section in sections_of(table):
                    yield from _section(section, options.max_width)
                    yield Text()
            if (grid := _notes(table)).row_count:
                yield grid


# Blocks of columns.

_Styled = tuple[str, str]
"""Text and its style."""


def _block(block: Block) -> Iterator[Text]:
    headings = [column.heading_lines(marks=True) for column in block.columns]
    widths = [block.label_width, *(column.width(marks=True) for column in block.columns)]
    height = max(map(len, headings))
    cells = [[("", "")] * (height - 1) + [(block.heading, "bold")]]
    for lines, width in zip(headings, widths[1:], strict=True):
        cells.append([(line.rjust(width), "bold") for line in [*[""] * (height - len(lines)), *lines]])
    yield from _lines(cells, widths)
    yield Text("─" * block.width)
    rooms = [width - column.marks_width for column, width in zip(block.columns, widths[1:], strict=True)]
    for label in block.labels:
        row = label.row
        first = [(line, "bold" if row is None else "") for line in label.lines]
        cells = [first]
        if row is not None:
            cells += [_cell(column, row, room) for column, room in zip(block.columns, rooms, strict=True)]
        yield from _lines(cells, widths)


def _lines(cells: Sequence[Sequence[_Styled]], widths: Sequence[int]) -> Iterator[Text]:
    """Yield the lines of a row, as many as its tallest cell has."""
    for place in range(max(map(len, cells))):
        line = [cell[place] if place < len(cell) else ("", "") for cell in cells]
        padded = [(text.ljust(width), style) for (text, style), width in zip(line, widths, strict=False)]
        if any(style for _, style in padded):
            text = Text(_GAP).join(Text(*part) for part in padded)
            text.rstrip()
            yield text
        else:
            yield Text(_GAP.join(text for text, _ in padded).rstrip())


def _cell(column: Column, row: int, room: int) -> list[_Styled]:
    cell = column.cells[row]
    style, below = ("bold green", "green") if cell.best else ("italic", "") if column.paper else ("", "")
    first = (f"{cell.text.rjust(room)} {cell.marks(_BEST)}", style)
    return [first, (cell.interval.rjust(room), below)] if cell.interval else [first]


# Comparisons: one line each, below the name of the target.


_HEADINGS = ("", "", "P(better)", "needed")
_ABOVE_LAST = "seeds"
_ALIGNMENT = ("<", "<", ">", ">")


def _section(section: Section, available: int) -> Iterator[Text]:
    every = [text for texts in section.places.values() for text in texts]
    columns = list(zip(*map(_texts, every), strict=True))
    headings = [heading if any(column) else "" for heading, column in zip(_HEADINGS, columns, strict=True)]
    widths = [max(map(len, (heading, *column))) for heading, column in zip(headings, columns, strict=True)]
    # Labels that leave too little room for the rest get lines of their own.
    indent, rest = GAP + max(len(text.label) for text in every), sum(GAP + width for width in widths)
    stacked = indent + rest > available
    indent = 2 * GAP if stacked else indent

    title = f"{section.title}, paired by seed, with 95 % interval"
    title = title if len(title) <= available else section.title
    yield _with_heading(title, _ABOVE_LAST if headings[-1] else "", indent + rest)
    heading = _GAP.join(text.rjust(width) for text, width in zip(headings[2:], widths[2:], strict=True)).strip()
    for place, texts in section.places.items():
        yield _with_heading(place, heading, indent + rest)
        heading = ""
        for text in texts:
            label = _GAP + text.label
            if stacked:
                yield Text(label)
                label = ""
            parts = (
                f"{part:{side}{width}}" for part, side, width in zip(_texts(text), _ALIGNMENT, widths, strict=True)
            )
            style = "magenta" if text.comparison.difference.significant is False else ""
            yield Text(_GAP.join([label.ljust(indent), *parts]).rstrip(), style)


def _texts(text: ComparisonText) -> tuple[str, str, str, str]:
    return text.difference, text.verdict, text.improvement, text.seeds_needed


def _with_heading(text: str, heading: str, width: int) -> Text:
    """Return a text with a heading at its right, or below it if there is too little room."""
    if not heading:
        return Text(text)
    room = width - len(text) - len(heading)
    return Text(f"{text}{' ' * room}{heading}" if room >= GAP else f"{text}\n{heading.rjust(width)}")


def _notes(table: Table) -> RichTable:
    grid = RichTable.grid(padding=(0, 1, 0, 0))
    for mark, note in [*legend(table, _BEST), *(("-", note) for note in notes(table))]:
        grid.add_row(Text(mark), Text(note))
    return grid
