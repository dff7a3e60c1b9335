r"""Tables in LaTeX, for documents in one or two columns with `\usepackage{booktabs}`."""

import re
from collections.abc import Iterator, Sequence
from itertools import groupby
from textwrap import wrap

from meshfit.printable import printable
from meshfit.report.tables.comparison_text import comparison_lines
from meshfit.report.tables.heads import head_lines, setting_lines
from meshfit.report.tables.layout import FEWER, NOT_SIGNIFICANT, SHORTFALL, Block, Label, TextCell, blocks_of
from meshfit.report.tables.notes import legend, notes
from meshfit.report.tables.numbers import MINUS
from meshfit.report.tables.table import Table

_WIDTH = 76
"""Characters of a line in \\footnotesize on the text width of an article, 345 pt, some of them bold."""
_SMALL_WIDTH = 87
"""Characters of a line in \\scriptsize on the same width."""
_LEAST_SCALE = 0.6
"""The most that a table is shrunk on the text width of an article; on that of two columns, it is hardly shrunk."""
_MOST_LINES = 50
"""Lines of a table on one page."""
_SAME_PAGE, _NEXT_LINE = r"\\*", r"\\"
"""Ends of lines in a longtable."""
_ESCAPES = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "`": r"\textasciigrave{}",
    "†": r"\dag{}",
    "‡": r"\ddag{}",
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
    """Write each table as one `tabular` that fits the page, or as a `longtable` if it is longer than a page.

    A table that would have to be shrunk too much is broken into several blocks of columns below each other. The first
    line states the packages that the tables need.
    """
    parts = [_table(table, number) for number, table in enumerate(tables, start=1)]
    needed = sorted({package for packages, _ in parts for package in packages})
    head = [f"% needs {', '.join(needed)}: \\usepackage{{{','.join(needed)}}}"] if needed else []
    return "\n".join([*head, *("\n".join(lines) + "\n" for _, lines in parts)])


def _table(table: Table, number: int) -> tuple[set[str], list[str]]:
    """Return the packages that a table needs, and its lines."""
    blocks = list(blocks_of(table, round(_SMALL_WIDTH / _LEAST_SCALE), marks=False))
    lines = sum(1 + any(cell.interval for column in blocks[0].columns for cell in column.cells) for _ in table.rows)
    if lines > _MOST_LINES:
        return {"booktabs", "longtable"}, list(_long_table(table, number))
    large = all(block.width <= _WIDTH for block in blocks)
    shrunk = not large and any(_small_width(block) > _SMALL_WIDTH for block in blocks)
    packages = {"booktabs"} | ({"graphicx"} if shrunk else set())
    return packages, list(_float(table, number, blocks, large=large, shrunk=shrunk))


def _small_width(block: Block) -> float:
    """Characters across a block whose columns have a small gap."""
    return block.width + (_most_marks([block]) - 0.5) * len(block.columns)


def _most_marks(blocks: Sequence[Block]) -> int:
    """Return the largest number of marks of a cell, which have to fit between columns."""
    return max(len(cell.marks()) for block in blocks for column in block.columns for cell in column.cells)


def _size(blocks: Sequence[Block], *, large: bool) -> str:
    """Return the commands that set the size of the letters and the gap between columns."""
    marks = _most_marks(blocks)
    gap = {True: (None, None, 8, 10), False: (3, 5, 7, 9)}[large][marks]
    return (r"\footnotesize" if large else r"\scriptsize") + (rf"\setlength{{\tabcolsep}}{{{gap}pt}}" if gap else "")


