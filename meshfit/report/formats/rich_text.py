"""Tables for a terminal, fitted to its width; colour, or none of it, is up to the console that prints them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.table import Table
from rich.text import Text

from meshfit.report.brief import brief_notes
from meshfit.report.formats.rich_differences import differences_view
from meshfit.report.formats.rich_grid import ALIKE, BEST, grid_view
from meshfit.report.sheet import Sheet
from meshfit.report.wording import alike_note, best_note, cell_line, metric_line, setting_lines


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
            yield from map(Text, setting_lines(sheet))
            yield Text()
            yield from grid_view(sheet, options.max_width)
            yield from differences_view(sheet, options.max_width)
            yield _notes(sheet)


def to_text(sheets: Sequence[Sheet], width: int = 80) -> str:
    """The sheets as plain text, without colour."""
    file = StringIO()
    Console(file=file, width=width, color_system=None, force_terminal=False).print(SheetsView(sheets))
    return "\n".join(line.rstrip() for line in file.getvalue().splitlines()) + "\n"


def _notes(sheet: Sheet) -> Table:
    grid = Table.grid(padding=(0, 1, 0, 0))
    for mark, note in ((BEST, best_note(sheet)), (ALIKE, alike_note(sheet))):
        if note:
            grid.add_row(Text(mark), Text(note))
    for note in brief_notes(sheet):
        grid.add_row(Text("-"), Text(note))
    return grid
