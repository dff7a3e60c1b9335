r"""Tables in LaTeX, for a document with `\usepackage{booktabs}`."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap

from meshfit.report.tables.differences import difference_lines
from meshfit.report.tables.layout import Block, Label, TextCell, blocks
from meshfit.report.tables.notes import best_note, cell_line, metric_line, not_significant_note, notes, setting_lines
from meshfit.report.tables.numbers import MINUS
from meshfit.report.tables.sheet import Sheet

_ALIKE = "≈"
_ESCAPES = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    # A bracket right after \\ would be taken for its argument.
    "[": "{[}",
    "]": "{]}",
    MINUS: "$-$",
    "±": r"$\pm$",
    "–": "--",
    "·": r"$\cdot$",
    "…": r"\dots{}",
    "²": r"$^2$",
    "°": r"$^\circ$",
    "τ": r"$\tau$",
    "α": r"$\alpha$",
    "√": r"$\surd$",
    "×": r"$\times$",
    "≈": r"$\approx$",
}


_WIDTH = 76
"""Characters of a line in \\footnotesize on the text width of an article, 345 pt, some of them bold."""
_PAGE = 50
"""Lines of a page in that size."""
_CAPTION, _NOTE = 1.3 / 75, 0.75 / 105
"""Lines that a character of the caption and of the notes takes."""
_RULES = 2
"""Lines that the rules and spaces of a block take."""


@dataclass(frozen=True)
class _Tabular:
    """A block, or a part of one: its lines of source, and how many lines of the page they take."""

    source: tuple[str, ...]
    height: int


def to_latex(sheets: Sequence[Sheet]) -> str:
    """Floating tables with caption and label, as many for a sheet as it takes pages."""
    return "\n".join(
        _float(sheet, f"{_label(sheet)}-{place}", number, part)
        for place, sheet in enumerate(sheets, start=1)
        for number, part in enumerate(_parts(sheet), start=1)
    )


def _float(sheet: Sheet, label: str, number: int, tabulars: Sequence[_Tabular]) -> str:
    caption, below = _said(sheet, number)
    lines = [
        r"\begin{table}",
        r"  \centering",
        *([r"  \addtocounter{table}{-1}"] if number > 1 else []),
        rf"  \caption{{{escape(caption)}}}",
        rf"  \label{{tab:{label if number == 1 else f'{label}-{number}'}}}",
        r"  \smallskip\footnotesize\setlength{\tabcolsep}{6pt}",
        *(f"  {line}" for place, one in enumerate(tabulars) for line in [*[_BETWEEN] * bool(place), *one.source]),
        *([rf"  \par\smallskip\parbox{{\linewidth}}{{\scriptsize {escape(below)}}}"] if below else []),
        r"\end{table}",
        *([f"% {line}" for line in difference_lines(sheet)] if number == 1 else []),
    ]
    return "\n".join(lines) + "\n"


_BETWEEN = r"\par\medskip"


def _said(sheet: Sheet, number: int) -> tuple[str, str]:
    """The caption, and what stands below: in full at the first of several tables."""
    marks = [("Bold", best_note(sheet)), (_ALIKE, not_significant_note(sheet))]
    legend = [f"{mark}: {note}" for mark, note in marks if note]
    caption = [sheet.title, metric_line(sheet), cell_line(sheet)] if number == 1 else [f"{sheet.title} (continued)"]
    below = [*setting_lines(sheet), *legend, *notes(sheet)] if number == 1 else legend
    return ". ".join(caption) + ".", ". ".join(below) + "." if below else ""


def _parts(sheet: Sheet) -> Iterator[list[_Tabular]]:
    """The tabulars of a sheet, those that fit a page together."""
    caption, below = _said(sheet, 1)
    room = _PAGE - round(len(caption) * _CAPTION + len(below) * _NOTE)
    page: list[_Tabular] = []
    for one in (one for block in blocks(sheet, _WIDTH, mark=0) for one in _tabulars(sheet, block, room)):
        if page and sum(before.height for before in page) + one.height > room:
            yield page
            page, room = [], _PAGE
        page.append(one)
    yield page


def _tabulars(sheet: Sheet, block: Block, room: int) -> Iterator[_Tabular]:
    """A block, in so many parts that each fits a page."""
    head, labels = _head(sheet, block), list(block.labels.labels)
    while labels:
        rows, height = list[list[str]](), len(head) + _RULES
        for label in labels:
            row = _row(block, label)
            if rows and height + len(row) > room:
                break
            rows.append(row)
            height += len(row)
        if 1 < len(rows) < len(labels) and labels[len(rows) - 1].place is None:
            rows.pop()  # a heading belongs to the rows below it
        yield _Tabular(tuple(_source(block, head, rows)), height)
        labels = labels[len(rows) :]


def _source(block: Block, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield rf"\begin{{tabular}}{{l{'r' * len(block.figures)}}}"
    yield r"  \toprule"
    yield from (f"  {line}" for line in head)
    yield r"  \midrule"
    for place, row in enumerate(rows):
        yield from [r"  \addlinespace[2pt]"] if place and len(row) > 1 else []
        yield from (f"  {line}" for line in row)
    yield r"  \bottomrule"
    yield r"\end{tabular}"


def _head(sheet: Sheet, block: Block) -> list[str]:
    """The headings, in as many lines as it takes; with several metrics, targets above them."""
    headings = [list(figures.heading) for figures in block.figures]
    above: list[str] = []
    if len(sheet.metrics) > 1:
        titles, rules, begin = [""], [], 2
        for target, group in groupby(block.figures, key=lambda figures: figures.column.target):
            width = len(list(group))
            titles.append(rf"\multicolumn{{{width}}}{{c}}{{{escape(sheet.targets[target])}}}")
            rules.append(rf"\cmidrule(lr){{{begin}-{begin + width - 1}}}")
            begin += width
        above = [_joined(titles), " ".join(rules)]
        headings = [wrap(figures.column.below, max(figures.width, 1)) for figures in block.figures]
    height = max(map(len, headings))
    columns = [[""] * (height - 1) + [block.labels.heading]]
    columns += [[*[""] * (height - len(lines)), *map(escape, lines)] for lines in headings]
    return [*above, *(_joined(line) for line in zip(*columns, strict=True))]


def _row(block: Block, label: Label) -> list[str]:
    """A row: as many lines as its tallest cell has; or a heading of rows, over all columns."""
    if label.place is None:
        return [rf"\multicolumn{{{len(block.figures) + 1}}}{{l}}{{\emph{{{escape(' '.join(label.lines))}}}}} \\"]
    first = [
        escape(line.strip()) if line == line.lstrip() else rf"\quad {escape(line.strip())}" for line in label.lines
    ]
    cells = [first, *(_cell(figures.entries[label.place]) for figures in block.figures)]
    height = max(map(len, cells))
    return [_joined(line) for line in zip(*([*cell, *[""] * (height - len(cell))] for cell in cells), strict=True)]


def _cell(entry: TextCell) -> list[str]:
    lines = [escape(text) for text in (entry.text, entry.interval) if text]
    if entry.best:
        return [rf"\textbf{{{line}}}" for line in lines]
    # The mark takes no room, so that numbers stay below each other.
    return [f"{lines[0]}\\rlap{{\\,{escape(_ALIKE)}}}", *lines[1:]] if entry.alike else lines


def _joined(cells: Sequence[str]) -> str:
    return " & ".join(cells).strip() + r" \\"


def escape(text: str) -> str:
    """Text in which nothing is taken for a command."""
    return "".join(_ESCAPES.get(character, character) for character in text)


def _label(sheet: Sheet) -> str:
    name = " ".join([sheet.tables[0][0].experiment, *sheet.metrics])
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")
