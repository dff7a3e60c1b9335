"""The expected file: the numbers that a reproduction is checked against, as JSON with strict keys."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, JsonValue

from meshfit.errors import ConfigError
from meshfit.report.tables.numbers import format_number
from meshfit.report.tables.table import ResultTable
from meshfit.settings import Settings, build
from meshfit.statistics import Summary

SCHEMA_VERSION = 1


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
    """The cells of one table, and the metric and settings that they are for."""

    metric: str
    experiment: str
    settings: dict[str, JsonValue]
    cells: Annotated[tuple[ExpectedCell, ...], Field(min_length=1)]


class Expected(Settings):
    """The content of an expected file."""

    schema_version: Literal[1]
    tables: Annotated[tuple[ExpectedTable, ...], Field(min_length=1)]


def read_expected(path: Path) -> Expected:
    """Read an expected file.

    Raises:
        ConfigError: it cannot be read, or a key in it is not as it should be.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; `meshfit expect` writes such files") from error
    except ValueError as error:
        raise ConfigError(f"{path}: not valid JSON: {error}; `meshfit expect` writes such files") from None
    return parse_expected(content, f"{path}: ")


def parse_expected(content: object, where: str = "") -> Expected:
    """The content of an expected file, checked.

    Raises:
        ConfigError: a key in it is not as it should be; the message starts with `where`.
    """
    if not isinstance(content, Mapping):
        raise ConfigError(f"{where}found a {type(content).__name__}, a JSON object is needed")
    return build(Expected, content, lambda _: where)


_SPREADS = 4
_LEAST = 0.02
_ONE_SEED = 0.2
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Deviation:
    """A cell, or a whole table where target and scheme are None, that is not as expected.

    Attributes:
        metric: dotted name of the metric.
        target: the target.
        scheme: the scheme.
        found: the mean found, if there is one.
        expected: the mean expected.
        tolerance: how far apart they may be.
        sentence: what is wrong, for a person to read.
    """

    metric: str
    target: str | None
    scheme: str | None
    found: float | None
    expected: float | None
    tolerance: float | None
    sentence: str

    def __str__(self) -> str:
        """The sentence."""
        return self.sentence


def expectation(tables: Sequence[ResultTable]) -> dict[str, Any]:
    """What to write to an expected file, so that these tables pass and the same run elsewhere does too."""
    return {"schema_version": SCHEMA_VERSION, "tables": [_expected_table(table) for table in tables]}


def tolerance(summary: Summary, noise: float) -> float:
    """How far the mean of a rerun with the same seeds may be from this mean.

    Rounding differs between processors, and thousands of steps let it grow until, at worst, a rerun is a draw of its
    own. The difference of two means of n draws has a standard deviation of spread · sqrt(2/n), and four of these are
    allowed. A spread over few seeds can be small by luck, so the one taken is at least `noise` times the mean. Below
    2 % of the mean, differences say more about libraries than about schemes. One seed has no spread: 20 % are allowed.
    Where no cell of the table has any spread, seeds have no part in its figures, and only rounding may move them.

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


def check(tables: Sequence[ResultTable], expected: Expected | Mapping[str, Any]) -> list[Deviation]:
    """How tables deviate from what is expected; results that nothing is expected of are left alone.

    Args:
        tables: of every metric that is expected; see `Expected.tables`.
        expected: what `read_expected` or `expectation` gives.

    Raises:
        ConfigError: the expected content is malformed.
    """
    wanted = expected if isinstance(expected, Expected) else parse_expected(expected)
    return [deviation for table in wanted.tables for deviation in _check_table(tables, table)]


def _expected_table(table: ResultTable) -> dict[str, Any]:
    relative = [cell.spread / cell.mean for cell in table.cells.values() if cell.spread is not None and cell.mean]
    noise = math.sqrt(sum(value**2 for value in relative) / len(relative)) if relative else 0.0
    cells = [
        {
            "target": target,
            "target_title": table.targets[target],
            "scheme": scheme,
            "mean": cell.mean,
            "spread": cell.spread,
            "seeds": sorted(table.samples[target, scheme]),
            "tolerance": tolerance(cell, noise),
        }
        for (target, scheme), cell in table.cells.items()
    ]
    return {
        "metric": table.metric,
        "experiment": table.experiment,
        "settings": dict(table.settings),
        "cells": cells,
    }


def _check_table(tables: Sequence[ResultTable], wanted: ExpectedTable) -> Iterator[Deviation]:
    candidates = [table for table in tables if table.metric == wanted.metric]
    if not candidates:
        yield _of_table(wanted, "there are no results")
        return
    nearest = min(candidates, key=lambda table: len(_differing(table, wanted)))
    if differing := _differing(nearest, wanted):
        yield _of_table(wanted, f"no results have the settings expected; the nearest have {', '.join(differing)}")
        return
    for cell in wanted.cells:
        if (problem := _problem(nearest, cell)) is not None:
            found = nearest.cells.get((cell.target, cell.scheme))
            sentence = f"{cell.target_title}, {cell.scheme}, {wanted.metric}: {problem}"
            mean = found.mean if found else None
            yield Deviation(wanted.metric, cell.target, cell.scheme, mean, cell.mean, cell.tolerance, sentence)


def _problem(table: ResultTable, cell: ExpectedCell) -> str | None:
    found = table.cells.get((cell.target, cell.scheme))
    allowed = f"expected {format_number(cell.mean)}, give or take {format_number(cell.tolerance)}"
    if found is None:
        return f"found no result, {allowed}"
    seeds = sorted(table.samples[cell.target, cell.scheme])
    if seeds != sorted(cell.seeds):
        return f"found seeds {seeds}, expected {sorted(cell.seeds)}; means over other seeds are not compared"
    if not abs(found.mean - cell.mean) <= cell.tolerance:
        return f"found {format_number(found.mean)}, {allowed}"
    return None


def _of_table(wanted: ExpectedTable, problem: str) -> Deviation:
    return Deviation(wanted.metric, None, None, None, None, None, f"{wanted.experiment}, {wanted.metric}: {problem}")


def _differing(table: ResultTable, wanted: ExpectedTable) -> list[str]:
    keys = dict.fromkeys([*wanted.settings, *table.settings])
    return [
        f"{key} {json.dumps(table.settings.get(key))} instead of {json.dumps(wanted.settings.get(key))}"
        for key in keys
        if table.settings.get(key) != wanted.settings.get(key)
    ]
