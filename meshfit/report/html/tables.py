"""Tables as the page shows them: cells, differences and notes as text, ready for the template."""

from collections.abc import Sequence
from dataclasses import dataclass

from meshfit.experiment.status.scan import SCANNED_STATUSES, ScannedExperiment
from meshfit.experiment.storage.failure import read_failure
from meshfit.experiment.storage.run_directory import Result
from meshfit.experiment.trial_status import TrialStatus
from meshfit.measuring.metrics import METRICS
from meshfit.report.html.charts import Whisker, whiskers
from meshfit.report.html.target_section import Keyed, row_title, trials_on
from meshfit.report.tables.comparisons import Comparison, Row
from meshfit.report.tables.grouping import describe_definitions, differing_keys, setting_text
from meshfit.report.tables.layout import TextCell, columns_of, row_groups, row_names
from meshfit.report.tables.notes import (
    Section,
    best_note,
    cell_line,
    comparison_lines,
    improvement_text,
    metric_line,
    not_significant_note,
    notes,
    sections_of,
    seeds_text,
    setting_lines,
    verdict,
    without_intervals,
)
from meshfit.report.tables.numbers import format_difference, format_number
from meshfit.report.tables.table import VARIED, Table
from meshfit.units import duration_text, size_text


@dataclass(frozen=True)
class ShownRow:
    """A row: its place among all rows of the sheet, its label, and its cells."""

    place: int
    label: str
    cells: tuple[TextCell, ...]


@dataclass(frozen=True)
class ShownDifference:
    """A difference: what differs, by how much, what is found of it, and how it is drawn."""

    label: str
    amount: str
    verdict: str
    chance: str
    seeds: str
    doubtful: bool
    whisker: Whisker | None


@dataclass(frozen=True)
class ShownSection:
    """Differences of one kind, by where they were found."""

    title: str
    places: tuple[tuple[str, tuple[ShownDifference, ...]], ...]


@dataclass(frozen=True)
class ShownSheet:
    """A table in text.

    Attributes:
        title: of the sheet.
        about: what its cells are.
        settings: what they were made with.
        first: what the first column holds.
        heads: what stands above the others, and whether a column is the paper's.
        groups: rows below the variation that they share.
        sections: the differences; none where `lines` say why.
        lines: what is said in place of differences.
        best: what being marked as the best means; empty where nothing is.
        alike: what being marked as alike means; likewise.
        notes: what to bear in mind.
    """

    title: str
    about: str
    settings: tuple[str, ...]
    first: str
    heads: tuple[tuple[str, bool], ...]
    groups: tuple[tuple[str, tuple[ShownRow, ...]], ...]
    sections: tuple[ShownSection, ...]
    lines: tuple[str, ...]
    best: str
    alike: str
    notes: tuple[str, ...]


def shown_sheet(sheet: Table) -> ShownSheet:
    """A sheet in text."""
    shown = columns_of(sheet)
    cells = list(zip(*(column.cells for column in shown), strict=True))
    groups = tuple(
        (heading, tuple(ShownRow(place, label, cells[place]) for place, label in rows))
        for heading, rows in row_groups(sheet)
    )
    alone = without_intervals(sheet)
    return ShownSheet(
        title=sheet.title,
        about=f"{metric_line(sheet)}. {cell_line(sheet)}.",
        settings=tuple(setting_lines(sheet)),
        first=row_names(sheet)[-1],
        heads=tuple((column.heading, column.paper) for column in shown),
        groups=groups,
        sections=() if alone else tuple(_sections(sheet)),
        lines=tuple(comparison_lines(sheet)) if alone else (),
        best=best_note(sheet),
        alike=not_significant_note(sheet),
        notes=tuple(notes(sheet)),
    )


def _sections(sheet: Table) -> list[ShownSection]:
    return [_section(sheet, section) for section in sections_of(sheet)]


def _section(sheet: Table, section: Section) -> ShownSection:
    """A section; all of its whiskers lie along one axis."""
    drawn = iter(whiskers([contrast.difference for found in section.places.values() for _, contrast in found]))
    places = tuple(
        (place, tuple(_difference(sheet, label, contrast, next(drawn)) for label, contrast in found))
        for place, found in section.places.items()
    )
    return ShownSection(section.title, places)


def _difference(sheet: Table, label: str, contrast: Comparison, whisker: Whisker | None) -> ShownDifference:
    paired = contrast.difference
    return ShownDifference(
        label,
        format_difference(paired),
        verdict(sheet, paired),
        improvement_text(paired),
        seeds_text(paired),
        doubtful=paired.significant is False,
        whisker=whisker,
    )


