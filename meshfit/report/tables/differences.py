"""What is said of differences: how large, how sure, how often a run is better, and how many seeds would tell."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby

from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.comparisons import Comparison
from meshfit.report.tables.layout import row_names
from meshfit.report.tables.numbers import format_difference
from meshfit.report.tables.sheet import Sheet
from meshfit.statistics import MOST_SEEDS, PairedDifference


def difference_lines(sheet: Sheet) -> list[str]:
    """A line for each difference; a single one for all, if none of them has an interval."""
    found = sheet.contrasts
    if without_intervals(sheet):
        return ["Differences: one seed, so no interval; several seeds are needed to compare"]
    return [
        f"{_metric(sheet, contrast)}{rivals(sheet, contrast)} {place(sheet, contrast)}: "
        f"{format_difference(contrast.paired)}, {', '.join(_findings(sheet, contrast.paired))}"
        for contrast in found
    ]


def without_intervals(sheet: Sheet) -> bool:
    """Whether there are several differences, and none has an interval, so that there is nothing to say of each."""
    return len(sheet.contrasts) > 1 and all(contrast.paired.interval is None for contrast in sheet.contrasts)


def rivals(sheet: Sheet, contrast: Comparison) -> str:
    """What is compared with what: `interp-loop vs loop`, `edge=0.2 vs edge=0.1 with loop`."""
    first, second = contrast.row, contrast.against
    names = [sheet.variations[row.variation] for row in (first, second)]
    if first.variation != second.variation:
        scheme = "" if row_names(sheet) == ("variation",) else f" with {first.scheme}"
        return f"{names[0]} vs {names[1]}{scheme}"
    return f"{first.scheme} vs {second.scheme}" + (f" at {names[0]}" if names[0] else "")


def place(sheet: Sheet, contrast: Comparison) -> str:
    """Where: `on bunny`, or `over 2 targets`."""
    if contrast.target is not None:
        return f"on {sheet.targets[contrast.target]}"
    return f"over {targets_counted(sheet, contrast.paired)}"


def targets_counted(sheet: Sheet, paired: PairedDifference) -> str:
    """`5 targets`, or `4 of 5 targets`."""
    every = len(sheet.targets)
    return f"{every} targets" if paired.targets == every else f"{paired.targets} of {every} targets"


def verdict(sheet: Sheet, paired: PairedDifference) -> str:
    """`significant` or not, and over how many seeds, if not all."""
    if paired.significant is None:
        return "one seed: no interval"
    text = "significant" if paired.significant else "not significant"
    return f"{text} ({paired.count} seeds)" if paired.count < len(sheet.seeds) else text


def improvement_text(paired: PairedDifference) -> str:
    """The probability of improvement, `0.92`; nothing for single runs, or where neither direction is better."""
    return "" if paired.improvement is None or paired.interval is None else f"{paired.improvement:.2f}"


def seeds_text(paired: PairedDifference) -> str:
    """The number of seeds needed, `3`, or `> 10,000`; nothing where there is no interval, or no difference."""
    if paired.interval is None or paired.mean == 0:
        return ""
    return f"> {MOST_SEEDS:,}" if paired.seeds_needed is None else f"{paired.seeds_needed:,}"


def _metric(sheet: Sheet, contrast: Comparison) -> str:
    return f"{METRICS[contrast.metric].title}: " if len(sheet.metrics) > 1 else ""


def _findings(sheet: Sheet, paired: PairedDifference) -> list[str]:
    better, seeds = improvement_text(paired), seeds_text(paired).replace("> ", "more than ")
    found = [verdict(sheet, paired), f"P(better) {better}" if better else "", f"{seeds} seeds needed" if seeds else ""]
    return [text for text in found if text]


@dataclass(frozen=True)
class Section:
    """Differences that have the same thing subtracted, or the same kind of thing.

    Attributes:
        title: what it is, and what it is the difference from.
        places: for each target, and for all together, the differences, each with a label.
    """

    title: str
    places: dict[str, list[tuple[str, Comparison]]]


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


def _section(sheet: Sheet, about: str, contrasts: list[Comparison]) -> Section:
    ending, label = _told(sheet, contrasts)
    places: dict[str, list[tuple[str, Comparison]]] = {}
    for contrast in contrasts:
        where = place(sheet, contrast).removeprefix("on ")
        places.setdefault(where, []).append((label(contrast), contrast))
    return Section(f"{about[:1].upper()}{about[1:]}{ending}", places)


def _told(sheet: Sheet, contrasts: list[Comparison]) -> tuple[str, Callable[[Comparison], str]]:
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
