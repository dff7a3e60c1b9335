"""What is compared in a result table: schemes with the baseline, on each target and over all, and the best of them."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from meshfit.errors import ConfigError
from meshfit.experiment.storage.run_directory import Result
from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.grouping import Cell, Group, differing_keys, group_results, resolve_scheme, setting_text
from meshfit.report.tables.paper_numbers import PAPER_TARGETS
from meshfit.specs import suggest
from meshfit.statistics import BySeed, PairedDifference, Summary, differ, mean_difference, paired_difference, summarise
from meshfit.subdivision.registry import SCHEMES

_Name = TypeVar("_Name", bound=Hashable)
_Samples = Mapping[Cell, BySeed]


@dataclass(frozen=True)
class Difference:
    """How a scheme differs from the baseline: the scheme's value minus the baseline's.

    Attributes:
        target: the target; None for the mean over all targets that both schemes have.
        scheme: the scheme.
        baseline: what it is compared with.
        paired: the difference.
    """

    target: str | None
    scheme: str
    baseline: str
    paired: PairedDifference


def differences_on_targets(
    samples: _Samples, targets: Sequence[str], schemes: Sequence[str], baseline: str, metric: str
) -> tuple[Difference, ...]:
    """Of each target and scheme, from the baseline, where both have a seed in common."""
    better = METRICS[metric].smaller_is_better
    return tuple(
        Difference(target, scheme, baseline, paired_difference(*pair, smaller_is_better=better))
        for target in targets
        for scheme in schemes
        if scheme != baseline and comparable(pair := (_at(samples, target, scheme), _at(samples, target, baseline)))
    )


def differences_over_targets(
    samples: _Samples, targets: Sequence[str], schemes: Sequence[str], baseline: str, metric: str
) -> tuple[Difference, ...]:
    """Of each scheme, from the baseline, over the targets on which they can be compared, if these are several."""
    found = []
    for scheme in schemes:
        pairs = [(_at(samples, target, scheme), _at(samples, target, baseline)) for target in targets]
        paired = None if scheme == baseline else over_targets(pairs, metric)
        if paired is not None:
            found.append(Difference(None, scheme, baseline, paired))
    return tuple(found)


def over_targets(pairs: Sequence[tuple[BySeed, BySeed]], metric: str) -> PairedDifference | None:
    """The mean difference over the targets on which samples can be compared; None where these are not several."""
    able = [pair for pair in pairs if comparable(pair)]
    return mean_difference(able, smaller_is_better=METRICS[metric].smaller_is_better) if len(able) > 1 else None


def comparable(pair: tuple[BySeed, BySeed]) -> bool:
    """Whether two samples have a seed in common."""
    return not pair[0].keys().isdisjoint(pair[1].keys())


def best_of(samples: Mapping[_Name, BySeed], metric: str) -> _Name | None:
    """The one of several samples that differs significantly from every other one, for the better; None without one."""
    smaller_is_better = METRICS[metric].smaller_is_better
    means = {name: sum(sample.values()) / len(sample) for name, sample in samples.items() if sample}
    if smaller_is_better is None or len(means) < 2:
        return None
    first = (min if smaller_is_better else max)(means, key=means.__getitem__)
    return first if all(differ(samples[first], samples[name]) for name in means if name != first) else None


def best_on_targets(samples: _Samples, targets: Sequence[str], schemes: Sequence[str], metric: str) -> dict[str, str]:
    """By target, the scheme that is the best; targets without one are left out."""
    found = {target: best_of({name: _at(samples, target, name) for name in schemes}, metric) for target in targets}
    return {target: scheme for target, scheme in found.items() if scheme is not None}


def _at(samples: _Samples, target: str, scheme: str) -> BySeed:
    return samples.get((target, scheme), {})


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
    groups = group_results(results, metric)
    if baseline is not None:
        baseline = _check_baseline(resolve_scheme(results, baseline), groups)
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
    details = ", ".join(f"{key}={setting_text(settings.get(key))}" for key in keys)
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
