"""Expected values: a JSON file of numbers that a reproduction is checked against."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, JsonValue

from meshfit.errors import ConfigError
from meshfit.report.tables.numbers import format_number
from meshfit.report.tables.table import Row, Table
from meshfit.settings import Settings, build
from meshfit.statistics import Summary

_FORMAT_VERSION = 1

# Tolerances, of which `tolerance` gives the reasons.
_SPREADS = 4
_LEAST = 0.02
_ONE_SEED = 0.2
_ROUNDING = 1e-6


class ExpectedCell(Settings):
    """The mean of one cell."""

    target: str
    target_title: str
    scheme: str
    mean: float
    spread: Annotated[float, Field(ge=0)] | None
    seeds: Annotated[tuple[int, ...], Field(min_length=1)]
    tolerance: Annotated[float, Field(ge=0)]


class ExpectedTable(Settings):
    """The cells of one metric and variation of the settings."""

    metric: str
    experiment: str
    settings: dict[str, JsonValue]
    cells: Annotated[tuple[ExpectedCell, ...], Field(min_length=1)]


class Expected(Settings):
    """The content of a file of expected values."""

    schema_version: Literal[1]
    tables: Annotated[tuple[ExpectedTable, ...], Field(min_length=1)]


def read_expected(path: Path) -> Expected:
    """Read a file of expected values.

    Raises:
        ConfigError: it cannot be read, or a key is invalid.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; `meshfit expect` writes such files") from error
    except ValueError as error:
        raise ConfigError(f"{path}: not valid JSON: {error}; `meshfit expect` writes such files") from None
    return parse_expected(content, f"{path}: ")


def parse_expected(content: object, where: str = "") -> Expected:
    """Validate the content of a file of expected values.

    Raises:
        ConfigError: a key is invalid; the message starts with `where`.
    """
    if not isinstance(content, Mapping):
        raise ConfigError(f"{where}expected a JSON object, got a {type(content).__name__}")
    return build(Expected, content, lambda _: where)


@dataclass(frozen=True)
class Deviation:
    """A cell that is not as expected, or a whole table, for which target and scheme are None.

    Attributes:
        metric: dotted name of the metric.
        target: the target.
        scheme: the scheme.
        found: the mean found, if there is one.
        expected: the mean expected.
        tolerance: largest allowed difference of the means.
        message: states the deviation.
    """

    metric: str
    target: str | None
    scheme: str | None
    found: float | None
    expected: float | None
    tolerance: float | None
    message: str

    def __str__(self) -> str:
        """Return the message."""
        return self.message


def expectation(tables: Sequence[Table]) -> dict[str, Any]:
    """Return the content of a file of expected values that these tables, and reruns on other machines, meet.

    Args:
        tables: as `build_tables` returns them.
    """
    metrics = dict.fromkeys(metric for table in tables for metric in table.metrics)
    expected = [_expected_table(table, metric) for metric in metrics for table in tables]
    return {"schema_version": _FORMAT_VERSION, "tables": expected}


def tolerance(summary: Summary, noise: float) -> float:
    """Return how far the mean of a rerun with the same seeds may be from this mean.

    Rounding differs between processors, and thousands of steps let it grow until, at worst, a rerun is a draw of its
    own. The difference of two means of n draws has a standard deviation of spread · sqrt(2/n); four of these are
    allowed. A spread over few seeds can be small by chance, so at least `noise` times the mean is taken. Differences
    below 2 % of the mean tell more about libraries than about schemes, and are allowed. One seed has no spread: 20 %
    are allowed. If no cell of the table has any spread, seeds do not affect it, and only rounding may.

    Args:
        summary: of the cell.
        noise: root mean square, over the cells of the table, of spread / mean.
    """
    mean = abs(summary.mean)
    if summary.spread is None:
        return _ONE_SEED * mean
    if summary.spread == noise == 0:
        return _ROUNDING * mean
    spread = max(summary.spread, noise * mean)
    return max(_SPREADS * spread * math.sqrt(2 / summary.count), _LEAST * mean)


def check(tables: Sequence[Table], expected: Expected | Mapping[str, Any]) -> list[Deviation]:
    """Return all deviations of tables from expected values; results without expected values are ignored.

    Args:
        tables: as `build_tables` returns them, with every expected metric.
        expected: as `read_expected` or `expectation` returns it.

    Raises:
        ConfigError: the expected values are malformed.
    """
    checked = expected if isinstance(expected, Expected) else parse_expected(expected)
    return [deviation for table in checked.tables for deviation in _check_table(tables, table)]


def _expected_table(table: Table, metric: str) -> dict[str, Any]:
    (variation,) = table.variations
    cells = {
        (target, scheme): table.cells[metric, target, Row(0, scheme)]
        for of, target, scheme in variation.samples
        if of == metric
    }
    relative = [cell.spread / cell.mean for cell in cells.values() if cell.spread is not None and cell.mean]
    noise = math.sqrt(sum(value**2 for value in relative) / len(relative)) if relative else 0.0
    return {
        "metric": metric,
        "experiment": table.experiment,
        "settings": dict(table.settings),
        "cells": [
            {
                "target": target,
                "target_title": table.targets[target],
                "scheme": scheme,
                "mean": cell.mean,
                "spread": cell.spread,
                "seeds": sorted(variation.samples[metric, target, scheme]),
                "tolerance": tolerance(cell, noise),
            }
            for (target, scheme), cell in cells.items()
        ],
    }


def _check_table(tables: Sequence[Table], expected: ExpectedTable) -> Iterator[Deviation]:
    metric = expected.metric
    candidates = [table for table in tables if metric in table.metrics]
    if not candidates:
        yield _of_table(expected, "there are no results")
        return
    nearest = min(candidates, key=lambda table: len(_differing(table, expected)))
    if differing := _differing(nearest, expected):
        yield _of_table(expected, f"no results have the expected settings; the nearest have {', '.join(differing)}")
        return
    for cell in expected.cells:
        if (problem := _problem(nearest, metric, cell)) is not None:
            found = nearest.cells.get((metric, cell.target, Row(0, cell.scheme)))
            message = f"{cell.target_title}, {cell.scheme}, {metric}: {problem}"
            mean = found.mean if found else None
            yield Deviation(metric, cell.target, cell.scheme, mean, cell.mean, cell.tolerance, message)


def _problem(table: Table, metric: str, cell: ExpectedCell) -> str | None:
    place = metric, cell.target, Row(0, cell.scheme)
    found = table.cells.get(place)
    allowed = f"expected {format_number(cell.mean)} ± {format_number(cell.tolerance)}"
    if found is None:
        return f"found no result, {allowed}"
    seeds = sorted(table.samples[place])
    if seeds != sorted(cell.seeds):
        return f"found seeds {seeds}, expected {sorted(cell.seeds)}; means over other seeds are not compared"
    if not abs(found.mean - cell.mean) <= cell.tolerance:
        return f"found {format_number(found.mean)}, {allowed}"
    return None


def _of_table(expected: ExpectedTable, problem: str) -> Deviation:
    message = f"{expected.experiment}, {expected.metric}: {problem}"
    return Deviation(expected.metric, None, None, None, None, None, message)


def _differing(table: Table, expected: ExpectedTable) -> list[str]:
    keys = dict.fromkeys([*expected.settings, *table.settings])
    return [
        f"{key} {json.dumps(table.settings.get(key))} instead of {json.dumps(expected.settings.get(key))}"
        for key in keys
        if table.settings.get(key) != expected.settings.get(key)
    ]
