"""What is said above and below a table: what its numbers are, how schemes differ, and what to bear in mind."""

from collections.abc import Callable, Sequence

from meshfit.measuring.metrics import METRICS
from meshfit.report.grid import columns, shown_paper_value
from meshfit.report.numbers import difference_and_interval
from meshfit.report.paper import LIKELIER, OTHER, paper_value
from meshfit.report.table import Difference, ResultTable

_FRAMES = {
    "tutorial": "the tutorial frame (mean of the target's verts at 0, largest |coordinate| 1)",
    "box": "the box frame (centre of the target's bounding box at 0, its diagonal 1)",
    "none": "the unit of the target's file",
}
_STAND_IN = "stand-in"

# What follows the mark of the best, whichever mark a format has for it.
BEST = "best of its column, and significantly so against each other scheme"


def metric_line(table: ResultTable) -> str:
    """The metric, and what a cell is: `Hausdorff distance (smaller is better): mean ± …`."""
    metric = METRICS[table.metric]
    better = {True: " (smaller is better)", False: " (larger is better)", None: ""}[metric.smaller_is_better]
    seeds = table.seeds
    if len(seeds) == 1:
        return f"{_capital(metric.title)}{better}, one run with seed {seeds[0]}"
    return f"{_capital(metric.title)}{better}, mean ± standard deviation over {len(seeds)} seeds ({_listed(seeds)})"


def setting_lines(table: ResultTable) -> list[str]:
    """The frame of lengths, the fit, the measurement and the source."""
    found = {key: "?" if value is None else value for key, value in table.settings.items()}

    def get(key: str) -> str:
        return str(found.get(key, "?"))

    source = [get("source.mesh"), _count(get("source.levels"), "level")]
    if table.settings.get("source.decimate"):
        source.insert(1, f"decimated to {get('source.decimate')} faces")
    if table.settings.get("source.project", "none") != "none":
        source.append(f"projected to the {get('source.project')}")
    return [
        f"Lengths in {_FRAMES.get(get('normalise'), get('normalise'))}",
        f"Fit: {_fit(get)}; measured on {get('measure.samples')} samples",
        f"Source: {', '.join(source)}",
    ]


def _fit(get: Callable[[str], str]) -> str:
    if get("fit.method") == "gauss-newton":
        return f"gauss-newton, {_count(get('fit.levels'), 'level')}, connectivity {get('fit.connectivity')}"
    return f"{_count(get('fit.steps'), 'step')} of {get('fit.optimizer.name')}, {get('fit.samples')} samples a step"


def difference_lines(table: ResultTable) -> list[str]:
    """A line for each difference; a single one for all, if none of them has an interval."""
    found = table.differences
    if len(found) > 1 and all(difference.paired.interval is None for difference in found):
        return [f"Difference from {found[0].baseline}: one seed, so no interval; several seeds are needed to compare"]
    return [
        f"{difference.scheme} vs {difference.baseline} on {table.targets[difference.target]}: "
        f"{difference_and_interval(difference.paired)}, {verdict(table, difference)}"
        f"{' (interval holds 0)' if difference.paired.significant is False else ''}"
        for difference in found
    ]


def verdict(table: ResultTable, difference: Difference) -> str:
    """`significant` or not, and over how many seeds, if not all."""
    paired = difference.paired
    if paired.significant is None:
        return "one seed: no interval"
    text = "significant" if paired.significant else "not significant"
    return f"{text} ({paired.count} seeds)" if paired.count < len(table.seeds) else text


def notes(table: ResultTable) -> list[str]:
    """What a reader has to know to read the numbers rightly."""
    found = [_few_seeds(table), _intervals(table), *_stand_ins(table), _paper(table)]
    return [note for note in found if note]


def _few_seeds(table: ResultTable) -> str:
    short = [
        f"{scheme} on {title}: {_count(str(len(sample)), 'seed')} ({_listed(sorted(sample))})"
        for scheme in table.schemes
        for target, title in table.targets.items()
        if (sample := table.samples.get((target, scheme))) and len(sample) < len(table.seeds)
    ]
    return f"Fewer seeds: {'; '.join(short)}" if short else ""


def _intervals(table: ResultTable) -> str:
    if all(difference.paired.interval is None for difference in table.differences):
        return ""
    return (
        "Differences are paired by seed, with 95 % bootstrap intervals; one whose interval holds 0 is not significant. "
        "Each is taken by itself: of twenty pairs of equal schemes, one is expected to seem different"
    )


def _stand_ins(table: ResultTable) -> list[str]:
    return [
        f"{title}: made by this project in place of the paper's model, which is not public; "
        "its numbers cannot be compared with the paper's"
        for title in table.targets.values()
        if _STAND_IN in title
    ]


def _paper(table: ResultTable) -> str:
    if not any(column.paper for column in columns(table)):
        return ""
    other = "; ".join(
        f"{target} {scheme} {paper_value(target, scheme, OTHER)}"
        for target in table.targets
        for scheme in table.schemes
        if shown_paper_value(table, target, scheme) is not None
    )
    return (
        "The paper's numbers are those of its Table 1, one run each, its settings not all known. Its columns can be "
        f"read in two ways: shown {LIKELIER}, the likelier; {OTHER} they are {other}"
    )


def _listed(seeds: Sequence[int]) -> str:
    if len(seeds) > 2 and seeds[-1] - seeds[0] == len(seeds) - 1:
        return f"{seeds[0]}–{seeds[-1]}"
    return ", ".join(map(str, seeds))


def _count(number: str, noun: str) -> str:
    return f"{number} {noun}" if number == "1" else f"{number} {noun}s"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
