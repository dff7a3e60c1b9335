"""Tables as data at full precision: tidy CSV, and JSON with the value of each seed."""

import csv
import json
from collections.abc import Iterator, Sequence
from io import StringIO
from typing import Any

from meshfit.measuring.metrics import METRICS, Metric
from meshfit.printable import csv_cell
from meshfit.report.tables.notes import notes
from meshfit.report.tables.paper_numbers import OTHER, READINGS, paper_value, published_value
from meshfit.report.tables.table import Comparison, Row, Table

FIELDS = (
    "table", "experiment", "variant", "metric", "target", "target_title", "scheme",
    "mean", "mean_low", "mean_high", "spread", "median", "count", "seeds", "best", "paper", "paper_other_reading",
    "baseline", "difference", "low", "high", "common_seeds", "significant", "improvement", "seeds_needed",
)  # fmt: skip
_FORMAT_VERSION = 1


def to_csv(tables: Sequence[Table]) -> str:
    """Write one row for each variation, metric, target and scheme, and for each mean difference over the targets.

    Missing values are empty, as is the target of a mean over targets.
    """
    text = StringIO()
    writer = csv.DictWriter(text, FIELDS, restval="", lineterminator="\n")
    writer.writeheader()
    for part in _split(tables):
        writer.writerows({key: csv_cell(value) for key, value in row.items()} for row in _csv_rows(part))
    return text.getvalue()


def _csv_rows(table: Table) -> Iterator[dict[str, object]]:
    (metric,), (variation,) = table.metrics, table.variations
    names = {"table": table.title, "experiment": table.experiment, "variant": variation.variant, "metric": metric}
    comparisons = {(comparison.target, comparison.row): comparison for comparison in table.comparisons}
    for target, title in table.targets.items():
        for row in table.rows:
            place = {"target": target, "target_title": title, "scheme": row.scheme}
            comparison = comparisons.get((target, row))
            yield names | place | _csv_cell(table, target, row) | _csv_comparison(comparison)
    for comparison in table.comparisons:
        if comparison.target is None:
            title = f"mean over {comparison.difference.targets} targets"
            yield names | {"target_title": title, "scheme": comparison.row.scheme} | _csv_comparison(comparison)


def _csv_cell(table: Table, target: str, row: Row) -> dict[str, object]:
    (metric,) = table.metrics
    cell: dict[str, object] = {"count": 0}
    if summary := table.cells.get((metric, target, row)):
        low, high = summary.interval or (None, None)
        cell = {
            "mean": summary.mean,
            "mean_low": low,
            "mean_high": high,
            "spread": summary.spread,
            "median": summary.median,
            "count": summary.count,
            "seeds": " ".join(map(str, sorted(table.samples[metric, target, row]))),
            "best": table.best.get((metric, target)) == row,
        }
    if (paper := published_value(metric, target, row.scheme)) is not None:
        cell |= {"paper": paper, "paper_other_reading": paper_value(target, row.scheme, OTHER)}
    return cell


def _csv_comparison(comparison: Comparison | None) -> dict[str, object]:
    if comparison is None:
        return {}
    difference = comparison.difference
    low, high = difference.interval or (None, None)
    return {
        "baseline": comparison.against.scheme,
        "difference": difference.mean,
        "low": low,
        "high": high,
        "common_seeds": difference.count,
        "significant": difference.significant,
        "improvement": difference.improvement,
        "seeds_needed": difference.seeds_needed,
    }


def to_json(tables: Sequence[Table]) -> str:
    """Write an object whose `tables` has one object for each variation and metric."""
    content = {"schema_version": _FORMAT_VERSION, "tables": [_json_table(part) for part in _split(tables)]}
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _json_table(table: Table) -> dict[str, Any]:
    (name,), (variation,) = table.metrics, table.variations
    comparisons = table.comparisons
    return {
        "title": table.title,
        "experiment": table.experiment,
        "variant": variation.variant,
        "metric": {"name": name, **_json_metric(METRICS[name])},
        "seeds": table.seeds,
        "settings": dict(table.settings),
        "targets": [{"target": target, "title": title} for target, title in table.targets.items()],
        "schemes": table.schemes,
        "baseline": variation.baseline,
        "cells": [_json_cell(table, target, row) for target in table.targets for row in table.rows],
        "differences": [_json_comparison(each) for each in comparisons if each.target is not None],
        "over_targets": [_json_comparison(each) for each in comparisons if each.target is None],
        "best": {target: row.scheme for (_, target), row in table.best.items()},
        "notes": notes(table),
    }


def _json_metric(metric: Metric) -> dict[str, Any]:
    return {"title": metric.title, "unit": metric.unit, "smaller_is_better": metric.smaller_is_better}


def _json_cell(table: Table, target: str, row: Row) -> dict[str, Any]:
    (metric,) = table.metrics
    title, scheme = table.targets[target], row.scheme
    cell: dict[str, Any] = {"target": target, "target_title": title, "scheme": scheme, "count": 0}
    if summary := table.cells.get((metric, target, row)):
        by_seed = {str(seed): value for seed, value in sorted(table.samples[metric, target, row].items())}
        cell |= {"count": summary.count, "mean": summary.mean, "spread": summary.spread}
        cell |= {"median": summary.median, "interval": summary.interval, "values_by_seed": by_seed}
    if published_value(metric, target, scheme) is not None:
        cell["paper"] = {reading: values[target, scheme] for reading, values in READINGS.items()}
    return cell


def _json_comparison(comparison: Comparison) -> dict[str, Any]:
    difference = comparison.difference
    return {
        "target": comparison.target,
        "scheme": comparison.row.scheme,
        "baseline": comparison.against.scheme,
        "difference": difference.mean,
        "interval": difference.interval,
        "count": difference.count,
        "targets": difference.targets,
        "significant": difference.significant,
        "improvement": difference.improvement,
        "seeds_needed": difference.seeds_needed,
    }


def _split(tables: Sequence[Table]) -> Iterator[Table]:
    return (part for table in tables for part in table.split())
