"""Tables for a terminal, fitted to its width; colour, or none of it, is up to the console that prints them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import groupby
from textwrap import wrap

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from meshfit.report.formats.rich_differences import differences_view
from meshfit.report.grid import Column, Entry, columns, entries, row_groups, row_names
from meshfit.report.sheet import Sheet
from meshfit.report.wording import alike_note, best_note, cell_line, metric_line, notes, setting_lines

_UNBOUNDED = 10_000
_BEST, _ALIKE, _NEITHER = " *", " ≈", "  "


@dataclass(frozen=True)
class SheetsView:
    """What to hand to `Console.print`: each sheet with its heading, differences and notes.

    A table that is wider than the console is broken into blocks of as many columns as fit side by side.
    """

    sheets: Sequence[Sheet]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        """The parts in the order of their printing."""
        for place, sheet in enumerate(self.sheets):
            if place:
                yield Text()
            yield Text(sheet.title, "bold")
            yield Text(metric_line(sheet))
            yield Text(cell_line(sheet))
            yield from (Text(line, "dim") for line in setting_lines(sheet))
            yield Text()
            for block in _blocks(sheet, console, options):
                yield block
                yield Text()
            yield from differences_view(sheet, options.max_width)
            yield _notes(sheet)


def to_text(sheets: Sequence[Sheet], width: int = 80) -> str:
    """The sheets as plain text, without colour."""
    file = StringIO()
    Console(file=file, width=width, color_system=None, force_terminal=False).print(SheetsView(sheets))
    return "\n".join(line.rstrip() for line in file.getvalue().splitlines()) + "\n"


def _blocks(sheet: Sheet, console: Console, options: ConsoleOptions) -> Iterator[Table]:
    shown: list[Column] = []
    for _, group in groupby(columns(sheet), key=lambda column: (column.target, column.metric)):
        more = list(group)
        wider = _block(sheet, [*shown, *more])
        width = Measurement.get(console, options.update(max_width=_UNBOUNDED), wider).maximum
        if shown and width > options.max_width:
            yield _block(sheet, shown)
            shown = []
        shown += more
    yield _block(sheet, shown)


def _block(sheet: Sheet, shown: Sequence[Column]) -> Table:
    block = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1), collapse_padding=True)
    block.add_column(Text(row_names(sheet)[-1]), overflow="fold")
    cells = []
    for column in shown:
        found = _cells(entries(sheet, column))
        width = max(len(line) for cell in found for line in cell.plain.split("\n"))
        block.add_column(_heading(sheet, column, width), overflow="fold", style="dim" if column.paper else "")
        cells.append(found)
    for heading, rows in row_groups(sheet):
        if heading:
            block.add_row(Text(heading, "italic"))
        for place, label in rows:
            block.add_row(Text(f"  {label}" if heading else label), *(column[place] for column in cells))
    return block


def _heading(sheet: Sheet, column: Column, width: int) -> Text:
    """What stands above a column, broken where its cells end, or where a word of it does, if that is farther right."""
    several = len(sheet.metrics) > 1
    parts = [sheet.targets[column.target], column.below] if several else [column.heading]
    longest = max(len(word) for part in parts for word in part.split())
    lines = [line for part in parts for line in wrap(part, max(width, longest), break_on_hyphens=False)]
    return Text("\n".join(lines), justify="right")


def _cells(found: Sequence[Entry]) -> list[Text]:
    """A column's cells, each line of them as wide as the widest, with room for marks."""
    width = max(len(line) for entry in found for line in (entry.text, entry.interval))
    marked = any(entry.best or entry.alike for entry in found)
    return [_cell(entry, width, marked) for entry in found]


def _cell(entry: Entry, width: int, marked: bool) -> Text:  # noqa: FBT001
    mark = _BEST if entry.best else _ALIKE if entry.alike else _NEITHER
    first = Text(entry.text.rjust(width) + (mark if marked else ""), "bold green" if entry.best else "")
    if not entry.interval:
        return first
    return Text("\n").join([first, Text(entry.interval.rjust(width), "green" if entry.best else "dim")])


def _notes(sheet: Sheet) -> Table:
    grid = Table.grid(padding=(0, 1, 0, 0))
    for mark, note in ((_BEST, best_note(sheet)), (_ALIKE, alike_note(sheet))):
        if note:
            grid.add_row(Text(mark.strip()), Text(note, "dim"))
    for note in notes(sheet):
        grid.add_row(Text("-", "dim"), Text(note, "dim"))
    return grid
