"""Tables as the page shows them: cells, differences and notes as text, ready for the template."""

from dataclasses import dataclass

from meshfit.report.contrast import Contrast
from meshfit.report.grid import Entry, columns, entries, row_groups, row_names
from meshfit.report.numbers import difference_and_interval
from meshfit.report.page.forest import Whisker, whiskers
from meshfit.report.sections import Section, sections
from meshfit.report.sheet import Sheet
from meshfit.report.verdicts import chance, difference_lines, seeds_text, verdict, without_intervals
from meshfit.report.wording import alike_note, best_note, cell_line, metric_line, notes, setting_lines


@dataclass(frozen=True)
class ShownRow:
    """A row: its place among all rows of the sheet, its label, and its cells."""

    place: int
    label: str
    cells: tuple[Entry, ...]


@dataclass(frozen=True)
class ShownDifference:
    """A difference: what differs, by how much, what is found of it, and how it is drawn."""

    label: str
    amount: str
    verdict: str
    chance: str
    seeds: str
    doubtful: bool
    whisker: Whisker | None


@dataclass(frozen=True)
class ShownSection:
    """Differences of one kind, by where they were found."""

    title: str
    places: tuple[tuple[str, tuple[ShownDifference, ...]], ...]


@dataclass(frozen=True)
class ShownSheet:
    """A table in text.

    Attributes:
        title: of the sheet.
        about: what its cells are.
        settings: what they were made with.
        first: what the first column holds.
        heads: what stands above the others, and whether a column is the paper's.
        groups: rows below the variation that they share.
        sections: the differences; none where `lines` say why.
        lines: what is said in place of differences.
        best: what being marked as the best means; empty where nothing is.
        alike: what being marked as alike means; likewise.
        notes: what to bear in mind.
    """

    title: str
    about: str
    settings: tuple[str, ...]
    first: str
    heads: tuple[tuple[str, bool], ...]
    groups: tuple[tuple[str, tuple[ShownRow, ...]], ...]
    sections: tuple[ShownSection, ...]
    lines: tuple[str, ...]
    best: str
    alike: str
    notes: tuple[str, ...]


def shown_sheet(sheet: Sheet) -> ShownSheet:
    """A sheet in text."""
    shown = columns(sheet)
    cells = list(zip(*(entries(sheet, column) for column in shown), strict=True))
    groups = tuple(
        (heading, tuple(ShownRow(place, label, cells[place]) for place, label in rows))
        for heading, rows in row_groups(sheet)
    )
    alone = without_intervals(sheet)
    return ShownSheet(
        title=sheet.title,
        about=f"{metric_line(sheet)}. {cell_line(sheet)}.",
        settings=tuple(setting_lines(sheet)),
        first=row_names(sheet)[-1],
        heads=tuple((column.heading, column.paper) for column in shown),
        groups=groups,
        sections=() if alone else tuple(_sections(sheet)),
        lines=tuple(difference_lines(sheet)) if alone else (),
        best=best_note(sheet),
        alike=alike_note(sheet),
        notes=tuple(notes(sheet)),
    )


def _sections(sheet: Sheet) -> list[ShownSection]:
    return [_section(sheet, section) for section in sections(sheet)]


def _section(sheet: Sheet, section: Section) -> ShownSection:
    """A section; all of its whiskers lie along one axis."""
    drawn = iter(whiskers([contrast.paired for found in section.places.values() for _, contrast in found]))
    places = tuple(
        (place, tuple(_difference(sheet, label, contrast, next(drawn)) for label, contrast in found))
        for place, found in section.places.items()
    )
    return ShownSection(section.title, places)


def _difference(sheet: Sheet, label: str, contrast: Contrast, whisker: Whisker | None) -> ShownDifference:
    paired = contrast.paired
    return ShownDifference(
        label,
        difference_and_interval(paired),
        verdict(sheet, paired),
        chance(paired),
        seeds_text(paired),
        doubtful=paired.significant is False,
        whisker=whisker,
    )
