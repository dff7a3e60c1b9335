"""What is said below a table on a terminal: what the notes of other formats say, in a few words."""

from collections.abc import Iterator

from meshfit.report.grid import columns
from meshfit.report.paper import LIKELIER, OTHER
from meshfit.report.sheet import Sheet
from meshfit.report.wording import few_seeds, paper_numbers, stand_ins


def brief_notes(sheet: Sheet) -> list[str]:
    """What a reader has to know to read the numbers rightly, a line or two each."""
    return [note for note in (few_seeds(sheet), *_differences(sheet), *_stand_ins(sheet), _paper(sheet)) if note]


def _differences(sheet: Sheet) -> Iterator[str]:
    found = [contrast for contrast in sheet.contrasts if contrast.paired.interval is not None]
    if not found:
        return
    yield "significant: the interval is clear of 0; so is that of 1 in 20 equal pairs"
    if any(contrast.target is None for contrast in found):
        yield "over targets: the mean; its interval is for other seeds, not other targets"
    if any(contrast.paired.improvement is not None for contrast in found):
        yield "P(better): share of pairs of runs in which the one named is better, ties half"
    yield "seeds needed: to find such a difference significant in 4 of 5 experiments"


def _stand_ins(sheet: Sheet) -> list[str]:
    return [f"{title}: not the paper's model, nor comparable with its numbers" for title in stand_ins(sheet)]


def _paper(sheet: Sheet) -> str:
    likelier, other = (paper_numbers(sheet, reading) for reading in (LIKELIER, OTHER))
    if not likelier:
        return ""
    said = "shown" if any(column.paper for column in columns(sheet)) else f"they are {likelier}"
    return (
        "paper's: its Table 1, one run each, settings not all known; read "
        f"{LIKELIER}, the likelier, {said}; {OTHER} {other}"
    )
