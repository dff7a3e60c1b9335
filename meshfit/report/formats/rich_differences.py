"""The differences of a sheet for a terminal: a line each, below the name of the target."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rich.text import Text

from meshfit.report.contrast import Contrast
from meshfit.report.numbers import difference_and_interval
from meshfit.report.sections import Section, sections
from meshfit.report.sheet import Sheet
from meshfit.report.verdicts import chance, difference_lines, seeds_text, verdict, without_intervals

_GAP = "  "
_HEADS = ("", "", "P(better)", "needed")
_ABOVE_LAST = "seeds"
_SIDES = ("<", "<", ">", ">")


@dataclass(frozen=True)
class _Line:
    """A difference in text: difference and interval, verdict, P(better) and seeds needed."""

    label: str
    figures: tuple[str, str, str, str]
    doubtful: bool


@dataclass(frozen=True)
class _Layout:
    """How wide what is.

    Attributes:
        heads: what stands above the figures, as far as there are some.
        widths: of the figures.
        indent: what is left of them; the labels, unless these are stacked.
        stacked: whether labels have lines of their own, since lines would be too long with them.
    """

    heads: tuple[str, ...]
    widths: tuple[int, ...]
    indent: int
    stacked: bool

    @property
    def width(self) -> int:
        return self.indent + sum(len(_GAP) + width for width in self.widths)


def differences_view(sheet: Sheet, width: int) -> Iterator[Text]:
    """The lines to print of the differences, in so many columns; or why there are none to compare."""
    if without_intervals(sheet):
        yield from map(Text, [*difference_lines(sheet), ""])
        return
    for section in sections(sheet):
        yield from _section(sheet, section, width)
        yield Text()


def _section(sheet: Sheet, section: Section, width: int) -> Iterator[Text]:
    places = {place: [_line(sheet, *one) for one in found] for place, found in section.places.items()}
    layout = _layout([line for lines in places.values() for line in lines], width)
    title = f"{section.title}, paired by seed, with 95 % interval"
    title = title if len(title) <= width else section.title
    yield _with_heading(title, _ABOVE_LAST if layout.heads[-1] else "", layout.width)
    heading = _GAP.join(head.rjust(one) for head, one in zip(layout.heads[2:], layout.widths[2:], strict=True)).strip()
    for place, lines in places.items():
        yield _with_heading(place, heading, layout.width)
        heading = ""
        for line in lines:
            yield from _printed(line, layout)


def _line(sheet: Sheet, label: str, contrast: Contrast) -> _Line:
    paired = contrast.paired
    figures = difference_and_interval(paired), verdict(sheet, paired), chance(paired), seeds_text(paired)
    return _Line(_GAP + label, figures, doubtful=paired.significant is False)


def _layout(lines: Sequence[_Line], width: int) -> _Layout:
    columns = list(zip(*(line.figures for line in lines), strict=True))
    heads = tuple(head if any(column) else "" for head, column in zip(_HEADS, columns, strict=True))
    widths = tuple(max(map(len, (head, *column))) for head, column in zip(heads, columns, strict=True))
    beside = _Layout(heads, widths, max(len(line.label) for line in lines), stacked=False)
    return beside if beside.width <= width else _Layout(heads, widths, 2 * len(_GAP), stacked=True)


def _printed(line: _Line, layout: _Layout) -> Iterator[Text]:
    if layout.stacked:
        yield Text(line.label)
    parts = (f"{text:{side}{one}}" for text, side, one in zip(line.figures, _SIDES, layout.widths, strict=True))
    label = "" if layout.stacked else line.label
    yield Text(_GAP.join([label.ljust(layout.indent), *parts]).rstrip(), "magenta" if line.doubtful else "")


def _with_heading(text: str, heading: str, width: int) -> Text:
    """A text, with a heading of the columns at its right, or below it where it is too long for that."""
    if not heading:
        return Text(text)
    room = width - len(text) - len(heading)
    if room < len(_GAP):
        return Text(f"{text}\n{heading.rjust(width)}")
    return Text(f"{text}{' ' * room}{heading}")
