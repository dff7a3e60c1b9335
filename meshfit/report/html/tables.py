"""The tables of the page as text: results, differences, settings, trials, failures and machines."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from meshfit.experiment.status.scan import SCANNED_STATUSES, ScannedExperiment
from meshfit.experiment.storage.failure import read_failure
from meshfit.experiment.storage.run_directory import Result
from meshfit.experiment.trial_status import TrialStatus
from meshfit.experiment.tuning.search_file import Search
from meshfit.measuring.metrics import METRICS
from meshfit.report.figures.representative_trial import TrialIndex
from meshfit.report.html.target_section import row_title, short_titles, trials_by_row
from meshfit.report.tables.comparison_text import Section, comparison_lines, sections_of, without_intervals
from meshfit.report.tables.grouping import describe_definitions, differing_keys, setting_text
from meshfit.report.tables.heads import head_lines, setting_lines
from meshfit.report.tables.layout import columns_of, row_groups, row_names
from meshfit.report.tables.notes import best_note, fewer_note, not_significant_note, notes, shortfall_note
from meshfit.report.tables.numbers import format_number
from meshfit.report.tables.search import search_heads, search_notes, search_rows, search_title
from meshfit.report.tables.table import VARIED, Row, Table
from meshfit.statistics import PairedDifference
from meshfit.units import duration_text, size_text

_WHISKER_MARGIN = 4.0


@dataclass(frozen=True)
class Whisker:
    """Positions of zero, of the mean and of the ends of its interval, in percent of the width."""

    zero: float
    mean: float
    low: float
    high: float


def result_table(table: Table, title: str) -> dict[str, Any]:
    """Return the texts of a result table for the template."""
    shown = columns_of(table)
    cells = list(zip(*(column.cells for column in shown), strict=True))
    rows = [
        (heading, [{"place": place, "label": label, "cells": cells[place]} for place, label in group])
        for heading, group in row_groups(table)
    ]
    alone = without_intervals(table)
    return {
        "title": title,
        "about": ". ".join(head_lines(table)) + ".",
        "settings": setting_lines(table),
        "first": row_names(table)[-1],
        "heads": [(column.heading, column.paper) for column in shown],
        "groups": rows,
        "sections": [] if alone else [_difference_table(section) for section in sections_of(table)],
        "lines": comparison_lines(table) if alone else [],
        "best": best_note(table),
        "alike": not_significant_note(table),
        "short": shortfall_note(table) if table.style.notes != "none" else "",
        "fewer": fewer_note(table) if table.style.notes != "none" else "",
        "notes": notes(table),
    }


def _difference_table(section: Section) -> dict[str, Any]:
    """Return the texts of a section of differences; all of its whiskers share an axis."""
    differences = [text.comparison.difference for texts in section.places.values() for text in texts]
    drawn = iter(whiskers(differences))
    places = [(place, [(text, next(drawn)) for text in texts]) for place, texts in section.places.items()]
    return {"title": section.title, "places": places}


def whiskers(paired: Sequence[PairedDifference]) -> list[Whisker | None]:
    """Place differences on one axis that contains all of them, and zero; None for those without an interval."""
    ends = [0.0, *(end for difference in paired if difference.interval is not None for end in difference.interval)]
    low, high = min(ends), max(ends)
    width = (high - low) or 1.0

    def position(value: float) -> float:
        return round(_WHISKER_MARGIN + (100 - 2 * _WHISKER_MARGIN) * (value - low) / width, 2)

    return [
        None
        if difference.interval is None
        else Whisker(position(0.0), *map(position, (difference.mean, *difference.interval)))
        for difference in paired
    ]


@dataclass(frozen=True)
class Grid:
    """A plain table of texts."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def search_table(title: str, search: Search) -> dict[str, Any]:
    """Return the texts of a search for the template."""
    rows = search_rows(search)
    heads = search_heads(search)
    # A grid begins with what names its rows.
    grid = Grid((heads[-1], *heads[:-1]), tuple((row[-1], *row[:-1]) for row in rows))
    return {"title": title, "about": search_title(search), "grid": grid, "notes": list(search_notes(search))}


def differing_settings(tables: Sequence[Table]) -> Grid:
    """Return the settings in which results differ, by variation of each table; no rows if all are equal."""
    settings = [variation.settings for table in tables for variation in table.variations]
    names = [
        " · ".join(filter(None, (title if len(tables) > 1 else "", table.style.label(variation.name))))
        for table, title in zip(tables, short_titles(tables), strict=True)
        for variation in table.variations
    ]
    keys = differing_keys(settings)
    rows = tuple((key, *(setting_text(values[key]) if key in values else "" for values in settings)) for key in keys)
    return Grid(("setting", *names), rows)


