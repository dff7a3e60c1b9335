"""The result table: schemes by targets, each cell a summary over seeds; a pure function of results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from meshfit.errors import ConfigError
from meshfit.experiment.statistics import BySeed, Summary, summarise
from meshfit.measuring.metrics import METRICS
from meshfit.report.comparison import Difference, best_on_targets, differences_on_targets, differences_over_targets
from meshfit.report.gather import Cell, Group, Result, gather
from meshfit.report.own_schemes import canonical_among
from meshfit.report.paper import PAPER_TARGETS
from meshfit.report.variations import differing_keys, shown
from meshfit.specs import suggest
from meshfit.subdivision.table import SCHEMES

DEFAULT_METRIC = "hausdorff.symmetric"


@dataclass(frozen=True)
class ResultTable:
    """One table. All its results have the same settings, but for target, scheme and seed.

    Attributes:
        title: names of the experiments, and the settings in which the table differs from those beside it.
        experiment: names of the experiments.
        variant: what its results call these settings; empty where they have no word for them, or several.
        metric: dotted name of the metric.
        settings: the settings that all results share, by dotted key.
        targets: the columns: each target with its title.
        schemes: the rows.
        samples: values by (target, scheme), then by seed.
        cells: their summaries; a cell without values is left out.
        baseline: the scheme that the others are compared with.
        differences: of each target and scheme, from the baseline, where both have a seed in common.
        over_targets: of each scheme, from the baseline, the mean over the targets; none where these are not several.
        best: by target, the scheme that differs significantly from every other one, for the better.
    """

    title: str
    experiment: str
    variant: str
    metric: str
    settings: Mapping[str, Any]
    targets: Mapping[str, str]
    schemes: tuple[str, ...]
    samples: Mapping[Cell, Mapping[int, float]]
    cells: Mapping[Cell, Summary]
    baseline: str
    differences: tuple[Difference, ...]
    over_targets: tuple[Difference, ...]
    best: Mapping[str, str]

    @property
    def seeds(self) -> tuple[int, ...]:
        """Every seed that some cell has."""
        return tuple(sorted({seed for sample in self.samples.values() for seed in sample}))


def build_tables(
    results: Sequence[Result],
    metric: str = DEFAULT_METRIC,
    *,
    baseline: str | None = None,
    schemes: Sequence[str] = (),
    targets: Sequence[str] = (),
) -> list[ResultTable]:
    """The tables of some results: one for each set of settings among them.

    Args:
        results: the contents of `result.json` files.
        metric: a name of `METRICS`.
        baseline: the scheme that the others are compared with; by default each table's first.
        schemes: schemes in the order of the rows; others follow in the order of `SCHEMES`, then of the alphabet.
        targets: targets in the order of the columns; others follow, the paper's first, then by the alphabet.

    Raises:
        ConfigError: no such metric, or a baseline that has no results.
        SchemeError: the baseline is not a scheme.
        StoreError: results that contradict each other.
    """
    require_metric(metric)
    groups = gather(results, metric)
    if baseline is not None:
        baseline = _check_baseline(canonical_among(results, baseline), groups)
    differing = differing_keys([group.settings for group in groups])
    return [_table(group, metric, differing, baseline, (schemes, targets)) for group in groups]


def require_metric(name: str) -> None:
    """Refuse a name that no metric has.

    Raises:
        ConfigError: suggesting the nearest.
    """
    if name not in METRICS:
        raise ConfigError(f"'{name}' is not a metric: {suggest(name, METRICS)}")


def title_of(experiment: str, settings: Mapping[str, Any], keys: Sequence[str]) -> str:
    """The experiment, and those of its settings by which it is told apart."""
    details = ", ".join(f"{key}={shown(settings.get(key))}" for key in keys)
    return f"{experiment} · {details}" if details else experiment


def _table(
    group: Group,
    metric: str,
    differing: Sequence[str],
    baseline: str | None,
    order: tuple[Sequence[str], Sequence[str]],
) -> ResultTable:
    rows = sorted({scheme for _, scheme in group.samples}, key=_ranks(order[0], list(SCHEMES)))
    columns = sorted(group.titles, key=_ranks(order[1], PAPER_TARGETS))
    experiment = " + ".join(group.experiments)
    samples, compared = group.samples, (columns, rows, baseline or rows[0], metric)
    return ResultTable(
        title=title_of(experiment, group.settings, differing),
        experiment=experiment,
        variant=next(iter(group.variants)) if len(group.variants) == 1 else "",
        metric=metric,
        settings=group.settings,
        targets=_titles(columns, group.titles),
        schemes=tuple(rows),
        samples=samples,
        cells={cell: summarise(_in_order(sample)) for cell, sample in samples.items() if sample},
        baseline=baseline or rows[0],
        differences=differences_on_targets(samples, *compared),
        over_targets=differences_over_targets(samples, *compared),
        best=best_on_targets(samples, columns, rows, metric),
    )


def _in_order(sample: BySeed) -> list[float]:
    return [sample[seed] for seed in sorted(sample)]


def _ranks(wanted: Sequence[str], known: Sequence[str]) -> Any:  # noqa: ANN401  a sort key
    def rank(name: str) -> tuple[int, int, str]:
        base = name.partition(":")[0]
        place = wanted.index(name) if name in wanted else len(wanted)
        return place, known.index(base) if base in known else len(known), name

    return rank


def _titles(columns: Sequence[str], titles: Mapping[str, str]) -> dict[str, str]:
    """Titles by target; where two targets share one, the target is added to it."""
    shared = [title for title in titles.values() if list(titles.values()).count(title) > 1]
    return {name: f"{titles[name]} [{name}]" if titles[name] in shared else titles[name] for name in columns}


def _check_baseline(baseline: str, groups: Sequence[Group]) -> str:
    schemes = dict.fromkeys(scheme for group in groups for _, scheme in group.samples)
    if baseline not in schemes:
        raise ConfigError(f"baseline '{baseline}' has no results: {suggest(baseline, schemes)}")
    return baseline
