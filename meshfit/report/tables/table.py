"""The table: metrics on targets across, variations and schemes down, with comparisons between the rows."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

from meshfit.errors import ConfigError
from meshfit.experiment.storage.run_directory import Result
from meshfit.measuring.metrics import (
    DEFAULT_METRIC,
    DEFAULT_METRIC_OF_CLOUDS,
    DEFAULT_METRIC_OF_IMAGES,
    METRICS,
    require_metric,
)
from meshfit.report.tables.grouping import (
    Missing,
    Variation,
    differing_keys,
    group_results,
    natural_order,
    resolve_scheme,
    telling_keys,
    title_of,
    variation_names,
)
from meshfit.report.tables.style import Style, parse_labels
from meshfit.specs import suggest
from meshfit.statistics import BySeed, PairedDifference, Summary, differ, mean_difference, mean_of, summarise

VARIED = "varied"
"""Value of a setting that is not the same in all variations of a table."""

# Results that differ in these were measured differently, so no table may show them together.
_MEASURED_BY = ("normalise", "schema_version", "measure.")


@dataclass(frozen=True)
class Row:
    """A row of a table: a scheme, and the index of the variation that it was run in."""

    variation: int
    scheme: str


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


@dataclass(frozen=True)
class Table:
    """A table of results.

    Attributes:
        title: the experiment, and the settings in which the table differs from others.
        metrics: dotted names of the metrics.
        variations: of the settings, from top to bottom.
        style: how it is printed.
    """

    title: str
    metrics: tuple[str, ...]
    variations: tuple[Variation, ...]
    style: Style = field(default_factory=Style)

    @property
    def experiment(self) -> str:
        """Names of the experiments."""
        return self.variations[0].experiment

    @cached_property
    def targets(self) -> dict[str, str]:
        """The title of each target of any variation."""
        targets: dict[str, str] = {}
        for variation in self.variations:
            targets |= {target: title for target, title in variation.targets.items() if target not in targets}
        return {target: self.style.labels.get(target, title) for target, title in targets.items()}

    def scheme_title(self, scheme: str) -> str:
        """Return the name to print for a scheme."""
        return self.style.label(scheme)

    def metric_title(self, metric: str) -> str:
        """Return the name to print for a metric."""
        return self.style.labels.get(metric, METRICS[metric].title)

    def variation_title(self, row: Row) -> str:
        """Return the name to print for the variation of a row; empty if there is only one."""
        return self.style.label(self.variations[row.variation].name)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The rows from top to bottom."""
        return tuple(
            Row(place, scheme) for place, variation in enumerate(self.variations) for scheme in variation.schemes
        )

    @cached_property
    def schemes(self) -> tuple[str, ...]:
        """Every scheme of any variation."""
        return tuple(dict.fromkeys(row.scheme for row in self.rows))

    @cached_property
    def seeds(self) -> tuple[int, ...]:
        """Every seed of any cell, those of missing trials among them."""
        seeds = {seed for sample in self.samples.values() for seed in sample}
        return tuple(sorted(seeds.union(*(self.missing(*cell) for cell in product(self.targets, self.rows)))))

    @cached_property
    def settings(self) -> dict[str, Any]:
        """The settings by dotted key; those that differ are `VARIED`."""
        settings = [variation.settings for variation in self.variations]
        return {**settings[0], **dict.fromkeys(differing_keys(settings), VARIED)}

    @cached_property
    def samples(self) -> dict[tuple[str, str, Row], BySeed]:
        """Values by metric, target and row, then by seed; only where there are values."""
        return {
            (metric, target, row): sample
            for metric in self.metrics
            for target in self.targets
            for row in self.rows
            if (sample := self.variations[row.variation].samples.get((metric, target, row.scheme)))
        }

    @cached_property
    def clouds(self) -> dict[str, Mapping[str, Any]]:
        """Number of points, spacing and kind of normals of each target that is a cloud of points."""
        return {target: cloud for variation in self.variations for target, cloud in variation.clouds.items()}

    @cached_property
    def images(self) -> dict[str, Mapping[str, Any]]:
        """Number of views and of those held out, and what distances are to, of each target that is images."""
        return {target: images for variation in self.variations for target, images in variation.images.items()}

    def shortfalls(self, target: str, row: Row) -> Mapping[int, tuple[str, ...]]:
        """Return what the results of a cell lack of their target, in words, by seed; only where there is something."""
        return self.variations[row.variation].shortfalls.get((target, row.scheme), {})

    def missing(self, target: str, row: Row) -> Mapping[int, Missing]:
        """Return the planned trials of a cell that have no result, by seed; only where there are some."""
        return self.variations[row.variation].missing.get((target, row.scheme), {})

    def planned(self, target: str, row: Row) -> int:
        """Return the number of planned trials of a cell, complete or not."""
        complete = self.variations[row.variation].complete.get((target, row.scheme), frozenset())
        return len(complete) + len(self.missing(target, row))

    @cached_property
    def counts(self) -> dict[str, int]:
        """The number of planned trials by state, the complete ones first."""
        complete = sum(len(seeds) for variation in self.variations for seeds in variation.complete.values())
        cells = (self.missing(*cell) for cell in product(self.targets, self.rows))
        states = Counter(each.state for by_seed in cells for each in by_seed.values())
        return {"complete": complete, **dict(states.most_common())}

    @property
    def num_missing(self) -> int:
        """The number of planned trials without a result."""
        return sum(self.counts.values()) - self.counts["complete"]

    @cached_property
    def cells(self) -> dict[tuple[str, str, Row], Summary]:
        """Summaries of the samples over the seeds."""
        return {cell: summarise([sample[seed] for seed in sorted(sample)]) for cell, sample in self.samples.items()}

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Comparisons of rows with a seed in common, by metric, then target, then row.

        Each scheme is compared with the baseline of its variation, and the first baseline with itself in the other
        variations. The mean over targets, if there are several, follows those on each target.
        """
        comparisons = []
        for metric, target, row in product(self.metrics, (*self.targets, None), self.rows):
            for against in self._compared_with(row):
                pairs = self._pairs(metric, self.targets if target is None else [target], row, against)
                if len(pairs) >= (2 if target is None else 1):
                    difference = mean_difference(pairs, smaller_is_better=METRICS[metric].smaller_is_better)
                    comparisons.append(Comparison(metric, target, row, against, difference))
        return tuple(comparisons)

    def _compared_with(self, row: Row) -> Iterator[Row]:
        baseline, first = self.variations[row.variation].baseline, self.variations[0].baseline
        if row.scheme != baseline:
            yield Row(row.variation, baseline)
        if row.variation > 0 and row.scheme == first:
            yield Row(0, first)

    def _pairs(self, metric: str, targets: Iterable[str], *rows: Row) -> list[tuple[BySeed, BySeed]]:
        """Return the samples of two rows on each target on which they have a seed in common."""
        pairs = []
        for target in targets:
            first, second = (self.samples.get((metric, target, row), {}) for row in rows)
            if first.keys() & second.keys():
                pairs.append((first, second))
        return pairs

    @cached_property
    def best(self) -> dict[tuple[str, str], Row]:
        """By metric and target, the row that is significantly better than every other row, where there is one."""
        best = {}
        for metric, target in product(self.metrics, self.targets):
            column = {row: sample for row in self.rows if (sample := self.samples.get((metric, target, row)))}
            if (row := _best(column, smaller_is_better=METRICS[metric].smaller_is_better)) is not None:
                best[metric, target] = row
        return best

    def split(self) -> list["Table"]:
        """Return a table for each variation and metric."""
        return [
            Table(variation.title, (metric,), (replace(variation, name=""),), self.style)
            for variation in self.variations
            for metric in self.metrics
        ]


def _best(samples: Mapping[Row, BySeed], *, smaller_is_better: bool | None) -> Row | None:
    if smaller_is_better is None or len(samples) < 2:
        return None
    means = {row: mean_of([sample[seed] for seed in sorted(sample)]) for row, sample in samples.items()}
    best = (min if smaller_is_better else max)(means, key=means.__getitem__)
    return best if all(differ(samples[best], samples[row]) for row in samples if row != best) else None


def default_metric(results: Iterable[Result]) -> str:
    """Return the metric of results if none is chosen: from the target to the result, where a target is points.

    Results of images alone whose only shape is the visual hull are judged by their masks.

    Open meshes keep the symmetric distance: it is to their surface, without the spacing of points in it, and an open
    sheet that is fitted by a sheet is to be matched both ways.
    """
    results = list(results)
    if results and all(result.get("images", {}).get("compared_with") == "hull" for result in results):
        return DEFAULT_METRIC_OF_IMAGES
    return DEFAULT_METRIC_OF_CLOUDS if any("cloud" in result for result in results) else DEFAULT_METRIC


def default_metrics(results: Sequence[Result]) -> tuple[str, ...]:
    """Return the metrics of a table if none are chosen: several where vertices of a source have a meaning.

    These are results of registrations, and those whose truth is known. Those of images have the overlap of masks too.
    """
    main, first, last = default_metric(results), list[str](), list[str]()
    if any(result.get("vertex_error") for result in results):
        first, last = ["vertex_error.rms"], ["seconds.fit"]
    elif not any(result.get("register", {}).get("register", "off") != "off" for result in results):
        return _metrics_of_images(results, main)
    return (*first, main, "stretch.p99", "new_defects.crossing_faces", *last)


def _metrics_of_images(results: Sequence[Result], main: str) -> tuple[str, ...]:
    """Return the metrics of masks, after that of distances where they are to more than a visual hull."""
    images = [result["images"] for result in results if "images" in result]
    if not images:
        return (main,)
    distances = len(images) < len(results) or any(facts["compared_with"] != "hull" for facts in images)
    held_out = ("iou.held_out_mean",) if any(facts["held_out"] for facts in images) else ()
    return (*([main] if distances else []), "iou.mean", *held_out)


def build_tables(
    results: Sequence[Result],
    *metrics: str,
    baseline: str | None = None,
    schemes: Sequence[str] = (),
    targets: Sequence[str] = (),
) -> list[Table]:
    """Build a table for each variation of the settings.

    Args:
        results: the contents of `result.json` files.
        metrics: names of `METRICS`; by default `default_metrics` of the results.
        baseline: the scheme that others are compared with; by default the first of each variation.
        schemes: order of the rows, as for `group_results`.
        targets: order of the columns, as for `group_results`.

    Raises:
        ConfigError: no such metric, or a baseline that has no results.
        SchemeError: the baseline is not a scheme.
        StoreError: results that contradict each other.
    """
    metrics = tuple(dict.fromkeys(metrics or default_metrics(results)))
    for metric in metrics:
        require_metric(metric)
    if baseline is not None:
        baseline = resolve_scheme(results, baseline)
        known = dict.fromkeys(result["scheme"] for result in results)
        if baseline not in known:
            raise ConfigError(f"baseline '{baseline}' has no results: {suggest(baseline, known)}")
    variations = group_results(results, metrics, baseline=baseline, schemes=schemes, targets=targets)
    return [Table(variation.title, metrics, (variation,)) for variation in variations]


def merge_tables(tables: Sequence[Table]) -> list[Table]:
    """Merge the tables of an experiment: its variations one below another.

    Variations that are measured differently (`normalise`, `measure.*`, the schema version) stay apart. The others are
    in the order of their plan; where this does not decide, in natural order of the settings.

    Args:
        tables: as `build_tables` returns them.
    """
    groups: dict[str, list[Table]] = {}
    for table in tables:
        measured = {key: value for key, value in table.settings.items() if key.startswith(_MEASURED_BY)}
        groups.setdefault(json.dumps([table.experiment, measured], sort_keys=True), []).append(table)
    telling = telling_keys([table.settings for table in tables])
    return [_merged(group, telling) for group in groups.values()]


def styled(tables: Sequence[Table], style: Style, labels: Iterable[str] = ()) -> list[Table]:
    """Return tables in a style, with labels given as NAME=LABEL.

    Raises:
        ConfigError: a label of something that is in no table.
    """
    known = [
        name
        for table in tables
        for name in (
            *table.schemes,
            *table.targets,
            *table.metrics,
            *filter(None, (variation.name or variation.variant for variation in table.variations)),
        )
    ]
    style = replace(style, labels={**style.labels, **parse_labels(labels, known)})
    return [replace(table, style=style) for table in tables]


def _merged(tables: Sequence[Table], telling: Sequence[str]) -> Table:
    naturally = [tables[number] for number in natural_order([table.settings for table in tables])]
    tables = sorted(naturally, key=lambda table: table.variations[0].place)
    settings = [table.settings for table in tables]
    swept = differing_keys(settings)
    variations = [variation for table in tables for variation in table.variations]
    names = [""] * len(variations)
    if swept:
        names = variation_names(settings, [variation.variant for variation in variations])
    return Table(
        title=title_of(tables[0].experiment, settings[0], [key for key in telling if key not in swept]),
        metrics=tables[0].metrics,
        variations=tuple(replace(variation, name=name) for variation, name in zip(variations, names, strict=True)),
    )
