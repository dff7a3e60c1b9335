"""The representative trial of each target and scheme: the one whose value is the median over the seeds."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from meshfit.errors import ConfigError
from meshfit.experiment.storage.run_directory import Result
from meshfit.report.tables.grouping import resolve_scheme, shared_settings, target_key, variation_names
from meshfit.report.tables.table import Row, Table, build_tables
from meshfit.specs import suggest
from meshfit.statistics import median_seed


@dataclass(frozen=True)
class RepresentativeTrial:
    """The trial shown for a target and a scheme.

    Attributes:
        result: content of its `result.json`, with its `folder`.
        value: its value of the metric, the median over the seeds; None if no trial has a value.
        seeds: number of seeds.
    """

    result: Result
    value: float | None
    seeds: int

    @property
    def scheme(self) -> str:
        """The scheme."""
        return str(self.result["scheme"])

    @property
    def seed(self) -> int:
        """The seed."""
        return int(self.result["seed"])

    @property
    def shortfalls(self) -> tuple[str, ...]:
        """Shortfalls of the result, in words."""
        return tuple(self.result.get("shortfalls", ()))

    @property
    def folder(self) -> Path:
        """The folder of the trial."""
        return Path(self.result["folder"])


def representative(trials: Mapping[int, Result], values: Mapping[int, float]) -> RepresentativeTrial:
    """Return the trial with the median value; the one with the lowest seed if none has a value.

    Args:
        trials: results of one target, scheme and set of settings, by seed.
        values: their values of the metric, by seed; results without a value are left out.
    """
    seed = median_seed(values) if values else min(trials)
    return RepresentativeTrial(trials[seed], values.get(seed), len(values) or len(trials))


class TrialIndex:
    """Results with their `folder`, by settings, target, scheme and seed; of equal ones the first."""

    def __init__(self, results: Iterable[Result]) -> None:
        self._trials: dict[tuple[str, str, str], dict[int, Result]] = {}
        for result in results:
            key = _settings_key(shared_settings(result)), target_key(result), str(result["scheme"])
            self._trials.setdefault(key, {}).setdefault(result["seed"], result)

    def by_seed(self, settings: Mapping[str, object], target: str, scheme: str) -> dict[int, Result]:
        """Return the results of a table cell by seed, in order; empty if there are none."""
        return dict(sorted(self._trials.get((_settings_key(settings), target, scheme), {}).items()))


def _settings_key(settings: Mapping[str, object]) -> str:
    return json.dumps(settings, sort_keys=True)


@dataclass(frozen=True)
class TargetTrials:
    """The representative trials of one target with the same settings.

    Attributes:
        target: the target's name, or that of its file.
        title: its title, with what distinguishes its settings from others in the same figure.
        settings: settings that its trials share, by dotted key.
        trials: one per scheme.
    """

    target: str
    title: str
    settings: Mapping[str, object]
    trials: tuple[RepresentativeTrial, ...]


def select_trials(
    results: Sequence[Result], metric: str, *, targets: Sequence[str] = (), schemes: Sequence[str] = ()
) -> tuple[TargetTrials, ...]:
    """Select the trials of a figure by target, and for each target by settings.

    Args:
        results: results with their `folder`, as returned by `read_results`.
        metric: a name of `METRICS`, whose median is taken.
        targets: the targets in the order of the figure; by default all.
        schemes: the schemes in the order of the figure; by default all.

    Raises:
        ConfigError: there is no such metric, or no result has a given target or scheme.
        SchemeError: a given scheme is not a scheme.
        StoreError: results contradict each other.
    """
    wanted = tuple(resolve_scheme(results, scheme) for scheme in schemes)
    _require(wanted, "scheme", (result["scheme"] for result in results))
    _require(targets, "target", map(target_key, results))
    chosen = [
        result
        for result in results
        if (not wanted or result["scheme"] in wanted) and (not targets or target_key(result) in targets)
    ]
    tables = build_tables(chosen, metric, schemes=wanted, targets=targets)
    index = TrialIndex(chosen)
    selected = [
        TargetTrials(target, f"{title} ({name})" if name else title, table.settings, tuple(_of(table, target, index)))
        for table, name in zip(tables, _table_names(tables), strict=True)
        for target, title in table.targets.items()
    ]
    order = list(targets) or list(dict.fromkeys(group.target for group in selected))
    shown = sorted((group for group in selected if group.trials), key=lambda group: order.index(group.target))
    if not shown:
        raise ConfigError(f"no trial that could be shown has a value of {metric}")
    return tuple(shown)


def _table_names(tables: Sequence[Table]) -> list[str]:
    """Return a label for each table: its experiment if that tells them apart, else the settings that differ."""
    if len(tables) == 1:
        return [""]
    experiments = [table.experiment for table in tables]
    if len(set(experiments)) == len(tables):
        return experiments
    variations = variation_names(
        [table.settings for table in tables], [table.variations[0].variant for table in tables]
    )
    if len(set(experiments)) == 1:
        return variations
    return [f"{table.experiment}, {name}" for table, name in zip(tables, variations, strict=True)]


def _of(table: Table, target: str, index: TrialIndex) -> Iterator[RepresentativeTrial]:
    for scheme in table.schemes:
        if values := table.samples.get((table.metrics[0], target, Row(0, scheme))):
            yield representative(index.by_seed(table.settings, target, scheme), values)


def _require(wanted: Sequence[str], noun: str, available: Iterable[str]) -> None:
    known = dict.fromkeys(available)
    for name in wanted:
        if name not in known:
            raise ConfigError(f"no result has the {noun} '{name}': {suggest(name, known)}")
