"""Layout of a figure: one block of pictures per target, side by side, as large as the page allows."""

import math
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from meshfit.optional import import_optional
from meshfit.report.figures.layout import LETTER, LINE, STYLE, Canvas, ColourBar, Panel, write_drawing

TALLEST = 9.0
"""Height in inches of the text of a page."""

_GAP = 0.05
_BLOCK_GAP = 0.16
_BAR = 0.46  # a vertical colour bar with its numbers
_TOP = 0.06  # room for a ring at the top of a picture
_MOST_LINES = 3
_SMALLEST_SHARE = 0.7  # of the largest possible pictures


@dataclass(frozen=True)
class BlockShape:
    """Quantities that determine the size of a block.

    Attributes:
        rows: rows of pictures.
        columns: pictures side by side.
        aspect: width by height of a picture.
        pictures: the number of pictures.
        texts: the lines below the pictures of each row that has some, unwrapped.
    """

    rows: int
    columns: int
    aspect: float
    pictures: int
    texts: tuple[tuple[str, ...], ...]

    def height(self, cell: float, font: float) -> float:
        """Return the height in inches with pictures `cell` inches wide."""
        return self.rows * cell / self.aspect + self.lines(cell, font) * font * LINE / 72 + _BLOCK_GAP

    def lines(self, cell: float, font: float) -> float:
        """Return the lines of text from top to bottom, with the room between rows."""
        return 0.35 * self.rows + sum(len(wrapped(texts, cell, font)) for texts in self.texts)


@dataclass(frozen=True)
class Arrangement:
    """Blocks on a page.

    Attributes:
        columns: blocks side by side.
        cell: width of a picture in inches.
        candidate: index of the shapes of the blocks.
        filled: share of the page that pictures take.
    """

    columns: int
    cell: float
    candidate: int
    filled: float


@dataclass(frozen=True)
class Block:
    """The pictures of a target.

    Attributes:
        rows: from top to bottom, each from left to right; None leaves a place free. The first column is that of the
            target, which is centred on its rows if the place below it is free.
        bar: colour bar at the right of the last row.
        shape: the shape.
    """

    rows: tuple[tuple[Panel | None, ...], ...]
    bar: ColourBar
    shape: BlockShape


def arrange(
    candidates: Sequence[Sequence[BlockShape]], width: float, font: float, columns: int | None = None
) -> Arrangement:
    """Choose shapes and the number of blocks side by side: large pictures, and little of the page left free.

    Args:
        candidates: alternative shapes of all blocks.
        width: of the figure in inches.
        font: size in points.
        columns: blocks side by side; by default any number.
    """
    arrangements = []
    for place, shapes in enumerate(candidates):
        for count in range(1, len(shapes) + 1) if columns is None else [min(columns, len(shapes))]:
            cell = _cell(shapes, width, font, count)
            area = sum(shape.pictures * cell * cell / shape.aspect for shape in shapes)
            arrangements.append(Arrangement(count, cell, place, area / (width * _total(shapes, cell, font, count))))
    largest = max(each.cell for each in arrangements)
    large = [each for each in arrangements if each.cell >= _SMALLEST_SHARE * largest]
    return max(large, key=lambda each: (round(each.filled, 3), -each.columns))


def _cell(shapes: Sequence[BlockShape], width: float, font: float, columns: int) -> float:
    """The largest width of a picture at which the figure is neither wider nor taller than the page."""
    across = max(shape.columns for shape in shapes)
    widest = (width - (columns - 1) * _BLOCK_GAP) / columns - _BAR - across * _GAP
    high = widest / across
    if high <= 0.05:
        return 0.05
    low = 0.05
    if _total(shapes, high, font, columns) <= TALLEST:
        return high
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if _total(shapes, middle, font, columns) <= TALLEST else (low, middle)
    return low


def _total(shapes: Sequence[BlockShape], cell: float, font: float, columns: int) -> float:
    heights = [shape.height(cell, font) for shape in shapes]
    return sum(max(heights[begin : begin + columns]) for begin in range(0, len(heights), columns))


def wrapped(texts: Sequence[str], cell: float, font: float) -> list[str]:
    """Wrap lines of text below a picture; each takes at most three lines."""
    letters = max(5, math.floor((cell + _GAP) * 72 / (LETTER * font)))
    wrapper = textwrap.TextWrapper(letters, max_lines=_MOST_LINES, placeholder="…", break_on_hyphens=True)
    return [line for text in texts for line in wrapper.wrap(text)]


def write_blocks(
    blocks: Sequence[Block], arrangement: Arrangement, path: Path, *, width: float, font: float, dpi: int
) -> None:
    """Write a figure of blocks, aligned at their lower ends; the last line of blocks is centred.

    Args:
        blocks: in reading order.
        arrangement: from `arrange`.
        path: output file; its suffix is the format.
        width: width of the figure in inches.
        font: size in points.
        dpi: pixels per inch of the pictures.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    matplotlib, figures = import_optional("matplotlib"), import_optional("matplotlib.figure")
    columns, cell = arrangement.columns, arrangement.cell
    lines = [blocks[begin : begin + columns] for begin in range(0, len(blocks), columns)]
    heights = [max(block.shape.height(cell, font) for block in line) for line in lines]
    total = round((sum(heights) + _TOP) * dpi) / dpi
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a letter missing from every font is drawn as a box
        figure = figures.Figure(figsize=(width, total), facecolor="white")
        canvas = Canvas(figure, width, total, font, dpi)
        top = total - _TOP
        for line, height in zip(lines, heights, strict=True):
            for block, left in zip(line, _lefts(line, width, cell, columns), strict=True):
                _draw(canvas, block, cell, left, top - height + block.shape.height(cell, font))
            top -= height
        write_drawing(figure, path, dpi)


def _lefts(line: Sequence[Block], width: float, cell: float, columns: int) -> Iterator[float]:
    """The left ends of blocks, spread over the width as those of a full line."""
    across = max(block.shape.columns for block in line) * (cell + _GAP) + _BAR
    room = width / columns
    begin = (width - len(line) * room) / 2
    return (begin + place * room + (room - across) / 2 for place in range(len(line)))


def _draw(canvas: Canvas, block: Block, cell: float, left: float, top: float) -> None:
    line, high = canvas.font * LINE / 72, cell / block.shape.aspect
    tops = []
    for row in block.rows:
        tops.append(top)
        texts = max((len(wrapped(panel.lines, cell, canvas.font)) for panel in row if panel is not None), default=0)
        top -= high + (texts + 0.35) * line
    for row, at in zip(block.rows, tops, strict=True):
        for place, panel in enumerate(row):
            if panel is not None:
                beside = place == 0 and len(block.rows) > 1 and block.rows[-1][0] is None
                middle = (tops[-2] + tops[-1]) / 2 if beside else at
                shown = Panel(panel.image, tuple(wrapped(panel.lines, cell, canvas.font)), panel.ring)
                canvas.add_panel(shown, left + place * (cell + _GAP), cell, middle)
    bar_height = min(high, max(0.55 * high, 5 * line))
    below = tops[-1] - (high + bar_height) / 2
    canvas.add_upright_bar(block.bar, (left + len(block.rows[-1]) * (cell + _GAP) + 0.02, below), bar_height)
