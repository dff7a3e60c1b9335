"""Tables in GitHub's Markdown."""

import re
from collections.abc import Sequence

from meshfit.printable import printable
from meshfit.report.tables.comparison_text import comparison_lines
from meshfit.report.tables.heads import head_lines, setting_lines
from meshfit.report.tables.layout import TextCell, columns_of, row_labels, row_names
from meshfit.report.tables.notes import legend, notes
from meshfit.report.tables.table import Table

_SPECIAL = re.compile(r"([\\`*_\[\]<>|~#&$])")


def to_markdown(tables: Sequence[Table]) -> str:
    """Write each table with a heading, its comparisons and its notes."""
    return "\n".join(_section(table) for table in tables)


def _section(table: Table) -> str:
    columns, names = columns_of(table), row_names(table)
    head = [*names, *(escape(column.heading) for column in columns)]
    rows = [
        [*map(escape, labels), *(_cell(column.cells[index]) for column in columns)]
        for index, labels in enumerate(row_labels(table))
    ]
    parts = [
        f"### {escape(table.title)}",
        escape(". ".join([*head_lines(table), *setting_lines(table)]) + "."),
        "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(names) + ["---:"] * len(columns), *rows)),
        "\n".join(f"- {escape(line)}" for line in comparison_lines(table)),
        # Paragraphs, since Markdown would join them to the list above.
        *(f"{mark}: {escape(note)}" for mark, note in legend(table, "Bold")),
        *(escape(note) for note in notes(table)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _cell(cell: TextCell) -> str:
    text = escape(" ".join(filter(None, (cell.text, cell.interval))))
    return f"{f'**{text}**' if cell.best else text} {cell.marks()}".rstrip()


def escape(text: str) -> str:
    """Escape characters that Markdown would take for markup."""
    return _SPECIAL.sub(r"\\\1", printable(text))
