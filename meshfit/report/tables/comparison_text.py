"""Comparisons of a table's rows in words."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

from meshfit.report.tables.heads import capitalised, one_scheme
from meshfit.report.tables.numbers import format_difference
from meshfit.report.tables.table import Comparison, Table
from meshfit.statistics import MOST_SEEDS


@dataclass(frozen=True)
class ComparisonText:
    """A comparison in words.

    Attributes:
        label: names the rows, as far as this is not clear from the context.
        difference: the difference and its interval.
        verdict: whether it is significant, and for how many seeds if not all.
        improvement: probability of improvement, `0.92`; empty for single runs, or if neither direction is better.
        seeds_needed: `3`, or `> 10,000`; empty without an interval or a difference.
        comparison: the comparison itself.
    """

    label: str
    difference: str
    verdict: str
    improvement: str
    seeds_needed: str
    comparison: Comparison


@dataclass(frozen=True)
class Section:
    """Comparisons with the same row, or the same kind of row.

    Attributes:
        title: states what is compared, and with what.
        places: comparisons by place: each target, and all targets together.
    """

    title: str
    places: dict[str, list[ComparisonText]]


def without_intervals(table: Table) -> bool:
    """Return whether there are several comparisons, and none has an interval."""
    return len(table.comparisons) > 1 and not any(comparison.difference.interval for comparison in table.comparisons)


def comparison_lines(table: Table) -> list[str]:
    """Return one line for each comparison, or a single line if none has an interval; none unless notes are full."""
    if table.style.notes != "full":
        return []
    if without_intervals(table):
        return ["Differences: one seed only, so no intervals; run several seeds to compare"]
    lines = []
    for comparison in table.comparisons:
        metric = f"{table.metric_title(comparison.metric)}: " if len(table.metrics) > 1 else ""
        place = _place(table, comparison) if comparison.target is None else f"on {_place(table, comparison)}"
        text = _in_words(table, comparison, _versus(table, comparison))
        seeds = text.seeds_needed.replace("> ", "more than ")
        parts = [text.difference, text.verdict]
        parts += [f"P(better) {text.improvement}"] * bool(text.improvement) + [f"{seeds} seeds needed"] * bool(seeds)
        lines.append(f"{metric}{text.label} {place}: {', '.join(parts)}")
    return lines


def sections_of(table: Table) -> list[Section]:
    """Arrange the comparisons in sections: for each metric, schemes with the baseline, then variations."""
    if table.style.notes != "full":
        return []
    sections = []
    for metric, of_metric in groupby(table.comparisons, key=lambda comparison: comparison.metric):
        prefix = f"{capitalised(table.metric_title(metric))}: difference" if len(table.metrics) > 1 else "Difference"
        comparisons = list(of_metric)
        for across in (False, True):
            of_kind = [comparison for comparison in comparisons if comparison.across_variations is across]
            if of_kind:
                ending, label = _ending_and_labels(table, of_kind)
                places: dict[str, list[ComparisonText]] = {}
                for comparison in of_kind:
                    text = _in_words(table, comparison, label(comparison))
                    places.setdefault(_place(table, comparison), []).append(text)
                sections.append(Section(prefix + ending, places))
    return sections


def _in_words(table: Table, comparison: Comparison, label: str) -> ComparisonText:
    difference = comparison.difference
    single, better, seeds = difference.interval is None, difference.improvement, difference.seeds_needed
    verdict = {None: "one seed: no interval", True: "significant", False: "not significant"}[difference.significant]
    if not single and difference.count < len(table.seeds):
        verdict += f" ({difference.count} seeds)"
    return ComparisonText(
        label,
        format_difference(difference),
        verdict,
        improvement="" if single or better is None else f"{better:.2f}",
        seeds_needed="" if single or difference.mean == 0 else f"> {MOST_SEEDS:,}" if seeds is None else f"{seeds:,}",
        comparison=comparison,
    )


def _versus(table: Table, comparison: Comparison) -> str:
    """Name both rows: `interp-loop vs loop`, `edge=0.2 vs edge=0.1 with loop`."""
    first, second = comparison.row, comparison.against
    names = [table.variation_title(row) for row in (first, second)]
    if comparison.across_variations:
        scheme = "" if one_scheme(table) else f" with {table.scheme_title(first.scheme)}"
        return f"{names[0]} vs {names[1]}{scheme}"
    return f"{table.scheme_title(first.scheme)} vs {table.scheme_title(second.scheme)}" + (
        f" at {names[0]}" if names[0] else ""
    )


def _place(table: Table, comparison: Comparison) -> str:
    """Return a target's title, `over 5 targets`, or `over 4 of 5 targets`."""
    if comparison.target is not None:
        return table.targets[comparison.target]
    every, compared = len(table.targets), comparison.difference.targets
    return f"over {every} targets" if compared == every else f"over {compared} of {every} targets"


def _ending_and_labels(table: Table, comparisons: Sequence[Comparison]) -> tuple[str, Callable[[Comparison], str]]:
    """Return the end of a section's title, and a function that labels each comparison by the rest."""
    first = comparisons[0]
    if first.across_variations:
        scheme = f" of {table.scheme_title(first.row.scheme)}" if len(table.schemes) > 1 else ""
        return f"{scheme} from {table.variation_title(first.against)}", lambda each: _variation(table, each)
    if len({each.against.scheme for each in comparisons}) > 1:
        return " from the baseline", lambda each: _versus(table, each)
    if len(table.variations) == 1:
        return f" from {table.scheme_title(first.against.scheme)}", lambda each: table.scheme_title(each.row.scheme)
    ending = f" from {table.scheme_title(first.against.scheme)} at the same settings"
    if len({each.row.scheme for each in comparisons}) == 1:
        return f" of {table.scheme_title(first.row.scheme)}{ending}", lambda each: _variation(table, each)
    return ending, lambda each: f"{_variation(table, each)} · {table.scheme_title(each.row.scheme)}"


def _variation(table: Table, comparison: Comparison) -> str:
    return table.variation_title(comparison.row)
