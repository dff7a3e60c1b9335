"""What a sheet compares: schemes within a variation, variations with the first one, and the best of each column."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.table import ResultTable, best_of, comparable, over_targets
from meshfit.statistics import BySeed, PairedDifference, paired_difference

Tables = Sequence[Sequence[ResultTable]]
"""For each variation, a table for each metric."""


@dataclass(frozen=True)
class Row:
    """A row of a sheet: a scheme, and the place of the variation that it was run with."""

    variation: int
    scheme: str


@dataclass(frozen=True)
class Comparison:
    """A comparison of two rows: the first one's value minus that of the one it is held against.

    Attributes:
        metric: dotted name of the metric.
        target: the target; None for the mean over targets.
        row: the first row.
        against: the other: the baseline of the same variation; for the baseline itself, that of the first variation.
        paired: the difference.
    """

    metric: str
    target: str | None
    row: Row
    against: Row
    paired: PairedDifference


def rows_of(tables: Tables) -> tuple[Row, ...]:
    """The rows from top to bottom."""
    return tuple(Row(place, scheme) for place, found in enumerate(tables) for scheme in found[0].schemes)


def targets_of(tables: Tables) -> dict[str, str]:
    """Every target that some variation has, with its title."""
    found: dict[str, str] = {}
    for table in (table for same in tables for table in same):
        found = {**found, **{target: title for target, title in table.targets.items() if target not in found}}
    return found


def contrasts_of(tables: Tables) -> tuple[Comparison, ...]:
    """All comparisons, by metric, then target, then row; those over all targets follow those on each."""
    found: list[Comparison] = []
    rows, targets = rows_of(tables), [*targets_of(tables), None]
    for place in range(len(tables[0])):
        of_metric = [
            contrast
            for variation, same in enumerate(tables)
            for contrast in (*_within(variation, same[place]), *_across(variation, same[place], tables[0][place]))
        ]
        found += sorted(of_metric, key=lambda found: (targets.index(found.target), rows.index(found.row)))
    return tuple(found)


def best_rows(tables: Tables) -> dict[tuple[str, str], Row]:
    """By metric and target, the row that differs significantly from every other one, for the better."""
    if len(tables) == 1:
        return {(table.metric, target): Row(0, best) for table in tables[0] for target, best in table.best.items()}
    found = {}
    for place, metric in enumerate(table.metric for table in tables[0]):
        for target in targets_of(tables):
            samples = {row: _sample(tables[row.variation][place], target, row.scheme) for row in rows_of(tables)}
            if (best := best_of(samples, metric)) is not None:
                found[metric, target] = best
    return found


def _within(variation: int, table: ResultTable) -> Iterator[Comparison]:
    for found in (*table.differences, *table.over_targets):
        rows = Row(variation, found.scheme), Row(variation, found.baseline)
        yield Comparison(table.metric, found.target, *rows, found.paired)


def _across(variation: int, table: ResultTable, first: ResultTable) -> Iterator[Comparison]:
    """The baseline, with what it was in the first variation."""
    if variation == 0:
        return
    scheme = first.baseline
    better = METRICS[table.metric].smaller_is_better
    rows = Row(variation, scheme), Row(0, scheme)
    pairs = {target: (_sample(table, target, scheme), _sample(first, target, scheme)) for target in first.targets}
    for target, pair in pairs.items():
        if comparable(pair):
            yield Comparison(table.metric, target, *rows, paired_difference(*pair, smaller_is_better=better))
    if (paired := over_targets(list(pairs.values()), table.metric)) is not None:
        yield Comparison(table.metric, None, *rows, paired)


def _sample(table: ResultTable, target: str, scheme: str) -> BySeed:
    return table.samples.get((target, scheme), {})
