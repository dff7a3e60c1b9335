"""Sweeps: settings varied as a grid, in step (`zip`), as named `variants`, by a `sample`, or as their product."""

import json
import math
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from meshfit.config.experiment import NO_EFFECT_ON_RESULTS, ExperimentSettings, canonical_key
from meshfit.config.sweep_samples import MOST_POINTS, RANGES, SAMPLE, read_ranges, sampled_points
from meshfit.errors import ConfigError
from meshfit.printable import printable, require_printable
from meshfit.settings import KIND_KEY, apply_changes, build, deep_merge, nested

ZIP, VARIANTS = "zip", "variants"
_NOT_KEYS = (ZIP, VARIANTS, SAMPLE, RANGES)
_AXES = ("targets", "schemes", "seeds")
MOST_TRIALS = 100_000
"""The most trials of an experiment."""
_LONGEST_VALUE = 60


@dataclass(frozen=True)
class Variant:
    """One point of a sweep.

    Attributes:
        name: in tables, such as `edge=0.1, levels=3`; empty where nothing is varied.
        settings: of the experiment at this point, without a sweep.
    """

    name: str
    settings: ExperimentSettings


@dataclass(frozen=True)
class _Point:
    """A point on one axis of a sweep: its name, and the settings that it changes, by dotted key."""

    name: str
    changes: Mapping[str, Any]


def variants_of(settings: ExperimentSettings, where: Callable[[], str] = lambda: "") -> list[Variant]:
    """Return the points of an experiment's sweep; a single nameless one if it has none.

    Args:
        settings: of the experiment.
        where: returns the place where the sweep was written, with which messages begin.

    Raises:
        ConfigError: a malformed sweep, a key or a value that is not allowed, or two equal points.
    """
    try:
        axes = _axes(settings.sweep)
    except ConfigError as error:
        raise ConfigError(f"{where()}{error}") from None
    _check_number_of_trials(settings, math.prod(map(len, axes)), where)
    variants: dict[str, Variant] = {}
    for points in product(*axes):
        changes = {key: value for point in points for key, value in point.changes.items()}
        varied = _changed(settings, changes, where)
        name = ", ".join(point.name for point in points)
        # Settings without an effect do not tell two points apart: both would be the same trials.
        key = varied.model_dump_json(exclude=NO_EFFECT_ON_RESULTS)
        other = variants.setdefault(key, Variant(name, varied))
        if other.name != name:
            raise ConfigError(f"{where()}sweep: '{other.name}' and '{name}' are the same settings")
    return list(variants.values())


def variant_at(settings: ExperimentSettings, changes: Mapping[str, Any]) -> Variant:
    """Return the point of a sweep at which some settings, by dotted key, have other values.

    Raises:
        ConfigError: a key or a value that is not allowed.
    """
    _check_keys([changes])
    return Variant(point_name(changes), _changed(settings, changes, lambda: ""))


def point_name(changes: Mapping[str, Any], axes: Mapping[str, Sequence[Any]] | None = None) -> str:
    """Return the name of a point, such as `edge=0.1, source=(mesh=cube levels=3)`.

    Args:
        changes: value of each setting, by dotted key.
        axes: all values of each setting that is varied, from which the name is to be distinguished; by default the
            settings of the point alone.
    """
    axes = {key: [value] for key, value in changes.items()} if axes is None else axes
    short = short_names(list(axes))
    return ", ".join(f"{short[key]}={value_text(value, axes[key])}" for key, value in changes.items())


def _changed(settings: ExperimentSettings, changes: Mapping[str, Any], where: Callable[[], str]) -> ExperimentSettings:
    """Return settings without a sweep, with other values at some dotted keys."""
    # Defaults may depend on a setting that is varied.
    base = settings.model_dump(mode="json", exclude_unset=True) | {"sweep": {}}
    merged: dict[str, Any] = {}
    for key, value in changes.items():
        merged = deep_merge(merged, nested(key, value))
    return build(ExperimentSettings, apply_changes(base, merged), lambda _: f"{where()}sweep: ")


