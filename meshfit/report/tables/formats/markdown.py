"""Tables in GitHub's Markdown."""

import re
from collections.abc import Sequence

from meshfit.report.tables.differences import difference_lines
from meshfit.report.tables.layout import TextCell, columns, entries, row_labels, row_names
from meshfit.report.tables.notes import best_note, cell_line, metric_line, not_significant_note, notes, setting_lines
from meshfit.report.tables.sheet import Sheet

_ALIKE = "≈"
_SPECIAL = re.compile(r"([\\`*_\[\]<>|~#])")


def to_markdown(sheets: Sequence[Sheet]) -> str:
    """A heading, the table, the differences and the notes of each."""
    return "\n".join(_section(sheet) for sheet in sheets)


def _section(sheet: Sheet) -> str:
    shown, names = columns(sheet), row_names(sheet)
    head = [*names, *(escape(column.heading) for column in shown)]
    body = zip(*(entries(sheet, column) for column in shown), strict=True)
    rows = [
        [*map(escape, row_labels(sheet, row)), *map(_cell, found)] for row, found in zip(sheet.rows, body, strict=True)
    ]
    marks = [("Bold", best_note(sheet)), (_ALIKE, not_significant_note(sheet))]
    parts = [
        f"### {escape(sheet.title)}",
        escape(". ".join([metric_line(sheet), cell_line(sheet), *setting_lines(sheet)]) + "."),
        "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(names) + ["---:"] * len(shown), *rows)),
        _items(difference_lines(sheet)),
        # Paragraphs, since two lists in a row would run into one.
        *(f"{mark}: {escape(note)}" for mark, note in marks if note),
        *(escape(note) for note in notes(sheet)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _cell(entry: TextCell) -> str:
    text = escape(" ".join(filter(None, (entry.text, entry.interval))))
    return f"**{text}**" if entry.best else f"{text} {_ALIKE}" if entry.alike else text


def escape(text: str) -> str:
    """Text in which nothing is taken for markup."""
    return _SPECIAL.sub(r"\\\1", text)


def _items(lines: Sequence[str]) -> str:
    return "\n".join(f"- {escape(line)}" for line in lines)
