"""Comparisons between the rows of a table: schemes with the baseline, variations with the first, the best row."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from meshfit.measuring.metrics import METRICS
from meshfit.statistics import BySeed, PairedDifference, differ, mean_difference


@dataclass(frozen=True)
class Row:
    """A row of a table: a scheme, and the index of the variation that it was run in."""

    variation: int
    scheme: str


Samples = Mapping[tuple[str, str, Row], BySeed]
"""Values by metric, target and row, then by seed; only where there are values."""


@dataclass(frozen=True)
class Comparison:
    """The difference between two rows: the first one's value minus that of the one that it is compared with.

    Attributes:
        metric: dotted name of the metric.
        target: the target; None for the mean over all targets on which the rows can be compared.
        row: the first row.
        against: the other row.
        difference: paired by seed.
    """

    metric: str
    target: str | None
    row: Row
    against: Row
    difference: PairedDifference

    @property
    def across_variations(self) -> bool:
        """Whether variations are compared, and not schemes."""
        return self.row.variation != self.against.variation


def compare(
    samples: Samples, metrics: Sequence[str], targets: Sequence[str], rows: Sequence[Row], baselines: Sequence[str]
) -> tuple[Comparison, ...]:
    """Compare each scheme with the baseline of its variation, and the first baseline with itself in other variations.

    Args:
        samples: of the table.
        metrics: of the table.
        targets: of the table.
        rows: of the table.
        baselines: the scheme that others are compared with, for each variation.

    Returns:
        All comparisons of rows with a seed in common, by metric, then target, then row. The mean over targets, if there
        are several, follows those on each target.
    """
    comparisons = []
    for metric, target, row in product(metrics, (*targets, None), rows):
        for against in _compared_with(row, baselines):
            pairs = _pairs(samples, metric, targets if target is None else [target], row, against)
            if len(pairs) >= (2 if target is None else 1):
                difference = mean_difference(pairs, smaller_is_better=METRICS[metric].smaller_is_better)
                comparisons.append(Comparison(metric, target, row, against, difference))
    return tuple(comparisons)


def best_rows(
    samples: Samples, metrics: Sequence[str], targets: Sequence[str], rows: Sequence[Row]
) -> dict[tuple[str, str], Row]:
    """Return, by metric and target, the row that is significantly better than every other row, where there is one."""
    best = {}
    for metric, target in product(metrics, targets):
        column = {row: samples[metric, target, row] for row in rows if (metric, target, row) in samples}
        if (row := _best(column, smaller_is_better=METRICS[metric].smaller_is_better)) is not None:
            best[metric, target] = row
    return best


def _compared_with(row: Row, baselines: Sequence[str]) -> Iterator[Row]:
    if row.scheme != baselines[row.variation]:
        yield Row(row.variation, baselines[row.variation])
    if row.variation > 0 and row.scheme == baselines[0]:
        yield Row(0, row.scheme)


def _pairs(
    samples: Samples, metric: str, targets: Sequence[str], row: Row, against: Row
) -> list[tuple[BySeed, BySeed]]:
    """Return the samples of two rows on each target on which they have a seed in common."""
    pairs = [(samples.get((metric, target, row), {}), samples.get((metric, target, against), {})) for target in targets]
    return [(first, second) for first, second in pairs if first.keys() & second.keys()]


def _best(samples: Mapping[Row, BySeed], *, smaller_is_better: bool | None) -> Row | None:
    if smaller_is_better is None or len(samples) < 2:
        return None
    means = {row: sum(sample.values()) / len(sample) for row, sample in samples.items()}
    best = (min if smaller_is_better else max)(means, key=means.__getitem__)
    return best if all(differ(samples[best], samples[row]) for row in samples if row != best) else None
