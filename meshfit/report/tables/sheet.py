"""Sheets: result tables arranged as people read them, with several metrics or variations of the settings in one."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from meshfit.report.tables.comparisons import Comparison, Row, best_rows, contrasts_of, rows_of, targets_of
from meshfit.report.tables.grouping import differing_keys, natural_order, variation_names
from meshfit.report.tables.table import ResultTable, title_of
from meshfit.statistics import BySeed, Summary

VARIED = "varied"
"""What stands for a setting that is not the same all over a sheet."""

# Results that differ in these are measured differently, and no table may set them side by side.
_APART = ("normalise", "schema_version")
_APART_BELOW = "measure."


@dataclass(frozen=True)
class Sheet:
    """Result tables shown as one: metrics and targets across, variations and schemes down.

    Attributes:
        title: names of the experiments, and the settings in which the sheet differs from those beside it.
        variations: what each set of settings is called; a single one needs no name, and has none.
        tables: for each variation, a table for each metric.
        contrasts: what is compared, by metric, then target, then row.
        best: by metric and target, the row that differs significantly from every other one, for the better.
    """

    title: str
    variations: tuple[str, ...]
    tables: tuple[tuple[ResultTable, ...], ...]
    contrasts: tuple[Comparison, ...]
    best: Mapping[tuple[str, str], Row]

    @property
    def all_tables(self) -> list[ResultTable]:
        """The tables that it is made of, variation by variation."""
        return [table for same in self.tables for table in same]

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """The metrics, by their dotted names."""
        return tuple(table.metric for table in self.tables[0])

    @cached_property
    def targets(self) -> dict[str, str]:
        """The targets, each with its title."""
        return targets_of(self.tables)

    @cached_property
    def schemes(self) -> tuple[str, ...]:
        """Every scheme that some variation has."""
        return tuple(dict.fromkeys(row.scheme for row in self.rows))

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The rows from top to bottom."""
        return rows_of(self.tables)

    @cached_property
    def seeds(self) -> tuple[int, ...]:
        """Every seed that some cell has."""
        return tuple(sorted({seed for table in self.all_tables for seed in table.seeds}))

    @cached_property
    def settings(self) -> dict[str, Any]:
        """The settings by dotted key; those that differ are `VARIED`."""
        settings = [same[0].settings for same in self.tables]
        return {**settings[0], **dict.fromkeys(differing_keys(settings), VARIED)}

    def sample(self, metric: str, target: str, row: Row) -> BySeed:
        """The values of a cell by seed; empty where there are none."""
        return self._table(metric, row).samples.get((target, row.scheme), {})

    def summary(self, metric: str, target: str, row: Row) -> Summary | None:
        """What a cell states; None where there are no values."""
        return self._table(metric, row).cells.get((target, row.scheme))

    def _table(self, metric: str, row: Row) -> ResultTable:
        return self.tables[row.variation][self.metrics.index(metric)]


def arrange(tables: Sequence[ResultTable], *, planned: bool = False) -> list[Sheet]:
    """Arrange tables as sheets: those of the same settings side by side, variations of an experiment one below another.

    Variations that are measured differently (`normalise`, `measure.*`, the schema version) stay apart.

    Args:
        tables: those of one metric after those of another, as `build_tables` gives them.
        planned: the tables are in the order in which they were planned; otherwise variations are ordered naturally.
    """
    sheets: dict[str, dict[str, list[ResultTable]]] = {}
    for table in tables:
        apart = {key: value for key, value in table.settings.items() if key in _APART or key.startswith(_APART_BELOW)}
        together = sheets.setdefault(json.dumps([table.experiment, apart], sort_keys=True), {})
        together.setdefault(json.dumps(table.settings, sort_keys=True), []).append(table)
    differing = differing_keys([table.settings for table in tables])
    found = []
    for by_settings in sheets.values():
        variations = [tuple(same) for same in by_settings.values()]
        settings = [same[0].settings for same in variations]
        order = range(len(settings)) if planned else natural_order(settings)
        found.append(_sheet([variations[place] for place in order], differing))
    return found


def _sheet(tables: Sequence[tuple[ResultTable, ...]], differing: Sequence[str]) -> Sheet:
    settings = [same[0].settings for same in tables]
    swept = differing_keys(settings)
    names = variation_names(settings, [same[0].variant for same in tables]) if swept else [""]
    first = tables[0][0]
    return Sheet(
        title=title_of(first.experiment, first.settings, [key for key in differing if key not in swept]),
        variations=tuple(names),
        tables=tuple(tables),
        contrasts=contrasts_of(tables),
        best=best_rows(tables),
    )
