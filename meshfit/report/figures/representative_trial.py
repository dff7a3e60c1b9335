"""Which trials stand for all: of each target and scheme, the one whose figure is the median over the seeds."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from meshfit.errors import ConfigError
from meshfit.experiment.storage.run_directory import Result
from meshfit.report.tables.comparisons import Row
from meshfit.report.tables.grouping import resolve_scheme, shared_settings, target_key, variation_names
from meshfit.report.tables.table import Table, build_tables
from meshfit.specs import suggest
from meshfit.statistics import median_seed


@dataclass(frozen=True)
class Pick:
    """A trial that stands for those of its target and scheme.

    Attributes:
        scheme: its scheme.
        seed: its seed.
        value: its figure, the median over the seeds.
        seeds: how many seeds there are.
        folder: of the trial.
    """

    scheme: str
    seed: int
    value: float
    seeds: int
    folder: Path


@dataclass(frozen=True)
class TargetPicks:
    """The trials shown for a target.

    Attributes:
        target: its name, or that of its file.
        title: how it is called, with what tells its settings from others in the same figure.
        settings: what its trials have in common, by dotted key.
        picks: one for each scheme.
    """

    target: str
    title: str
    settings: dict[str, object]
    picks: tuple[Pick, ...]


def pick_trials(
    results: Sequence[Result], metric: str, *, targets: Sequence[str] = (), schemes: Sequence[str] = ()
) -> tuple[TargetPicks, ...]:
    """The trials that a figure shows, target by target, and for each of them, settings by settings.

    Args:
        results: with their `folder`, as `read_results` gives them.
        metric: a name of `METRICS`; the median is taken of it.
        targets: those wanted, in this order; by default all.
        schemes: those wanted, in this order; by default all.

    Raises:
        ConfigError: no such metric, or a target or a scheme that no result has.
        SchemeError: what is no scheme.
        StoreError: results that contradict each other.
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
    found = []
    for table, name in zip(tables, _names(tables), strict=True):
        same = [result for result in chosen if shared_settings(result) == table.settings]
        for target, title in table.targets.items():
            called = f"{title} ({name})" if name else title
            found.append(TargetPicks(target, called, dict(table.settings), tuple(_picks(table, target, same))))
    order = list(targets) or list(dict.fromkeys(each.target for each in found))
    shown = tuple(sorted((each for each in found if each.picks), key=lambda each: order.index(each.target)))
    if not shown:
        raise ConfigError(f"no trial that could be shown has a value of {metric}")
    return shown


def _names(tables: Sequence[Table]) -> list[str]:
    """What tells tables apart: the experiment where that does, and else what their settings differ in."""
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


def _picks(table: Table, target: str, results: Sequence[Result]) -> Iterable[Pick]:
    for scheme in table.schemes:
        sample = table.samples.get((table.metrics[0], target, Row(0, scheme)))
        if not sample:
            continue
        seed = median_seed(sample)
        folder = next(
            result["folder"]
            for result in results
            if (target_key(result), result["scheme"], result["seed"]) == (target, scheme, seed)
        )
        yield Pick(scheme, seed, sample[seed], len(sample), Path(folder))


def _require(wanted: Sequence[str], noun: str, there: Iterable[str]) -> None:
    known = dict.fromkeys(there)
    for name in wanted:
        if name not in known:
            raise ConfigError(f"no result has the {noun} '{name}': {suggest(name, known)}")
