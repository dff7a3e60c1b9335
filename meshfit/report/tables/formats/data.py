"""Tables as data at full precision: tidy CSV, and JSON with the value of each seed."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from io import StringIO
from itertools import chain
from typing import Any

from meshfit.measuring.metrics import METRICS, Metric
from meshfit.printable import csv_cell, printable_json
from meshfit.report.tables.notes import notes
from meshfit.report.tables.paper_numbers import OTHER, READINGS, paper_value, published_value
from meshfit.report.tables.style import Style
from meshfit.report.tables.table import Comparison, Row, Table

FIELDS = (
    "table", "experiment", "variant", "metric", "target", "target_title", "scheme", "scheme_title",
    "mean", "mean_low", "mean_high", "spread", "median", "count", "planned", "missing", "seeds", "best", "shortfalls",
    "paper", "paper_other_reading",
    "baseline", "difference", "low", "high", "common_seeds", "significant", "improvement", "seeds_needed",
)  # fmt: skip
_FORMAT_VERSION = 1
_CELL_FIELDS = {
    "mean": ("mean",),
    "mean-sd": ("mean", "spread"),
    "mean-ci": ("mean", "mean_low", "mean_high", "interval"),
}
_STATISTICS = ("mean", "mean_low", "mean_high", "interval", "spread", "median", "paper", "paper_other_reading")
_COMPARISON_FIELDS = FIELDS[FIELDS.index("baseline") :]


def to_csv(tables: Sequence[Table]) -> str:
    """Write one row for each variation, metric, target and scheme, and for each mean difference over the targets.

    Missing values are empty, as is the target of a mean over targets. The style leaves out columns that it does not
    show, and comparisons unless notes are full.
    """
    text = StringIO()
    hidden = _hidden(tables[0].style) if tables else ()
    fields = [name for name in FIELDS if name not in hidden]
    writer = csv.DictWriter(text, fields, restval="", lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    for part in _split(tables):
        writer.writerows({key: csv_cell(value) for key, value in row.items()} for row in _csv_rows(part))
    return text.getvalue()


def _csv_rows(table: Table) -> Iterator[dict[str, object]]:
    (metric,), (variation,) = table.metrics, table.variations
    names = {"table": table.title, "experiment": table.experiment, "variant": variation.variant, "metric": metric}
    comparisons = {(comparison.target, comparison.row): comparison for comparison in table.comparisons}
    for target, row in _places(table):
        place = {"target": target, "target_title": table.targets[target]}
        place |= {"scheme": row.scheme, "scheme_title": table.scheme_title(row.scheme)}
        comparison = comparisons.get((target, row))
        yield names | place | _csv_cell(table, target, row) | _csv_comparison(comparison)
    if table.style.notes != "full":
        return
    for comparison in table.comparisons:
        if comparison.target is None:
            title = f"mean over {comparison.difference.targets} targets"
            scheme = comparison.row.scheme
            place = {"target_title": title, "scheme": scheme, "scheme_title": table.scheme_title(scheme)}
            yield names | place | _csv_comparison(comparison)


def _hidden(style: Style) -> set[str]:
    """Return the fields that a style leaves out."""
    shown = _CELL_FIELDS.get(style.cells, _STATISTICS)
    return set(_STATISTICS).difference(shown).union(() if style.notes == "full" else _COMPARISON_FIELDS)


def _places(table: Table) -> Iterator[tuple[str, Row]]:
    """Targets and rows in the order in which the table is read."""
    if table.style.transpose:
        return ((target, row) for row in table.rows for target in table.targets)
    return ((target, row) for target in table.targets for row in table.rows)


def _rounded(table: Table, value: float) -> float:
    digits = table.style.digits
    return value if digits is None else float(f"{value:.{digits - 1}e}")


def _csv_cell(table: Table, target: str, row: Row) -> dict[str, object]:
    (metric,) = table.metrics
    missing = table.missing(target, row)
    cell: dict[str, object] = {
        "count": 0,
        "planned": table.planned(target, row),
        "missing": "; ".join(f"seed {seed}: {each.state}" for seed, each in missing.items()),
    }
    if summary := table.cells.get((metric, target, row)):
        low, high = summary.interval or (None, None)
        numbers = {
            "mean": summary.mean,
            "mean_low": low,
            "mean_high": high,
            "spread": summary.spread,
            "median": summary.median,
        }
        cell |= {
            **{name: None if value is None else _rounded(table, value) for name, value in numbers.items()},
            "count": summary.count,
            "seeds": " ".join(map(str, sorted(table.samples[metric, target, row]))),
            "best": table.best.get((metric, target)) == row,
            "shortfalls": "; ".join(dict.fromkeys(chain(*table.shortfalls(target, row).values()))),
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
    return printable_json(content)


def _json_table(table: Table) -> dict[str, Any]:
    (name,), (variation,) = table.metrics, table.variations
    comparisons = table.comparisons if table.style.notes == "full" else ()
    return {
        "title": table.title,
        "experiment": table.experiment,
        "variant": variation.variant,
        "metric": {"name": name, **_json_metric(METRICS[name]), "title": table.metric_title(name)},
        "seeds": table.seeds,
        "trials": {"planned": sum(table.counts.values()), **table.counts},
        "settings": dict(table.settings),
        "targets": [{"target": target, "title": title} for target, title in table.targets.items()],
        "schemes": table.schemes,
        "scheme_titles": {scheme: table.scheme_title(scheme) for scheme in table.schemes},
        "baseline": variation.baseline,
        "cells": [_json_cell(table, target, row) for target, row in _places(table)],
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
    cell["planned"] = table.planned(target, row)
    if missing := table.missing(target, row):
        cell["missing"] = {str(seed): asdict(each) for seed, each in missing.items()}
    if summary := table.cells.get((metric, target, row)):
        by_seed = {str(seed): value for seed, value in sorted(table.samples[metric, target, row].items())}
        interval = summary.interval and [_rounded(table, bound) for bound in summary.interval]
        spread = None if summary.spread is None else _rounded(table, summary.spread)
        cell |= {"count": summary.count, "mean": _rounded(table, summary.mean), "spread": spread}
        cell |= {"median": _rounded(table, summary.median), "interval": interval, "values_by_seed": by_seed}
        cell["shortfalls"] = {str(seed): list(texts) for seed, texts in table.shortfalls(target, row).items()}
    if published_value(metric, target, scheme) is not None:
        cell["paper"] = {reading: values[target, scheme] for reading, values in READINGS.items()}
    return {name: value for name, value in cell.items() if name not in _hidden(table.style)}


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
