"""The differences of a sheet for a terminal: a line each, below the name of the target."""

from collections.abc import Iterator, Sequence

from rich.text import Text

from meshfit.report.contrast import Contrast
from meshfit.report.numbers import difference_and_interval
from meshfit.report.sections import Section, sections
from meshfit.report.sheet import Sheet
from meshfit.report.verdicts import chance, difference_lines, seeds_text, verdict, without_intervals

_GAP = "  "
_HEADS = ("", "", "P(better)", "needed")
_ABOVE_LAST = "seeds"


def differences_view(sheet: Sheet, width: int) -> Iterator[Text]:
    """The lines to print of the differences, in so many columns; or why there are none to compare."""
    if without_intervals(sheet):
        yield from map(Text, [*difference_lines(sheet), ""])
        return
    for section in sections(sheet):
        yield from _section(sheet, section, width)
        yield Text()


def _section(sheet: Sheet, section: Section, width: int) -> Iterator[Text]:
    """The lines below each other; where they are too long, labels get lines of their own."""
    figures = [_figures(sheet, contrast) for found in section.places.values() for _, contrast in found]
    heads = [head if any(line[place] for line in figures) else "" for place, head in enumerate(_HEADS)]
    title = f"{section.title}, paired by seed, with 95 % interval"
    widths = [max(map(len, column)) for column in zip(*figures, heads, strict=True)]
    labels = max(len(_GAP + label) for found in section.places.values() for label, _ in found)
    stacked = labels + sum(len(_GAP) + one for one in widths) > width
    indent = 2 * len(_GAP) if stacked else labels
    ends = indent + sum(len(_GAP) + one for one in widths)

    yield _with_heading(title if len(title) <= width else section.title, _ABOVE_LAST if heads[-1] else "", ends)
    heading = _GAP.join(found.rjust(one) for found, one in zip(heads[2:], widths[2:], strict=True)).strip()
    for place, found in section.places.items():
        yield _with_heading(place, heading, ends)
        heading = ""
        for label, contrast in found:
            line = _line("" if stacked else _GAP + label, indent, _figures(sheet, contrast), widths)
            yield from [Text(_GAP + label)] if stacked else []
            yield Text(line, "yellow" if contrast.paired.significant is False else "")


def _figures(sheet: Sheet, contrast: Contrast) -> tuple[str, str, str, str]:
    paired = contrast.paired
    return difference_and_interval(paired), verdict(sheet, paired), chance(paired), seeds_text(paired)


def _line(label: str, indent: int, figures: Sequence[str], widths: Sequence[int]) -> str:
    sides = ("<", "<", ">", ">")
    parts = (f"{text:{side}{one}}" for text, side, one in zip(figures, sides, widths, strict=True))
    return _GAP.join([label.ljust(indent), *parts]).rstrip()


def _with_heading(text: str, heading: str, ends: int) -> Text:
    """A text, with a heading of the columns at its right, or below it where it is too long for that."""
    if not heading:
        return Text(text)
    room = ends - len(text) - len(heading)
    if room < len(_GAP):
        return Text.assemble(text, "\n", (heading.rjust(ends), "dim"))
    return Text.assemble(text, " " * room, (heading, "dim"))