@dataclass(frozen=True)
class Grid:
    """Rows of text below their headings."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def differing_settings(sheets: Sequence[Table]) -> Grid:
    """The settings in which some results differ, for each variation of each sheet; no rows where all are alike."""
    settings = [variation.settings for sheet in sheets for variation in sheet.variations]
    names = [
        " · ".join(filter(None, (sheet.title if len(sheets) > 1 else "", variation.name)))
        for sheet in sheets
        for variation in sheet.variations
    ]
    keys = differing_keys(settings)
    rows = tuple((key, *(setting_text(some[key]) if key in some else "" for some in settings)) for key in keys)
    return Grid(("setting", *names), rows)


def shared_by_all(sheets: Sequence[Table]) -> Grid:
    """The settings that all results have in common."""
    settings = [sheet.settings for sheet in sheets]
    differing = {*differing_keys(settings), *(key for some in settings for key in some if some[key] == VARIED)}
    found = settings[0] if settings else {}
    return Grid(("setting", "value"), tuple((key, setting_text(found[key])) for key in found if key not in differing))


def definitions_grid(results: Sequence[Result]) -> Grid:
    """The schemes of the user's own; no rows where there are none."""
    return Grid(("scheme", "definition"), tuple(describe_definitions(results).items()))


def trials_grid(sheets: Sequence[Table], trials: Sequence[Keyed]) -> Grid:
    """Every value of every trial, by experiment, target, row and seed."""
    metrics = dict.fromkeys(metric for sheet in sheets for metric in sheet.metrics)
    rows = [
        (
            sheet.targets[target],
            row_title(sheet, sheet.rows[place]),
            str(seed),
            *(_value(sheet, metric, target, sheet.rows[place], seed) for metric in metrics),
            f"{_seconds(result, 'fit'):.3g}",
            str(result["folder"]),
        )
        for sheet in sheets
        for target in sheet.targets
        for place, by_seed in trials_on(sheet, target, trials).items()
        for seed, result in by_seed.items()
    ]
    titles = [METRICS[metric].title for metric in metrics]
    return Grid(("target", "row", "seed", *titles, "seconds of the fit", "folder"), tuple(rows))


def failures_grid(experiments: Sequence[ScannedExperiment]) -> Grid:
    """The trials that failed, and why."""
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
    return Grid(("trial", "kind", "step", "message", "look into"), tuple(rows))


def states_grid(experiments: Sequence[ScannedExperiment]) -> Grid:
    """How many trials of each experiment are in each state that some trial is in."""
    states = [state for state in SCANNED_STATUSES if any(experiment.counts[state] for experiment in experiments)]
    rows = [(experiment.name, *(f"{experiment.counts[state]:,}" for state in states)) for experiment in experiments]
    return Grid(("experiment", *states), tuple(rows))


def machines_grid(results: Sequence[Result]) -> Grid:
    """The versions and machines that results were made with, and what they took, a column for each kind."""
    kinds: dict[tuple[tuple[str, str], ...], list[Result]] = {}
    for result in results:
        kinds.setdefault(_made_with(result), []).append(result)
    names = list(dict.fromkeys(name for kind in kinds for name, _ in kind))
    rows = [(name, *(dict(kind).get(name, "") for kind in kinds)) for name in names]
    rows.append(("trials", *(f"{len(found):,}" for found in kinds.values())))
    rows.append(("seconds a fit", *(_range([_seconds(result, "fit") for result in found]) for found in kinds.values())))
    rows.append(("all together", *(duration_text(sum(map(_all_seconds, found))) for found in kinds.values())))
    memory = [max(float(result.get("peak_memory_mb") or 0) for result in found) for found in kinds.values()]
    rows.append(("most memory", *(size_text(most * 1e6) if most else "" for most in memory)))
    return Grid(("", *(f"machine {place + 1}" if len(kinds) > 1 else "" for place in range(len(kinds)))), tuple(rows))


def warnings_of(results: Sequence[Result]) -> list[str]:
    """What was warned of, each once, with how many trials it was said of."""
    counted: dict[str, int] = {}
    for text in (" ".join(str(text).split()) for result in results for text in result.get("warnings", ())):
        counted[text] = counted.get(text, 0) + 1
    return [f"{text} ({count} trials)" if count > 1 else text for text, count in counted.items()]


def _value(sheet: Table, metric: str, target: str, row: Row, seed: int) -> str:
    value = sheet.samples.get((metric, target, row), {}).get(seed) if metric in sheet.metrics else None
    return "" if value is None else format_number(value, whole=METRICS[metric].format in ("d", ""))


def _made_with(result: Result) -> tuple[tuple[str, str], ...]:
    device = {"device": result.get("fit", {}).get("device")}
    facts = {**result.get("platform", {}), **device, **result.get("versions", {})}
    return tuple((name, str(value)) for name, value in facts.items() if value is not None)


def _seconds(result: Result, part: str) -> float:
    return float(result.get("seconds", {}).get(part) or 0.0)


def _all_seconds(result: Result) -> float:
    return sum(float(value) for value in result.get("seconds", {}).values() if isinstance(value, int | float))


def _range(values: Sequence[float]) -> str:
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"
