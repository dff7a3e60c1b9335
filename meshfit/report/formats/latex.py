r"""Tables in LaTeX, for a document with `\usepackage{booktabs}`."""

import re
from collections.abc import Iterator, Sequence
from itertools import groupby

from meshfit.report.grid import Column, Entry, columns, entries, row_groups, row_names
from meshfit.report.numbers import MINUS
from meshfit.report.sheet import Sheet
from meshfit.report.verdicts import difference_lines
from meshfit.report.wording import alike_note, best_note, cell_line, metric_line, notes, setting_lines

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


def to_latex(sheets: Sequence[Sheet]) -> str:
    """A floating table each, with caption and label."""
    return "\n".join(_float(sheet, place) for place, sheet in enumerate(sheets, start=1))


def _float(sheet: Sheet, place: int) -> str:
    shown = columns(sheet)
    marks = [("Bold", best_note(sheet)), (_ALIKE, alike_note(sheet))]
    legend = [f"{mark}: {note}" for mark, note in marks if note]
    said = [sheet.title, metric_line(sheet), cell_line(sheet), *setting_lines(sheet), *legend, *notes(sheet)]
    lines = [
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{escape('. '.join(said) + '.')}}}",
        rf"  \label{{tab:{_label(sheet)}-{place}}}",
        rf"  \begin{{tabular}}{{l{'r' * len(shown)}}}",
        r"    \toprule",
        *(f"    {line}" for line in _head(sheet, shown)),
        r"    \midrule",
        *(f"    {line}" for line in _body(sheet, shown)),
        r"    \bottomrule",
        r"  \end{tabular}",
        r"\end{table}",
        *(f"% {line}" for line in difference_lines(sheet)),
    ]
    return "\n".join(lines) + "\n"


def _head(sheet: Sheet, shown: Sequence[Column]) -> list[str]:
    """The headings; with several metrics, targets above them."""
    first = row_names(sheet)[-1]
    if len(sheet.metrics) == 1:
        return [" & ".join([first, *(escape(column.heading) for column in shown)]) + r" \\"]
    above, rules, begin = [""], [], 2
    for target, group in groupby(shown, key=lambda column: column.target):
        width = len(list(group))
        above.append(rf"\multicolumn{{{width}}}{{c}}{{{escape(sheet.targets[target])}}}")
        rules.append(rf"\cmidrule(lr){{{begin}-{begin + width - 1}}}")
        begin += width
    below = [first, *(escape(column.below) for column in shown)]
    return [" & ".join(above) + r" \\", " ".join(rules), " & ".join(below) + r" \\"]


def _body(sheet: Sheet, shown: Sequence[Column]) -> Iterator[str]:
    """The rows; those of a variation below its name, where it has several."""
    found = list(zip(*(entries(sheet, column) for column in shown), strict=True))
    for group, (heading, rows) in enumerate(row_groups(sheet)):
        if heading:
            yield from [r"\addlinespace"] if group else []
            yield rf"\multicolumn{{{len(shown) + 1}}}{{l}}{{\emph{{{escape(heading)}}}}} \\"
        for place, label in rows:
            indent = r"\quad " if heading else ""
            yield " & ".join([f"{indent}{escape(label)}", *map(_cell, found[place])]) + r" \\"


def _cell(entry: Entry) -> str:
    text = escape(" ".join(filter(None, (entry.text, entry.interval))))
    return rf"\textbf{{{text}}}" if entry.best else f"{text} {escape(_ALIKE)}" if entry.alike else text


def escape(text: str) -> str:
    """Text in which nothing is taken for a command."""
    return "".join(_ESCAPES.get(character, character) for character in text)


def _label(sheet: Sheet) -> str:
    name = " ".join([sheet.tables[0][0].experiment, *sheet.metrics])
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")
