"""Differences in sections of one kind each, below their targets, as a terminal shows them."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby

from meshfit.measuring.metrics import METRICS
from meshfit.report.contrast import Contrast
from meshfit.report.sheet import Sheet
from meshfit.report.verdicts import place, rivals


@dataclass(frozen=True)
class Section:
    """Differences that have the same thing subtracted, or the same kind of thing.

    Attributes:
        title: what it is, and what it is the difference from.
        places: for each target, and for all together, the differences, each with a label.
    """

    title: str
    places: dict[str, list[tuple[str, Contrast]]]


def sections(sheet: Sheet) -> list[Section]:
    """Of each metric, schemes with the baseline, then variations with the first."""
    found = []
    for metric, of_metric in groupby(sheet.contrasts, key=lambda contrast: contrast.metric):
        about = f"{METRICS[metric].title}: difference" if len(sheet.metrics) > 1 else "Difference"
        contrasts = list(of_metric)
        for across in (False, True):
            some = [one for one in contrasts if (one.row.variation != one.against.variation) is across]
            if some:
                found.append(_section(sheet, about, some))
    return found


def _section(sheet: Sheet, about: str, contrasts: list[Contrast]) -> Section:
    ending, label = _told(sheet, contrasts)
    places: dict[str, list[tuple[str, Contrast]]] = {}
    for contrast in contrasts:
        where = place(sheet, contrast).removeprefix("on ")
        places.setdefault(where, []).append((label(contrast), contrast))
    return Section(f"{about[:1].upper()}{about[1:]}{ending}", places)


def _told(sheet: Sheet, contrasts: list[Contrast]) -> tuple[str, Callable[[Contrast], str]]:
    """What all differences are from, and what remains to be said of each."""
    first = contrasts[0]
    variation = first.against.variation
    if first.row.variation != variation:
        of = f" of {first.row.scheme}" if len(sheet.schemes) > 1 else ""
        return f"{of} from {sheet.variations[variation]}", lambda one: sheet.variations[one.row.variation]
    if len({one.against.scheme for one in contrasts}) > 1:
        return " from the baseline", lambda one: rivals(sheet, one)
    from_baseline = f" from {first.against.scheme}"
    if len(sheet.variations) == 1:
        return from_baseline, lambda one: one.row.scheme
    if len({one.row.scheme for one in contrasts}) == 1:
        ending = f" of {first.row.scheme}{from_baseline} at the same settings"
        return ending, lambda one: sheet.variations[one.row.variation]
    ending = f"{from_baseline} at the same settings"
    return ending, lambda one: f"{sheet.variations[one.row.variation]} · {one.row.scheme}"