def shared_by_all(tables: Sequence[Table]) -> Grid:
    """Return the settings that all results share."""
    settings = [table.settings for table in tables]
    differing = {*differing_keys(settings), *(key for values in settings for key in values if values[key] == VARIED)}
    first = settings[0] if settings else {}
    return Grid(("setting", "value"), tuple((key, setting_text(first[key])) for key in first if key not in differing))


def definitions_grid(results: Sequence[Result]) -> Grid:
    """Return the definitions of custom schemes; no rows if there are none."""
    return Grid(("scheme", "definition"), tuple(describe_definitions(results).items()))


def trials_grid(tables: Sequence[Table], results: Sequence[Result]) -> Grid:
    """Return every value of every trial, by table, target, row and seed."""
    index = TrialIndex(results)
    metrics = {metric: table.metric_title(metric) for table in tables for metric in table.metrics}
    rows = [
        (
            table.targets[target],
            row_title(table, table.rows[place]),
            str(seed),
            *(_value(table, metric, target, table.rows[place], seed) for metric in metrics),
            f"{_seconds(result, 'fit'):.3g}",
            str(result["folder"]),
        )
        for table in tables
        for target in table.targets
        for place, by_seed in trials_by_row(table, target, index).items()
        for seed, result in by_seed.items()
    ]
    return Grid(("target", "row", "seed", *metrics.values(), "seconds of the fit", "folder"), tuple(rows))


def failures_grid(experiments: Sequence[ScannedExperiment]) -> Grid:
    """Return the failed trials with their errors."""
    failed = [trial for experiment in experiments for trial in experiment.of(TrialStatus.FAILED)]
    rows = [
        (
            trial.label,
            failure.kind,
            "" if failure.step is None else f"{failure.step:,}",
            failure.message,
            str(failure.path),
        )
        for trial, failure in ((trial, read_failure(trial.path)) for trial in failed)
    ]
    return Grid(("trial", "kind", "step", "message", "details in"), tuple(rows))


def states_grid(experiments: Sequence[ScannedExperiment]) -> Grid:
    """Return the number of trials of each experiment in each state that occurs."""
    states = [state for state in SCANNED_STATUSES if any(experiment.counts[state] for experiment in experiments)]
    rows = [(experiment.name, *(f"{experiment.counts[state]:,}" for state in states)) for experiment in experiments]
    return Grid(("experiment", *states), tuple(rows))


def machines_grid(results: Sequence[Result]) -> Grid:
    """Return the versions and machines of the results, with time and memory; one column per combination."""
    machines: dict[tuple[tuple[str, str], ...], list[Result]] = {}
    for result in results:
        machines.setdefault(_made_with(result), []).append(result)
    names = dict.fromkeys(name for machine in machines for name, _ in machine)
    rows = [(name, *(dict(machine).get(name, "") for machine in machines)) for name in names]
    summaries = {
        "trials": lambda group: f"{len(group):,}",
        "seconds per fit": lambda group: _range_text([_seconds(result, "fit") for result in group]),
        "total time": lambda group: duration_text(sum(map(_all_seconds, group))),
        "peak memory": _peak_memory,
    }
    rows += [(name, *map(summary, machines.values())) for name, summary in summaries.items()]
    return Grid(("", *(f"machine {n}" if len(machines) > 1 else "" for n in range(1, len(machines) + 1))), tuple(rows))


def _peak_memory(results: Sequence[Result]) -> str:
    megabytes = max(float(result.get("peak_memory_mb") or 0) for result in results)
    return size_text(megabytes * 1e6) if megabytes else ""


def warnings_of(results: Sequence[Result]) -> list[str]:
    """Return each distinct warning once, with the number of trials that have it."""
    counted: dict[str, int] = {}
    for text in (" ".join(str(text).split()) for result in results for text in result.get("warnings", ())):
        counted[text] = counted.get(text, 0) + 1
    return [f"{text} ({count} trials)" if count > 1 else text for text, count in counted.items()]


def _value(table: Table, metric: str, target: str, row: Row, seed: int) -> str:
    value = table.samples.get((metric, target, row), {}).get(seed) if metric in table.metrics else None
    return "" if value is None else format_number(value, whole=METRICS[metric].format in ("d", ""))


def _made_with(result: Result) -> tuple[tuple[str, str], ...]:
    device = {"device": result.get("fit", {}).get("device")}
    facts = {**result.get("platform", {}), **device, **result.get("versions", {})}
    return tuple((name, str(value)) for name, value in facts.items() if value is not None)


def _seconds(result: Result, part: str) -> float:
    return float(result.get("seconds", {}).get(part) or 0.0)


def _all_seconds(result: Result) -> float:
    return sum(float(value) for value in result.get("seconds", {}).values() if isinstance(value, int | float))


def _range_text(values: Sequence[float]) -> str:
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"
