"""Tables for a terminal, fitted to its width; colour, or none of it, is up to the console that prints them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import groupby

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from meshfit.report.grid import Column, Entry, columns, entry
from meshfit.report.numbers import difference_and_interval
from meshfit.report.table import ResultTable
from meshfit.report.wording import BEST, difference_lines, metric_line, notes, setting_lines, verdict

_UNBOUNDED = 10_000
_BEST, _NOT_BEST = " *", "  "


@dataclass(frozen=True)
class TablesView:
    """What to hand to `Console.print`: each table with its heading, differences and notes.

    A table that is wider than the console is broken into blocks of as many targets as fit side by side.
    """

    tables: Sequence[ResultTable]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        """The parts in the order of their printing."""
        for place, table in enumerate(self.tables):
            if place:
                yield Text()
            yield Text(table.title, "bold")
            yield Text(metric_line(table))
            yield from (Text(line, "dim") for line in setting_lines(table))
            yield Text()
            for block in _blocks(table, console, options):
                yield block
                yield Text()
            yield from _differences(table)
            yield _notes(table)


def to_text(tables: Sequence[ResultTable], width: int = 80) -> str:
    """The tables as plain text, without colour."""
    file = StringIO()
    Console(file=file, width=width, color_system=None, force_terminal=False).print(TablesView(tables))
    return "\n".join(line.rstrip() for line in file.getvalue().splitlines()) + "\n"


def _blocks(table: ResultTable, console: Console, options: ConsoleOptions) -> Iterator[Table]:
    shown: list[Column] = []
    for _, group in groupby(columns(table), key=lambda column: column.target):
        more = list(group)
        wider = _block(table, [*shown, *more])
        width = Measurement.get(console, options.update(max_width=_UNBOUNDED), wider).maximum
        if shown and width > options.max_width:
            yield _block(table, shown)
            shown = []
        shown += more
    yield _block(table, shown)


def _block(table: ResultTable, shown: Sequence[Column]) -> Table:
    block = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1), collapse_padding=True)
    block.add_column(Text("scheme"), overflow="fold")
    for column in shown:
        # One word a line: titles are the widest part of narrow columns.
        heading = "\n".join(column.heading.split())
        block.add_column(Text(heading), justify="right", style="dim" if column.paper else "", overflow="fold")
    cells = [_cells(table, column) for column in shown]
    for scheme, *row in zip(table.schemes, *cells, strict=True):
        block.add_row(Text(scheme), *row)
    return block


def _cells(table: ResultTable, column: Column) -> list[Text]:
    """A column's cells, with the spreads below each other and room for the mark of the best."""
    entries = [entry(table, scheme, column) for scheme in table.schemes]
    spreads = [found.text.partition(" ± ")[2] for found in entries]
    room = max(map(len, spreads))
    marked = any(found.best for found in entries)
    return [_cell(found, room - len(spread), marked) for found, spread in zip(entries, spreads, strict=True)]


def _cell(found: Entry, room: int, marked: bool) -> Text:  # noqa: FBT001
    mark = (_BEST if found.best else _NOT_BEST) if marked else ""
    padding = " " * room if "±" in found.text else ""
    return Text(found.text + padding + mark, "bold green" if found.best else "")


def _differences(table: ResultTable) -> Iterator[RenderableType]:
    """A line each, below the name of the target; or why there are none to compare."""
    found = table.differences
    if not found:
        return
    lines = difference_lines(table)
    if len(lines) < len(found):
        yield from map(Text, lines)
    else:
        yield Text(f"Difference from {found[0].baseline}, paired by seed, with 95 % interval")
        grid = Table.grid(padding=(0, 2, 0, 0))
        for target, group in groupby(found, key=lambda difference: difference.target):
            grid.add_row(Text(table.targets[target]))
            for difference in group:
                text = difference_and_interval(difference.paired)
                grid.add_row(Text(f"  {difference.scheme}"), Text(text), Text(verdict(table, difference)))
        yield grid
    yield Text()


def _notes(table: ResultTable) -> Table:
    grid = Table.grid(padding=(0, 1, 0, 0))
    if table.best:
        grid.add_row(Text("*"), Text(BEST, "dim"))
    for note in notes(table):
        grid.add_row(Text("-", "dim"), Text(note, "dim"))
    return grid