def _axes(sweep: Mapping[str, Any]) -> list[list[_Point]]:
    """Return the points on each axis: named variants, zipped settings, sampled ones, then each setting of the grid."""
    named = _mapping(sweep.get(VARIANTS, {}), f"sweep.{VARIANTS}")
    for name in named:
        require_printable(name, f"sweep.{VARIANTS}: variant")
        if name != name.strip():
            raise ConfigError(f"sweep.{VARIANTS}: '{name}' has blanks at an end; name it '{name.strip()}'")
    variants = [
        _Point(name, dict(_flat(_mapping(changes, f"sweep.{VARIANTS}.{name}"), lists=False)))
        for name, changes in named.items()
    ]
    zipped = _lists(_mapping(sweep.get(ZIP, {}), f"sweep.{ZIP}"))
    grid = _lists({key: value for key, value in sweep.items() if key not in _NOT_KEYS})
    _check_size(
        len(variants) or 1, len(next(iter(zipped.values()), ())) or 1, _num_sampled(sweep), *map(len, grid.values())
    )
    sampled = sampled_points(sweep.get(SAMPLE), sweep.get(RANGES)) if sweep.keys() & {SAMPLE, RANGES} else []
    ranges = read_ranges(sweep[RANGES]) if sampled else {}
    _check_keys([dict.fromkeys(key for point in variants for key in point.changes), zipped, ranges, grid])
    keys = {**zipped, **{key: _listed(values) for key, values in ranges.items()}, **grid}

    def point(changes: Mapping[str, Any]) -> _Point:
        return _Point(point_name(changes, keys), changes)

    steps = [point(dict(zip(zipped, row, strict=True))) for row in _in_step(zipped)]
    lines = [[point({key: value}) for value in values] for key, values in grid.items()]
    samples = [point(changes) for changes in sampled]
    return [axis for axis in (variants, steps, samples, *lines) if axis]


def _check_size(*lengths: int) -> None:
    """Refuse a sweep of more points than can be planned, before any is made."""
    if (points := math.prod(lengths)) > MOST_POINTS:
        axes = " × ".join(f"{length:,}" for length in lengths if length > 1)
        product = f" ({axes})" if axes != f"{points:,}" else ""
        raise ConfigError(f"sweep: {points:,} points{product}; expected {MOST_POINTS:,} or fewer")


def _check_number_of_trials(settings: ExperimentSettings, points: int, where: Callable[[], str]) -> None:
    """Refuse an experiment of more trials than can be planned, before any is planned."""
    axes = {axis: len(getattr(settings, axis)) for axis in _AXES} | {"points of the sweep": points}
    if (trials := math.prod(axes.values())) > MOST_TRIALS:
        factors = " × ".join(f"{length:,} {axis}" for axis, length in axes.items() if length > 1)
        raise ConfigError(f"{where()}{trials:,} trials ({factors}); expected {MOST_TRIALS:,} or fewer")


def _num_sampled(sweep: Mapping[str, Any]) -> int:
    sample = sweep.get(SAMPLE)
    points = sample.get("points") if isinstance(sample, Mapping) else None
    return points if isinstance(points, int) and points > 0 else 1  # anything else is refused later


def _in_step(zipped: Mapping[str, list[Any]]) -> Iterator[tuple[Any, ...]]:
    if len({len(values) for values in zipped.values()}) > 1:
        lengths = ", ".join(f"{key} has {len(values)}" for key, values in zipped.items())
        raise ConfigError(f"sweep.{ZIP}: expected lists of the same length; {lengths}")
    return zip(*zipped.values(), strict=True)


