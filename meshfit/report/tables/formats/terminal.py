"""The differences of a sheet for a terminal: a line each, below the name of the target."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.table import Table
from rich.text import Text

from meshfit.report.tables.comparisons import Comparison
from meshfit.report.tables.differences import (
    Section,
    difference_lines,
    improvement_text,
    sections,
    seeds_text,
    verdict,
    without_intervals,
)
from meshfit.report.tables.layout import GAP, Block, Figures, TextCell, blocks
from meshfit.report.tables.notes import (
    best_note,
    brief_notes,
    cell_line,
    metric_line,
    not_significant_note,
    setting_lines,
)
from meshfit.report.tables.numbers import format_difference
from meshfit.report.tables.sheet import Sheet

_GAP = "  "
_HEADS = ("", "", "P(better)", "needed")
_ABOVE_LAST = "seeds"
_SIDES = ("<", "<", ">", ">")


@dataclass(frozen=True)
class _Line:
    """A difference in text: difference and interval, verdict, P(better) and seeds needed."""

    label: str
    figures: tuple[str, str, str, str]
    doubtful: bool


@dataclass(frozen=True)
class _Layout:
    """How wide what is.

    Attributes:
        heads: what stands above the figures, as far as there are some.
        widths: of the figures.
        indent: what is left of them; the labels, unless these are stacked.
        stacked: whether labels have lines of their own, since lines would be too long with them.
    """

    heads: tuple[str, ...]
    widths: tuple[int, ...]
    indent: int
    stacked: bool

    @property
    def width(self) -> int:
        return self.indent + sum(len(_GAP) + width for width in self.widths)


def differences_view(sheet: Sheet, width: int) -> Iterator[Text]:
    """The lines to print of the differences, in so many columns; or why there are none to compare."""
    if without_intervals(sheet):
        yield from map(Text, [*difference_lines(sheet), ""])
        return
    for section in sections(sheet):
        yield from _section(sheet, section, width)
        yield Text()


def _section(sheet: Sheet, section: Section, width: int) -> Iterator[Text]:
    places = {place: [_line(sheet, *one) for one in found] for place, found in section.places.items()}
    layout = _layout([line for lines in places.values() for line in lines], width)
    title = f"{section.title}, paired by seed, with 95 % interval"
    title = title if len(title) <= width else section.title
    yield _with_heading(title, _ABOVE_LAST if layout.heads[-1] else "", layout.width)
    heading = _GAP.join(head.rjust(one) for head, one in zip(layout.heads[2:], layout.widths[2:], strict=True)).strip()
    for place, lines in places.items():
        yield _with_heading(place, heading, layout.width)
        heading = ""
        for line in lines:
            yield from _printed(line, layout)


def _line(sheet: Sheet, label: str, contrast: Comparison) -> _Line:
    paired = contrast.paired
    figures = format_difference(paired), verdict(sheet, paired), improvement_text(paired), seeds_text(paired)
    return _Line(_GAP + label, figures, doubtful=paired.significant is False)


def _layout(lines: Sequence[_Line], width: int) -> _Layout:
    columns = list(zip(*(line.figures for line in lines), strict=True))
    heads = tuple(head if any(column) else "" for head, column in zip(_HEADS, columns, strict=True))
    widths = tuple(max(map(len, (head, *column))) for head, column in zip(heads, columns, strict=True))
    beside = _Layout(heads, widths, max(len(line.label) for line in lines), stacked=False)
    return beside if beside.width <= width else _Layout(heads, widths, 2 * len(_GAP), stacked=True)


def _printed(line: _Line, layout: _Layout) -> Iterator[Text]:
    if layout.stacked:
        yield Text(line.label)
    parts = (f"{text:{side}{one}}" for text, side, one in zip(line.figures, _SIDES, layout.widths, strict=True))
    label = "" if layout.stacked else line.label
    yield Text(_GAP.join([label.ljust(layout.indent), *parts]).rstrip(), "magenta" if line.doubtful else "")


def _with_heading(text: str, heading: str, width: int) -> Text:
    """A text, with a heading of the columns at its right, or below it where it is too long for that."""
    if not heading:
        return Text(text)
    room = width - len(text) - len(heading)
    if room < len(_GAP):
        return Text(f"{text}\n{heading.rjust(width)}")
    return Text(f"{text}{' ' * room}{heading}")


BEST, ALIKE = "*", "≈"

Styled = tuple[str, str]
"""Text and its style."""


def grid_view(sheet: Sheet, width: int) -> Iterator[Text]:
    """The lines to print, in so many columns; below each block an empty one."""
    for block in blocks(sheet, width):
        yield from _block(block)
        yield Text()


def _block(block: Block) -> Iterator[Text]:
    widths = [block.labels.width, *(figures.width for figures in block.figures)]
    height = max(len(figures.heading) for figures in block.figures)
    first = [("", "")] * (height - 1) + [(block.labels.heading, "bold")]
    yield from _lines([first, *(_heading(figures, height) for figures in block.figures)], widths)
    yield Text("─" * block.width)
    for label in block.labels.labels:
        style = "bold" if label.place is None else ""
        cells = [] if label.place is None else [_cell(figures, label.place) for figures in block.figures]
        yield from _lines([[(line, style) for line in label.lines], *cells], widths)


def _lines(cells: Sequence[Sequence[Styled]], widths: Sequence[int]) -> Iterator[Text]:
    """A row: as many lines as its tallest cell has."""
    for place in range(max(map(len, cells))):
        line = [cell[place] if place < len(cell) else ("", "") for cell in cells]
        padded = [(text.ljust(width), style) for (text, style), width in zip(line, widths, strict=False)]
        text = Text(" " * GAP).join(Text(text, style) for text, style in padded)
        text.rstrip()
        yield text


def _heading(figures: Figures, height: int) -> list[Styled]:
    lines = [*[""] * (height - len(figures.heading)), *figures.heading]
    return [(line.rjust(figures.width), "bold") for line in lines]


def _cell(figures: Figures, place: int) -> list[Styled]:
    entry = figures.entries[place]
    room = figures.width - GAP * any(one.best or one.alike for one in figures.entries)
    style, other = ("bold green", "green") if entry.best else ("italic", "") if figures.column.paper else ("", "")
    first = (entry.text.rjust(room) + _mark(entry), style)
    return [first, (entry.interval.rjust(room), other)] if entry.interval else [first]


def _mark(entry: TextCell) -> str:
    return f" {BEST}" if entry.best else f" {ALIKE}" if entry.alike else ""


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
    for mark, note in ((BEST, best_note(sheet)), (ALIKE, not_significant_note(sheet))):
        if note:
            grid.add_row(Text(mark), Text(note))
    for note in brief_notes(sheet):
        grid.add_row(Text("-"), Text(note))
    return grid
