"""The cells of a sheet for a terminal, in blocks of as many columns as fit side by side."""

from collections.abc import Iterator, Sequence

from rich.text import Text

from meshfit.report.blocks import GAP, Block, Figures, blocks
from meshfit.report.grid import Entry
from meshfit.report.sheet import Sheet

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


def _mark(entry: Entry) -> str:
    return f" {BEST}" if entry.best else f" {ALIKE}" if entry.alike else ""
