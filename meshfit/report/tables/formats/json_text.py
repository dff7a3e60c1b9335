"""Tables as JSON: everything, down to the value of each seed."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.notes import notes
from meshfit.report.tables.paper_numbers import READINGS, value_beside
from meshfit.report.tables.sheet import Sheet, arrange
from meshfit.report.tables.table import Difference, ResultTable

_VERSION = 1


def to_json(sheets: Sequence[Sheet]) -> str:
    """An object whose `tables` holds one object for each table."""
    tables = [table for sheet in sheets for table in sheet.all_tables]
    content = {"schema_version": _VERSION, "tables": [_table(table) for table in tables]}
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _table(table: ResultTable) -> dict[str, Any]:
    metric = METRICS[table.metric]
    return {
        "title": table.title,
        "experiment": table.experiment,
        "variant": table.variant,
        "metric": {"name": table.metric, "title": metric.title, "smaller_is_better": metric.smaller_is_better},
        "seeds": table.seeds,
        "settings": dict(table.settings),
        "targets": [{"target": target, "title": title} for target, title in table.targets.items()],
        "schemes": table.schemes,
        "baseline": table.baseline,
        "cells": list(_cells(table)),
        "differences": [_difference(difference) for difference in table.differences],
        "over_targets": [_difference(difference) for difference in table.over_targets],
        "best": dict(table.best),
        "notes": notes(arrange([table])[0]),
    }


def _cells(table: ResultTable) -> Iterator[dict[str, Any]]:
    for target, title in table.targets.items():
        for scheme in table.schemes:
            cell: dict[str, Any] = {"target": target, "target_title": title, "scheme": scheme, "count": 0}
            if summary := table.cells.get((target, scheme)):
                values = {str(seed): value for seed, value in sorted(table.samples[target, scheme].items())}
                cell |= {"count": summary.count, "mean": summary.mean, "spread": summary.spread}
                cell |= {"median": summary.median, "interval": summary.interval, "values_by_seed": values}
            if value_beside(table.metric, target, scheme) is not None:
                cell["paper"] = {reading: values[target, scheme] for reading, values in READINGS.items()}
            yield cell


def _difference(difference: Difference) -> dict[str, Any]:
    paired = difference.paired
    return {
        "target": difference.target,
        "scheme": difference.scheme,
        "baseline": difference.baseline,
        "difference": paired.mean,
        "interval": paired.interval,
        "count": paired.count,
        "targets": paired.targets,
        "significant": paired.significant,
        "improvement": paired.improvement,
        "seeds_needed": paired.seeds_needed,
    }
