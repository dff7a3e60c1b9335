"""What the page lists besides figures: settings, trials that did not complete, versions and machines."""

from collections.abc import Sequence
from dataclasses import dataclass

from meshfit.experiment.failure_file import read_failure
from meshfit.experiment.folders import State
from meshfit.experiment.overview import ExperimentOverview
from meshfit.measuring.metrics import METRICS
from meshfit.report.amounts import duration, size
from meshfit.report.contrast import Row
from meshfit.report.gather import Result
from meshfit.report.numbers import plain
from meshfit.report.own_schemes import definitions_of
from meshfit.report.page.exhibits import Keyed, row_title, trials_on
from meshfit.report.sheet import VARIED, Sheet
from meshfit.report.variations import differing_keys, shown


@dataclass(frozen=True)
class Grid:
    """Rows of text below their headings."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def differing_settings(sheets: Sequence[Sheet]) -> Grid:
    """The settings in which some results differ, for each variation of each sheet; no rows where all are alike."""
    settings = [same[0].settings for sheet in sheets for same in sheet.tables]
    names = [
        " · ".join(filter(None, (sheet.title if len(sheets) > 1 else "", name)))
        for sheet in sheets
        for name in sheet.variations
    ]
    keys = differing_keys(settings)
    rows = tuple((key, *(shown(some[key]) if key in some else "" for some in settings)) for key in keys)
    return Grid(("setting", *names), rows)


def shared_by_all(sheets: Sequence[Sheet]) -> Grid:
    """The settings that all results have in common."""
    settings = [sheet.settings for sheet in sheets]
    differing = {*differing_keys(settings), *(key for some in settings for key in some if some[key] == VARIED)}
    found = settings[0] if settings else {}
    return Grid(("setting", "value"), tuple((key, shown(found[key])) for key in found if key not in differing))


def definitions_grid(results: Sequence[Result]) -> Grid:
    """The schemes of the user's own; no rows where there are none."""
    return Grid(("scheme", "definition"), tuple(definitions_of(results).items()))


def trials_grid(sheets: Sequence[Sheet], trials: Sequence[Keyed]) -> Grid:
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


def failures_grid(experiments: Sequence[ExperimentOverview]) -> Grid:
    """The trials that failed, and why."""
    found = [read_failure(trial) for experiment in experiments for trial in experiment.of(State.FAILED)]
    rows = [
        (
            failure.trial.label,
            failure.kind,
            "" if failure.step is None else f"{failure.step:,}",
            failure.message,
            str(failure.where),
        )
        for failure in found
    ]
    return Grid(("trial", "kind", "step", "message", "look into"), tuple(rows))


def states_grid(experiments: Sequence[ExperimentOverview]) -> Grid:
    """How many trials of each experiment are in each state that some trial is in."""
    states = [state for state in State if any(experiment.counts[state] for experiment in experiments)]
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
    rows.append(("all together", *(duration(sum(map(_all_seconds, found))) for found in kinds.values())))
    memory = [max(float(result.get("peak_memory_mb") or 0) for result in found) for found in kinds.values()]
    rows.append(("most memory", *(size(most * 1e6) if most else "" for most in memory)))
    return Grid(("", *(f"machine {place + 1}" if len(kinds) > 1 else "" for place in range(len(kinds)))), tuple(rows))


def warnings_of(results: Sequence[Result]) -> list[str]:
    """What was warned of, each once, with how many trials it was said of."""
    counted: dict[str, int] = {}
    for text in (" ".join(str(text).split()) for result in results for text in result.get("warnings", ())):
        counted[text] = counted.get(text, 0) + 1
    return [f"{text} ({count} trials)" if count > 1 else text for text, count in counted.items()]


def _value(sheet: Sheet, metric: str, target: str, row: Row, seed: int) -> str:
    value = sheet.sample(metric, target, row).get(seed) if metric in sheet.metrics else None
    return "" if value is None else plain(value, whole=METRICS[metric].format in ("d", ""))


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
