"""Tables in GitHub's Markdown."""

import re
from collections.abc import Sequence

from meshfit.report.grid import columns, entry
from meshfit.report.table import ResultTable
from meshfit.report.wording import BEST, difference_lines, metric_line, notes, setting_lines

_SPECIAL = re.compile(r"([\\`*_\[\]<>|~#])")


def to_markdown(tables: Sequence[ResultTable]) -> str:
    """A heading, the table, the differences and the notes of each."""
    return "\n".join(_section(table) for table in tables)


def _section(table: ResultTable) -> str:
    shown = columns(table)
    rows = [["scheme", *(escape(column.heading) for column in shown)], ["---", *("---:" for _ in shown)]]
    for scheme in table.schemes:
        entries = [entry(table, scheme, column) for column in shown]
        texts = [f"**{found.text}**" if found.best else found.text for found in entries]
        rows.append([escape(scheme), *texts])
    best = [f"Bold: {BEST}"] if table.best else []
    parts = [
        f"### {escape(table.title)}",
        escape(". ".join([metric_line(table), *setting_lines(table)]) + "."),
        "\n".join(f"| {' | '.join(row)} |" for row in rows),
        _items(difference_lines(table)),
        # Paragraphs, since two lists in a row would run into one.
        *(escape(note) for note in [*best, *notes(table)]),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def escape(text: str) -> str:
    """Text in which nothing is taken for markup."""
    return _SPECIAL.sub(r"\\\1", text)


def _items(lines: Sequence[str]) -> str:
    return "\n".join(f"- {escape(line)}" for line in lines)
