"""The best settings of a search as text: rows of values and settings, and remarks on them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from meshfit.config.sweep_samples import limits
from meshfit.config.sweeps import short_names, value_text
from meshfit.errors import ConfigError
from meshfit.experiment.storage.run_directory import Result
from meshfit.experiment.tuning.search_file import FAILED, OWN, Point, Search, read_searches
from meshfit.paths import path_text
from meshfit.report.tables.grouping import without_numbers
from meshfit.units import count_text

MOST_ROWS = 10
"""Rows of a search for one metric; a Pareto front is shown whole."""
_MOST_SHOWN = 5  # points of a search for one metric, of which tables and pictures are shown
_AT_END = 0.02  # share of a range
_MOST_REASONS = 5


def experiment_folders(results: Sequence[Result]) -> list[Path]:
    """Return the folders of the experiments of some results, each once."""
    return list(dict.fromkeys(Path(result["folder"]).parents[2] for result in results if "folder" in result))


def titled_searches(found: Mapping[Path, Sequence[Search]]) -> dict[str, Search]:
    """Return searches by title, from `read_searches`."""
    searches = [(folder.name, search) for folder, several in found.items() for search in several]
    titles = [f"{name}: {', '.join(objective.metric for objective in search.objectives)}" for name, search in searches]
    return {
        title if titles.count(title) == 1 else f"{title} ({search.key})": search
        for title, (_, search) in zip(titles, searches, strict=True)
    }


def searches_to_draw(results: Sequence[Result], metric: str | None = None) -> dict[str, Search]:
    """Return the searches that made the experiments of some results, by title; none if no experiment was searched.

    Args:
        results: the results, with their `folder`.
        metric: return searches for this metric alone.

    Raises:
        ConfigError: a search made only some of the experiments, or there is none for the metric.
        StoreError: the file of a search cannot be read.
    """
    folders = experiment_folders(results)
    found = read_searches(folders)
    if not found:
        return {}
    if others := [folder for folder in folders if folder not in found]:
        first = next(iter(found))
        raise ConfigError(f"{path_text(first)} was made by a search, {path_text(others[0])} was not: draw them apart")
    searches = titled_searches(found)
    metrics = dict.fromkeys(objective.metric for search in searches.values() for objective in search.objectives)
    if metric is not None and metric not in metrics:
        raise ConfigError(f"{metric}: the search is for {', '.join(metrics)}; leave out --metric")
    return {title: each for title, each in searches.items() if metric in (None, *(o.metric for o in each.objectives))}


def results_of_best(results: Sequence[Result]) -> list[Result]:
    """Keep, of each experiment that a search made, the config's own settings and the best points, named by number.

    Args:
        results: the results in the order of their plans, with their `folder`, `variant` and `place`. Those of other
            experiments stay as they are.
    """
    chosen: dict[Path, dict[str, tuple[int, str]]] = {}
    for folder, searches in read_searches(experiment_folders(results)).items():
        names = [(OWN, OWN)]
        for search in searches:
            prefix = f"{search.key} " if len(searches) > 1 else ""
            names += [(search.points[i].name, f"{prefix}point {i + 1}") for i in best_points(search, _MOST_SHOWN)]
        chosen[folder] = {name: (place, label) for place, (name, label) in reversed(list(enumerate(names)))}
    kept = []
    for result in results:
        names_of = chosen.get(Path(result["folder"]).parents[2])
        if names_of is None:
            kept.append(result)
        elif (found := names_of.get(result["variant"])) is not None:
            kept.append(result | {"variant": found[1], "place": (found[0], *result["place"][1:])})
    return kept or list(results)


def search_heads(search: Search) -> tuple[str, ...]:
    """Return the heads of `search_rows`."""
    several = len(search.objectives) > 1
    names = [objective.metric if several else "value" for objective in search.objectives]
    return (*names, *short_names(list(search.ranges)).values(), "point")


def search_rows(search: Search, most: int = MOST_ROWS) -> list[tuple[str, ...]]:
    """Return values, settings and number of the best points, then of the config's own settings if they are complete.

    Args:
        search: the search.
        most: number of points of a search for one metric.
    """
    rows = []
    for i in best_points(search, most):
        point = search.points[i]
        texts = (value_text(point.changes[key], values) for key, values in search.ranges.items())
        rows.append((*value_texts(search, point), *texts, str(i + 1)))
    if search.own.values:
        rows.append((*value_texts(search, search.own), *("" for _ in search.ranges), OWN))
    return rows


def best_points(search: Search, most: int = MOST_ROWS) -> list[int]:
    """Return the indices of the best points: of the Pareto front all, of a single metric's some, the best first."""
    return search.best if len(search.objectives) > 1 else search.ranked[:most]


