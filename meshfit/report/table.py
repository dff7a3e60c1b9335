"""The result table: schemes by targets, each cell a summary over seeds; a pure function of results."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from meshfit.errors import ConfigError
from meshfit.experiment.statistics import PairedDifference, Summary, paired_difference, summarise
from meshfit.measuring.metrics import METRICS
from meshfit.report.gather import Cell, Group, Result, gather
from meshfit.report.paper import PAPER_TARGETS
from meshfit.specs import suggest
from meshfit.subdivision.choose import canonical
from meshfit.subdivision.table import SCHEMES

DEFAULT_METRIC = "hausdorff.symmetric"


@dataclass(frozen=True)
class Difference:
    """How a scheme differs from the baseline on one target: the scheme's value minus the baseline's."""

    target: str
    scheme: str
    baseline: str
    paired: PairedDifference


@dataclass(frozen=True)
class ResultTable:
    """One table. All its results have the same settings, but for target, scheme and seed.

    Attributes:
        title: names of the experiments, and the settings in which the table differs from those beside it.
        experiment: names of the experiments.
        metric: dotted name of the metric.
        settings: the settings that all results share, by dotted key.
        targets: the columns: each target with its title.
        schemes: the rows.
        samples: values by (target, scheme), then by seed.
        cells: their summaries; a cell without values is left out.
        differences: of each target and scheme, from the baseline, where both have a seed in common.
        best: by target, the scheme that differs significantly from every other one, for the better.
    """

    title: str
    experiment: str
    metric: str
    settings: Mapping[str, Any]
    targets: Mapping[str, str]
    schemes: tuple[str, ...]
    samples: Mapping[Cell, Mapping[int, float]]
    cells: Mapping[Cell, Summary]
    differences: tuple[Difference, ...]
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
        baseline = _check_baseline(canonical(baseline), groups)
    differing = _differing_keys(groups)
    return [_table(group, metric, differing, baseline, (schemes, targets)) for group in groups]


def require_metric(name: str) -> None:
    """Refuse a name that no metric has.

    Raises:
        ConfigError: suggesting the nearest.
    """
    if name not in METRICS:
        raise ConfigError(f"'{name}' is not a metric: {suggest(name, METRICS)}")


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
    details = ", ".join(f"{key}={_plain(group.settings.get(key))}" for key in differing)
    return ResultTable(
        title=f"{experiment} · {details}" if details else experiment,
        experiment=experiment,
        metric=metric,
        settings=group.settings,
        targets=_titles(columns, group.titles),
        schemes=tuple(rows),
        samples=group.samples,
        cells={cell: summarise(_by_seed(sample)) for cell, sample in group.samples.items() if sample},
        differences=_differences(group, columns, rows, baseline or rows[0]),
        best=_best(group, columns, rows, METRICS[metric].smaller_is_better),
    )


def _by_seed(sample: Mapping[int, float]) -> list[float]:
    return [sample[seed] for seed in sorted(sample)]


def _differences(group: Group, columns: Sequence[str], rows: Sequence[str], baseline: str) -> tuple[Difference, ...]:
    def samples(target: str, scheme: str) -> tuple[Mapping[int, float], Mapping[int, float]]:
        return group.samples.get((target, scheme), {}), group.samples.get((target, baseline), {})

    return tuple(
        Difference(target, scheme, baseline, paired_difference(ours, theirs))
        for target in columns
        for scheme in rows
        for ours, theirs in [samples(target, scheme)]
        if scheme != baseline and ours.keys() & theirs.keys()
    )


def _best(
    group: Group,
    columns: Sequence[str],
    rows: Sequence[str],
    smaller_is_better: bool | None,  # noqa: FBT001
) -> dict[str, str]:
    found = {}
    for target in columns if smaller_is_better is not None else ():
        samples = {scheme: sample for scheme in rows if (sample := group.samples.get((target, scheme)))}
        if len(samples) < 2:
            continue
        means = {scheme: summarise(_by_seed(sample)).mean for scheme, sample in samples.items()}
        first = (min if smaller_is_better else max)(means, key=means.__getitem__)
        if all(_differ(samples[first], sample) for scheme, sample in samples.items() if scheme != first):
            found[target] = first
    return found


def _differ(first: Mapping[int, float], second: Mapping[int, float]) -> bool:
    return bool(first.keys() & second.keys()) and paired_difference(first, second).significant is True


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


def _differing_keys(groups: Sequence[Group]) -> list[str]:
    keys = dict.fromkeys(key for group in groups for key in group.settings)
    return [key for key in keys if len({json.dumps(group.settings.get(key)) for group in groups}) > 1]


def _plain(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _check_baseline(baseline: str, groups: Sequence[Group]) -> str:
    schemes = dict.fromkeys(scheme for group in groups for _, scheme in group.samples)
    if baseline not in schemes:
        raise ConfigError(f"baseline '{baseline}' has no results: {suggest(baseline, schemes)}")
    return baseline