def _float(table: Table, number: int, blocks: Sequence[Block], *, large: bool, shrunk: bool) -> Iterator[str]:
    # `table*` takes the whole width of a page in two columns, and is a usual table in one column.
    name = "table*" if shrunk else "table"
    yield rf"\begin{{{name}}}[tb]"
    yield rf"  \centering{_size(blocks, large=large)}"
    yield f"  {_caption(table, number)}"
    for place, block in enumerate(blocks):
        if place:
            yield r"  \par\medskip"
        if shrunk:
            yield r"  \resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
        yield rf"  \begin{{tabular}}{{l{'r' * len(block.columns)}}}"
        lines = [r"\toprule", *_head(table, block), r"\midrule", *_rows(block), r"\bottomrule"]
        yield from (f"    {line.replace(_SAME_PAGE, _NEXT_LINE)}" for line in lines)
        yield rf"  \end{{tabular}}{'}' if shrunk else ''}"
    if below := _below(table):
        yield rf"  \par\smallskip\parbox{{\linewidth}}{{\scriptsize {below}}}"
    yield rf"\end{{{name}}}"
    yield from _comments(table)


def _long_table(table: Table, number: int) -> Iterator[str]:
    yield r"\begingroup\footnotesize\setlength{\tabcolsep}{6pt}\setlength{\LTcapwidth}{\linewidth}"
    for place, block in enumerate(blocks_of(table, _WIDTH, marks=False)):
        if place:
            yield r"\addtocounter{table}{-1}"
        yield rf"\begin{{longtable}}{{l{'r' * len(block.columns)}}}"
        head = [r"\toprule", *_head(table, block), r"\midrule"]
        if not place:
            yield rf"  {_caption(table, number)} \\"
            yield from (f"  {line}" for line in [*head, r"\endfirsthead"])
        yield from (f"  {line}" for line in [*head, r"\endhead", r"\bottomrule", r"\endfoot", *_rows(block)])
        yield r"\end{longtable}"
    if below := _below(table):
        yield rf"\noindent{{\scriptsize {below}\par}}"
    yield r"\endgroup"
    yield from _comments(table)


def _caption(table: Table, number: int) -> str:
    text = ". ".join([table.title, *head_lines(table)]) + "."
    return rf"\caption{{{escape(text)}}}\label{{tab:{_label(table)}-{number}}}"


def _below(table: Table) -> str:
    """The settings, the marks and the notes; empty if there are none."""
    marks = [f"{mark}: {note}" for mark, note in legend(table, "Bold")]
    sentences = [*setting_lines(table), *marks, *notes(table)]
    return escape(". ".join(sentences) + ".") if sentences else ""


def _comments(table: Table) -> Iterator[str]:
    return (f"% {printable(line)}" for line in comparison_lines(table))


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
    headings = [column.heading_lines(marks=False) for column in block.columns]
    above: list[str] = []
    if len(table.metrics) > 1:
        titles, rules, begin = [""], [], 2
        for (_, group), columns in groupby(block.columns, key=lambda column: (column.place, column.group)):
            width = len(list(columns))
            titles.append(rf"\multicolumn{{{width}}}{{c}}{{{escape(group)}}}")
            rules.append(rf"\cmidrule(lr){{{begin}-{begin + width - 1}}}")
            begin += width
        above = [_joined(titles), " ".join(rules)]
        headings = [wrap(column.subheading, column.width(marks=False)) for column in block.columns]
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
        lines = [rf"\textbf{{{line}}}" for line in lines]
    marks = rf"\,{escape(NOT_SIGNIFICANT)}" if NOT_SIGNIFICANT in cell.marks() else ""
    raised = (SHORTFALL if cell.short else "") + (FEWER if cell.fewer else "")
    marks += rf"\textsuperscript{{{escape(raised)}}}" if raised else ""
    # Marks take no room, so that numbers stay aligned.
    return [rf"{lines[0]}\rlap{{{marks}}}", *lines[1:]] if marks else lines


def _joined(cells: Sequence[str]) -> str:
    return " & ".join(cells).strip() + r" \\"


def escape(text: str) -> str:
    """Escape characters that LaTeX would take for commands, and replace those outside ASCII."""
    return "".join(_ESCAPES.get(character, character) for character in printable(text))


def _label(table: Table) -> str:
    name = " ".join([table.experiment, *table.metrics])
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")