def _lists(tree: Mapping[str, Any]) -> dict[str, list[Any]]:
    lists: dict[str, list[Any]] = {}
    for key, values in _flat(tree, lists=True):
        if not isinstance(values, list) or not values:
            raise ConfigError(f"sweep: {key}: expected a list of values, such as [0.1, 1.0], got {_shortened(values)}")
        if len({json.dumps(value, sort_keys=True) for value in values}) < len(values):
            raise ConfigError(f"sweep: {key}: duplicate value in {_shortened(values)}")
        if key in lists:
            raise ConfigError(f"sweep: duplicate key {key}")
        lists[key] = values
    return lists


def _flat(tree: Mapping[str, Any], *, lists: bool, above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and their values; with `lists`, as in a grid, only mappings are entered."""
    for key, value in tree.items():
        # A mapping that names its kind may replace settings of another kind, so it stays whole.
        if isinstance(value, Mapping) and (lists or KIND_KEY not in value):
            yield from _flat(value, lists=lists, above=f"{above}{key}.")
        else:
            yield canonical_key(f"{above}{key}"), value


def _check_keys(axes: Sequence[Mapping[str, Any]]) -> None:
    keys = [key for axis in axes for key in axis]
    for key in keys:
        first, _, last = key.partition(".")
        if first in _AXES:
            raise ConfigError(f"sweep: {key}: always varied; list its values under '{first}'")
        if NO_EFFECT_ON_RESULTS.get(first) is True or last in NO_EFFECT_ON_RESULTS.get(first, ()):
            raise ConfigError(f"sweep: {key}: cannot be swept, since it has no effect on results")
        if keys.count(key) > 1:
            raise ConfigError(
                f"sweep: {key}: varied in two ways; use only one of {ZIP}, {VARIANTS}, {RANGES} and the grid"
            )


def short_names(keys: Sequence[str]) -> dict[str, str]:
    """Return the last part of each dotted key, or as many parts as distinguish it from the others."""
    names = {}
    for key in keys:
        parts = key.split(".")
        tails = (".".join(parts[start:]) for start in range(len(parts) - 1, -1, -1))
        names[key] = next(
            tail for tail in tails if sum(f".{other}".endswith(f".{tail}") for other in keys) == 1 or tail == key
        )
    return names


def _mapping(value: Any, key: str) -> Mapping[str, Any]:  # noqa: ANN401  any YAML value
    if not isinstance(value, Mapping):
        raise ConfigError(f"{key}: expected a mapping of keys to values, got {_shortened(value)}")
    return value


def _listed(values: object) -> list[Any]:
    return values if isinstance(values, list) else []


def value_text(value: object, others: Sequence[Any] = ()) -> str:
    """Return the value of a setting as text.

    Args:
        value: text as it is; `(mesh=cube levels=3)` for a mapping; anything else as JSON. A path has as many of its
            last parts as distinguish it from the others.
        others: all values of the setting.
    """
    if isinstance(value, Mapping):
        return f"({' '.join(f'{key}={_word(each)}' for key, each in value.items())})"
    if not isinstance(value, str):
        return printable(json.dumps(value, ensure_ascii=False))
    if _is_path(value):
        paths = {other for other in others if isinstance(other, str) and other != value}
        parts = Path(value).parts
        tails = ("/".join(parts[start:]) for start in range(len(parts) - 1, 0, -1))
        value = next((tail for tail in tails if not any(f"/{other}".endswith(f"/{tail}") for other in paths)), value)
    return printable(value)


def _word(value: object) -> str:
    """Return a value within a mapping; a text that would read as more than one word is quoted."""
    text = value_text(value)
    return json.dumps(text) if isinstance(value, str) and not re.fullmatch(r"[^\s=()\"]+", text) else text


def _is_path(text: str) -> bool:
    return "/" in text and (text.startswith("/") or re.search(r"\.[A-Za-z]\w*$", text) is not None)


def _shortened(value: object) -> str:
    return textwrap.shorten(value_text(value), _LONGEST_VALUE, placeholder=" …")
