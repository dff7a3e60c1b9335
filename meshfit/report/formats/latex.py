r"""Tables in LaTeX, for a document with `\usepackage{booktabs}`."""

import re
from collections.abc import Sequence

from meshfit.report.grid import columns, entry
from meshfit.report.numbers import MINUS
from meshfit.report.table import ResultTable
from meshfit.report.wording import BEST, difference_lines, metric_line, notes, setting_lines

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
}


def to_latex(tables: Sequence[ResultTable]) -> str:
    """A floating table each, with caption and label."""
    return "\n".join(_float(table, place) for place, table in enumerate(tables, start=1))


def _float(table: ResultTable, place: int) -> str:
    shown = columns(table)
    rows = [" & ".join(["scheme", *(escape(column.heading) for column in shown)])]
    for scheme in table.schemes:
        entries = [entry(table, scheme, column) for column in shown]
        texts = [rf"\textbf{{{escape(found.text)}}}" if found.best else escape(found.text) for found in entries]
        rows.append(" & ".join([escape(scheme), *texts]))
    head, *body = (rf"    {row} \\" for row in rows)
    best = [f"Bold: {BEST}"] if table.best else []
    caption = ". ".join([table.title, metric_line(table), *setting_lines(table), *best, *notes(table)]) + "."
    lines = [
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{escape(caption)}}}",
        rf"  \label{{tab:{_label(table)}-{place}}}",
        rf"  \begin{{tabular}}{{l{'r' * len(shown)}}}",
        r"    \toprule",
        head,
        r"    \midrule",
        *body,
        r"    \bottomrule",
        r"  \end{tabular}",
        r"\end{table}",
        *(f"% {line}" for line in difference_lines(table)),
    ]
    return "\n".join(lines) + "\n"


def escape(text: str) -> str:
    """Text in which nothing is taken for a command."""
    return "".join(_ESCAPES.get(character, character) for character in text)


def _label(table: ResultTable) -> str:
    return re.sub(r"[^a-z0-9]+", "-", f"{table.experiment} {table.metric}".lower()).strip("-")
