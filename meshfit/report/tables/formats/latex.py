r"""Tables in LaTeX, for a document in one column with `\usepackage{booktabs,longtable}`."""

import re
from collections.abc import Iterator, Sequence
from itertools import groupby
from textwrap import wrap

from meshfit.printable import printable
from meshfit.report.tables.layout import Block, Label, TextCell, blocks_of
from meshfit.report.tables.notes import (
    NOT_SIGNIFICANT,
    cell_line,
    comparison_lines,
    legend,
    metric_line,
    notes,
    setting_lines,
)
from meshfit.report.tables.numbers import MINUS
from meshfit.report.tables.table import Table

_WIDTH = 76
"""Characters of a line in \\footnotesize on the text width of an article, 345 pt, some of them bold."""
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


def to_latex(tables: Sequence[Table]) -> str:
    """Write each table as a `longtable`, or as several below each other if it is wider than the page."""
    return "\n".join("\n".join(_table(table, number)) + "\n" for number, table in enumerate(tables, start=1))


def _table(table: Table, number: int) -> Iterator[str]:
    yield r"\begingroup\footnotesize\setlength{\tabcolsep}{6pt}\setlength{\LTcapwidth}{\linewidth}"
    for place, block in enumerate(blocks_of(table, _WIDTH, mark=0)):
        if place:
            yield r"\addtocounter{table}{-1}"
        yield rf"\begin{{longtable}}{{l{'r' * len(block.columns)}}}"
        head = [r"\toprule", *_head(table, block), r"\midrule"]
        if not place:
            caption = ". ".join([table.title, metric_line(table), cell_line(table)]) + "."
            yield rf"  \caption{{{escape(caption)}}}\label{{tab:{_label(table)}-{number}}} \\"
            yield from (f"  {line}" for line in [*head, r"\endfirsthead"])
        yield from (f"  {line}" for line in [*head, r"\endhead", r"\bottomrule", r"\endfoot", *_rows(block)])
        yield r"\end{longtable}"
    marks = [f"{mark}: {note}" for mark, note in legend(table, "Bold")]
    below = ". ".join([*setting_lines(table), *marks, *notes(table)]) + "."
    yield rf"\noindent{{\scriptsize {escape(below)}\par}}"
    yield r"\endgroup"
    yield from (f"% {printable(line)}" for line in comparison_lines(table))


def _rows(block: Block) -> Iterator[str]:
    for place, label in enumerate(block.labels):
        lines = _row(block, label)
        if place and len(lines) > 1:
            yield r"\addlinespace[2pt]"
        # The lines of a row, and the name of a variation and the row below it, stay on one page.
        yield from (rf"{line}*" for line in lines[:-1])
        yield rf"{lines[-1]}*" if label.row is None else lines[-1]


def _head(table: Table, block: Block) -> list[str]:
    """Return the lines of the headings; with several metrics, targets stand above them."""
    headings = [column.heading_lines(block.mark) for column in block.columns]
    above: list[str] = []
    if len(table.metrics) > 1:
        titles, rules, begin = [""], [], 2
        for target, columns in groupby(block.columns, key=lambda column: column.target):
            width = len(list(columns))
            titles.append(rf"\multicolumn{{{width}}}{{c}}{{{escape(table.targets[target])}}}")
            rules.append(rf"\cmidrule(lr){{{begin}-{begin + width - 1}}}")
            begin += width
        above = [_joined(titles), " ".join(rules)]
        headings = [wrap(column.subheading, column.width(block.mark)) for column in block.columns]
    height = max(map(len, headings))
    columns_of_lines = [[""] * (height - 1) + [block.heading]]
    columns_of_lines += [[*[""] * (height - len(lines)), *map(escape, lines)] for lines in headings]
    return [*above, *(_joined(line) for line in zip(*columns_of_lines, strict=True))]


def _row(block: Block, label: Label) -> list[str]:
    """Return the lines of a row, as many as its tallest cell has, or the name of a variation over all columns."""
    if label.row is None:
        return [rf"\multicolumn{{{len(block.columns) + 1}}}{{l}}{{\emph{{{escape(' '.join(label.lines))}}}}} \\"]
    first = [
        escape(line.strip()) if line == line.lstrip() else rf"\quad {escape(line.strip())}" for line in label.lines
    ]
    cells = [first, *(_cell(column.cells[label.row]) for column in block.columns)]
    height = max(map(len, cells))
    return [_joined(line) for line in zip(*([*cell, *[""] * (height - len(cell))] for cell in cells), strict=True)]


def _cell(cell: TextCell) -> list[str]:
    lines = [escape(text) for text in (cell.text, cell.interval) if text]
    if cell.best:
        return [rf"\textbf{{{line}}}" for line in lines]
    # The mark takes no room, so that numbers stay aligned.
    return [f"{lines[0]}\\rlap{{\\,{escape(NOT_SIGNIFICANT)}}}", *lines[1:]] if cell.not_significant else lines


def _joined(cells: Sequence[str]) -> str:
    return " & ".join(cells).strip() + r" \\"


def escape(text: str) -> str:
    """Escape characters that LaTeX would take for commands, and replace those outside ASCII."""
    return "".join(_ESCAPES.get(character, character) for character in printable(text))


def _label(table: Table) -> str:
    name = " ".join([table.experiment, *table.metrics])
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")