def value_texts(search: Search, point: Point) -> list[str]:
    """Return the values of a point's objectives as text."""
    return [objective.text(value) for objective, value in zip(search.objectives, point.values, strict=True)]


def search_title(search: Search) -> str:
    """Return the line above the rows, such as `distance.mean: best settings of 32 points, 2 failed`."""
    names = ", ".join(objective.metric for objective in search.objectives)
    failed = f", {len(search.failed)} failed" if search.failed else ""
    title = "Pareto front" if len(search.objectives) > 1 else "best settings"
    return f"{names}: {title} of {count_text(_num_tried(search), 'point')}{failed}"


def search_notes(search: Search, total: int | None = None) -> Iterator[str]:
    """Say what the values are, how much was gained, which settings are at the end of their range, and what failed.

    Args:
        search: the search.
        total: number of points that were asked for; None if it is not known.
    """
    targets, schemes, seeds = (len(search.cells[key]) for key in ("targets", "schemes", "seeds"))
    pairs = count_text(targets * schemes, "pair") + " of target and scheme"
    over = [f"the geometric mean over {pairs}"] if targets * schemes > 1 else []
    over += [f"the mean over {count_text(seeds, 'seed')}"] if seeds > 1 else []
    if over:
        plain = "" if all(o.is_geometric for o in search.objectives) else " (shares and counts: arithmetic)"
        yield f"Each value is {' of '.join(over)}{plain}."
    if search.best and len(search.objectives) == 1:
        yield from _notes_on_best(search)
    if search.own.state == FAILED:
        yield f"The config's own settings failed: {search.own.reason}"
    if total is not None and _num_tried(search) < total:
        yield f"All {_num_tried(search)} combinations of the ranges have been tried."
    yield from failure_notes(search)


def _notes_on_best(search: Search) -> Iterator[str]:
    best = search.points[search.best[0]]
    if search.own.values and search.objectives[0].is_geometric and search.own.values[0] > 0:
        change = 100 * (best.values[0] / search.own.values[0] - 1)
        yield f"Against the config's own settings: {change:+.1f} %".replace("-", "−") + "."
    if at_end := [key for key, values in search.ranges.items() if _is_at_end(values, best.changes[key])]:
        yield f"At the end of its range, which may be too narrow: {', '.join(at_end)}."


def failure_notes(search: Search) -> Iterator[str]:
    """Say how many points failed, by reason."""
    reasons: dict[str, list[str]] = {}
    for i in search.failed:
        reasons.setdefault(without_numbers(search.points[i].reason), []).append(search.points[i].reason)
    for alike in list(reasons.values())[:_MOST_REASONS]:
        example = ", such as" if len(set(alike)) > 1 else ""
        yield f"{count_text(len(alike), 'point')} failed{example}: {alike[0]}"
    if (more := len(reasons) - _MOST_REASONS) > 0:
        yield f"and {count_text(more, 'more reason')}"


def _num_tried(search: Search) -> int:
    return len(search.complete) + len(search.failed)


def _is_at_end(values: object, value: object) -> bool:
    """Whether a number is in the first or last part of its range."""
    if not isinstance(values, Mapping) or not isinstance(value, int | float):
        return False
    low, high, is_log, integer = limits(values)
    if integer and value in (low, high):
        return True
    share = math.log(value / low) / math.log(high / low) if is_log else (value - low) / (high - low)
    return not _AT_END <= share <= 1 - _AT_END
