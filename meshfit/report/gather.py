"""From loose results to groups that may share a table: all settings alike but for target, scheme and seed."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from meshfit.config.experiment import PATHS
from meshfit.errors import StoreError

Result = Mapping[str, Any]
Cell = tuple[str, str]
"""Target and scheme."""

# Definitions go with the schemes that they are of.
_VARIED = ("targets", "schemes", "define", "seeds")

# Settings that change what is written beside the numbers, and not the numbers.
_WITHOUT_EFFECT = ("write_frame", "fit.trace_every")
_PATHS = {".".join(path) for path in PATHS}


@dataclass
class Group:
    """Results that may share a table.

    Attributes:
        settings: the settings they have in common, by dotted key.
        experiments: names of the experiments they come from.
        variants: what the results call their settings; empty for one that has no word for them.
        titles: how each target is called.
        samples: values by target and scheme, then by seed; a result without a value has an entry without that seed.
    """

    settings: dict[str, Any]
    experiments: list[str] = field(default_factory=list)
    variants: set[str] = field(default_factory=set)
    titles: dict[str, str] = field(default_factory=dict)
    samples: dict[Cell, dict[int, float]] = field(default_factory=dict)


def gather(results: Sequence[Result], metric: str) -> list[Group]:
    """Group results by their settings, in the order in which the groups first appear.

    Raises:
        StoreError: two results of one trial disagree, or a value is not a finite number.
    """
    groups: dict[str, Group] = {}
    kept: dict[tuple[str, Cell, int], tuple[Result, float | None]] = {}
    settings_of = _SharedSettings()
    for result in results:
        key, settings = settings_of(result)
        cell, seed, value = (target_key(result), result["scheme"]), result["seed"], _value(result, metric)
        earlier, known = kept.setdefault((key, cell, seed), (result, value))
        if known != value:
            raise StoreError(_disagreement(metric, (earlier, known), (result, value)))
        group = groups.setdefault(key, Group(settings))
        group.variants.add(result.get("variant") or "")
        if result["experiment"] not in group.experiments:
            group.experiments.append(result["experiment"])
        group.titles.setdefault(cell[0], result["target_title"])
        sample = group.samples.setdefault(cell, {})
        if value is not None:
            sample[seed] = value
    return list(groups.values())


class _SharedSettings:
    """The shared settings of one result after another; those of the same text, which is quick to make, only once."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[str, dict[str, Any]]] = {}

    def __call__(self, result: Result) -> tuple[str, dict[str, Any]]:
        """A key that is the same for the same settings, and these."""
        own = {key: value for key, value in result["settings"].items() if key not in _VARIED}
        text = json.dumps([own, result["schema_version"], sorted(_source_hashes(result).items())])
        if text not in self._known:
            settings = shared_settings(result)
            self._known[text] = json.dumps(settings, sort_keys=True), settings
        return self._known[text]


def shared_settings(result: Result) -> dict[str, Any]:
    """Every setting of a result but target, scheme and seed, by dotted key, and what else its numbers hang on."""
    settings = flat({key: value for key, value in result["settings"].items() if key not in _VARIED})
    settings = {key: value for key, value in settings.items() if key not in _WITHOUT_EFFECT}
    settings["schema_version"] = result["schema_version"]
    for key in sorted(settings.keys() & _PATHS):
        # Where a file lies does not enter, as in a trial's identity; what is in it does.
        settings[key] = settings[key] and Path(settings[key]).stem
    return settings | _source_hashes(result)


def _source_hashes(result: Result) -> dict[str, str]:
    """By dotted key, the first digits of those of the files that the source is made from."""
    found = {role: value[:12] for role, value in result.get("inputs", {}).items() if role != "target"}
    return {"source.sha256" if role == "source" else f"source.{role}.sha256": value for role, value in found.items()}


def target_key(result: Result) -> str:
    """The column of a result: the target's name, or its file's, since a user's `bunny.ply` is not the named bunny."""
    return Path(result["settings"]["targets"][0]).name


def flat(nested: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Nested mappings as one, by dotted key."""
    found: dict[str, Any] = {}
    for key, value in nested.items():
        found |= flat(value, f"{above}{key}.") if isinstance(value, Mapping) else {f"{above}{key}": value}
    return found


def _value(result: Result, metric: str) -> float | None:
    value: Any = result
    for key in metric.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    if value is None:
        return None
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise StoreError(f"{_trial(result)}: {metric} is {value}; a finite number is needed")
    return float(value)


def _trial(result: Result) -> str:
    return f"{result['target_title']}, {result['scheme']}, seed {result['seed']}"


def _disagreement(metric: str, first: tuple[Result, float | None], second: tuple[Result, float | None]) -> str:
    values = " and ".join(f"{value} ({_origin(result)})" for result, value in (first, second))
    return f"{_trial(first[0])}: two results with the same settings differ in {metric}: {values}; leave one of them out"


def _origin(result: Result) -> str:
    """Where a result comes from: its folder, if the one who loaded it said so, else its experiment and identity."""
    return str(result.get("folder") or f"{result['experiment']}, trial {result['identity'][:10]}")
