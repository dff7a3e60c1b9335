"""What is said of differences: how large, how sure, how often a run is better, and how many seeds would tell."""

from meshfit.experiment.power import MOST_SEEDS
from meshfit.experiment.statistics import PairedDifference
from meshfit.measuring.metrics import METRICS
from meshfit.report.contrast import Contrast
from meshfit.report.grid import row_names
from meshfit.report.numbers import difference_and_interval
from meshfit.report.sheet import Sheet


def difference_lines(sheet: Sheet) -> list[str]:
    """A line for each difference; a single one for all, if none of them has an interval."""
    found = sheet.contrasts
    if without_intervals(sheet):
        return ["Differences: one seed, so no interval; several seeds are needed to compare"]
    return [
        f"{_metric(sheet, contrast)}{rivals(sheet, contrast)} {place(sheet, contrast)}: "
        f"{difference_and_interval(contrast.paired)}, {', '.join(_findings(sheet, contrast.paired))}"
        for contrast in found
    ]


def without_intervals(sheet: Sheet) -> bool:
    """Whether there are several differences, and none has an interval, so that there is nothing to say of each."""
    return len(sheet.contrasts) > 1 and all(contrast.paired.interval is None for contrast in sheet.contrasts)


def rivals(sheet: Sheet, contrast: Contrast) -> str:
    """What is compared with what: `interp-loop vs loop`, `edge=0.2 vs edge=0.1 with loop`."""
    first, second = contrast.row, contrast.against
    names = [sheet.variations[row.variation] for row in (first, second)]
    if first.variation != second.variation:
        scheme = "" if row_names(sheet) == ("variation",) else f" with {first.scheme}"
        return f"{names[0]} vs {names[1]}{scheme}"
    return f"{first.scheme} vs {second.scheme}" + (f" at {names[0]}" if names[0] else "")


def place(sheet: Sheet, contrast: Contrast) -> str:
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


def chance(paired: PairedDifference) -> str:
    """The probability of improvement, `0.92`; nothing for single runs, or where neither direction is better."""
    return "" if paired.improvement is None or paired.interval is None else f"{paired.improvement:.2f}"


def seeds_text(paired: PairedDifference) -> str:
    """The number of seeds needed, `3`, or `> 10,000`; nothing where there is no interval, or no difference."""
    if paired.interval is None or paired.mean == 0:
        return ""
    return f"> {MOST_SEEDS:,}" if paired.seeds_needed is None else f"{paired.seeds_needed:,}"


def _metric(sheet: Sheet, contrast: Contrast) -> str:
    return f"{METRICS[contrast.metric].title}: " if len(sheet.metrics) > 1 else ""


def _findings(sheet: Sheet, paired: PairedDifference) -> list[str]:
    better, seeds = chance(paired), seeds_text(paired).replace("> ", "more than ")
    found = [verdict(sheet, paired), f"P(better) {better}" if better else "", f"{seeds} seeds needed" if seeds else ""]
    return [text for text in found if text]
