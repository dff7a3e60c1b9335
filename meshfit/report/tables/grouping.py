"""From loose results to groups that may share a table: all settings alike but for target, scheme and seed."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from meshfit.config.experiment import SOURCE_FILE_KEYS
from meshfit.config.scheme_files import scheme_name_for
from meshfit.errors import StoreError
from meshfit.experiment.storage.run_directory import Result
from meshfit.settings import build
from meshfit.subdivision.registry import SCHEMES, UserSchemes, canonical, registry_with, spec_of

Cell = tuple[str, str]
"""Target and scheme."""

# Definitions go with the schemes that they are of.
_VARIED = ("targets", "schemes", "define", "seeds")

# Settings that change what is written beside the numbers, and not the numbers.
_WITHOUT_EFFECT = ("write_frame", "fit.trace_every")
_PATHS = {".".join(path) for path in SOURCE_FILE_KEYS}


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


def group_results(results: Sequence[Result], metric: str) -> list[Group]:
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
    settings = flatten({key: value for key, value in result["settings"].items() if key not in _VARIED})
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


def flatten(nested: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Nested mappings as one, by dotted key."""
    found: dict[str, Any] = {}
    for key, value in nested.items():
        found |= flatten(value, f"{above}{key}.") if isinstance(value, Mapping) else {f"{above}{key}": value}
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


Settings = Mapping[str, Any]


def differing_keys(settings: Sequence[Settings]) -> list[str]:
    """The keys in which some settings differ, in the order of the settings."""
    keys = dict.fromkeys(key for some in settings for key in some)
    return [key for key in keys if len({json.dumps(some.get(key)) for some in settings}) > 1]


def variation_names(settings: Sequence[Settings], variants: Sequence[str]) -> list[str]:
    """What to call each of several settings: its variant, or without one what sets it apart, `edge=0.1, levels=3`.

    Keys are shortened to their last part where that is clear. Variants that do not tell settings apart are not used.

    Args:
        settings: all different.
        variants: for each of them, what it was called when it was run; empty if it was not.
    """
    keys = differing_keys(settings)
    short = {key: key.rpartition(".")[2] for key in keys}
    clear = {key: name if list(short.values()).count(name) == 1 else key for key, name in short.items()}
    by_settings = [
        ", ".join(f"{name}={setting_text(some[key])}" for key, name in clear.items() if key in some)
        for some in settings
    ]
    named = [variant or name for variant, name in zip(variants, by_settings, strict=True)]
    return named if len(set(named)) == len(named) else by_settings


def natural_order(settings: Sequence[Settings]) -> list[int]:
    """The places of some settings, ordered by the values in which they differ: numbers by size, texts naturally."""
    keys = differing_keys(settings)
    return sorted(range(len(settings)), key=lambda place: [_rank(settings[place].get(key)) for key in keys])


def setting_text(value: object) -> str:
    """A setting's value as titles have it."""
    return value if isinstance(value, str) else json.dumps(value)


def _rank(value: object) -> tuple[int, float, list[tuple[int, float, str]]]:
    if value is None:
        return 0, 0.0, []
    if isinstance(value, int | float):
        return 1, float(value), []
    parts = re.findall(r"\d+(?:\.\d+)?|\D+", setting_text(value))
    return 2, 0.0, [(1, 0.0, part) if not part[0].isdigit() else (0, float(part), "") for part in parts]


def distinguish_definitions(results: Sequence[Result]) -> list[Result]:
    """Results, with what tells definitions apart added to a scheme's name: `mine [edge.end=3/8]`.

    Only where some results have one definition under a name and others another: a definition that was changed between
    two runs, or that is swept.
    """
    forms: dict[str, dict[str, Mapping[str, Any]]] = {}
    for result in results:
        own = _definitions(result)
        forms.setdefault(_name(result), {})[_text(own)] = own
    added = {name: _differences(name, list(some.values())) for name, some in forms.items() if len(some) > 1}
    return [_renamed(result, added.get(_name(result), {})) for result in results]


def resolve_scheme(results: Sequence[Mapping[str, Any]], text: str) -> str:
    """A scheme as results have it: their own word for it, or the canonical form of a spec of theirs or of the table.

    Raises:
        SchemeError: it is no scheme.
        ConfigError: it is one that a result defines in a way that is not understood.
    """
    text = scheme_name_for(text)
    if any(result["scheme"] == text for result in results):
        return text
    if spec_of(text).name in SCHEMES:
        return canonical(text)
    define = {name: one for result in results for name, one in _definitions(result).items()}
    return canonical(text, registry_with(build(UserSchemes, {"define": define}).define))


def describe_definitions(results: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """What the user's own schemes among some results are, in a line for each of them as results call it."""
    found: dict[str, str] = {}
    for result in results:
        if result["scheme"] not in found and (own := _definitions(result)):
            entries = {key: one for key, one in _in_order(_name(result), own).items() if one is not None}
            found[result["scheme"]] = "; ".join(f"{key}: {_in_words(one)}" for key, one in entries.items())
    return found


def _in_words(value: object) -> str:
    return f"[{', '.join(map(setting_text, value))}]" if isinstance(value, list) else setting_text(value)


def _name(result: Mapping[str, Any]) -> str:
    """Of its scheme, whatever it has been called since."""
    return _spec(result).partition(":")[0]


def _spec(result: Mapping[str, Any]) -> str:
    return str(result["settings"].get("schemes", [result["scheme"]])[0])


def _definitions(result: Mapping[str, Any]) -> Mapping[str, Any]:
    found = result["settings"].get("define", {})
    return found if isinstance(found, Mapping) else {}


def _text(own: Mapping[str, Any]) -> str:
    return json.dumps(own, sort_keys=True)


def _differences(name: str, forms: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """What is added to the name of a scheme, by the text of its definitions."""
    names = variation_names([_in_order(name, own) for own in forms], [""] * len(forms))
    return {_text(own): f" [{told}]" if told else "" for own, told in zip(forms, names, strict=True)}


def _in_order(name: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """A scheme's own entries by dotted key, and those of its base, with the base's name before them."""
    return flatten(own.get(name, {})) | flatten({key: one for key, one in own.items() if key != name})


def _renamed(result: Result, added: Mapping[str, str]) -> Result:
    if not added:
        return result
    return {**result, "scheme": _spec(result) + added[_text(_definitions(result))]}
