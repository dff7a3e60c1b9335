"""Results grouped into variations, which share all settings except target, scheme and seed; and names for them."""

import json
import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from meshfit.config.scheme_files import scheme_name_for
from meshfit.config.source_settings import SOURCE_FILE_KEYS
from meshfit.config.target_settings import TRUTH_KEY
from meshfit.errors import StoreError
from meshfit.experiment.storage.plan_file import ROLES_OF_TARGETS
from meshfit.experiment.storage.run_directory import Result
from meshfit.paths import file_stem
from meshfit.report.tables.paper_numbers import PAPER_TARGETS
from meshfit.report.tables.provenance import Provenance
from meshfit.settings import build
from meshfit.statistics import BySeed
from meshfit.subdivision.registry import SCHEMES, UserSchemes, canonical, registry_with, spec_of

Settings = Mapping[str, Any]
"""Settings by dotted key."""

# Definitions vary with the schemes that they define.
_OF_IMAGES = ("views:", "images:")
_NOT_SHARED = ("targets", "schemes", "define", "seeds")

# Settings that change which files are written, and no number.
_WITHOUT_EFFECT = ("write_frame", "fit.trace_every")
_TARGET_KEY = "target_key"
_PATHS = {".".join(path) for path in (*SOURCE_FILE_KEYS, TRUTH_KEY)}


@dataclass(frozen=True)
class Missing:
    """Why a planned trial has no result.

    Attributes:
        state: in a word or two, such as `diverged`.
        message: the reason; empty where there is nothing to add.
        log: path of the trial's log; empty if it has none.
    """

    state: str
    message: str
    log: str = ""


@dataclass(frozen=True)
class Variation:
    """Results that share all settings except target, scheme and seed.

    Attributes:
        title: the experiment, and the settings in which this variation differs from others.
        experiment: names of the experiments that the results come from.
        variant: name that the results give to these settings; empty if they give none, or several.
        settings: the shared settings.
        targets: title of each target, in the order of columns.
        schemes: in the order of rows.
        baseline: the scheme that others are compared with.
        samples: values by metric, target and scheme, then by seed; only where there are values.
        place: place among the variations of its experiments, by their plans; empty if these do not say.
        name: name among the variations of a table; empty for a single one.
        shortfalls: what results lack of their target, in words, by target and scheme, then by seed; only where there
            are some.
        clouds: number of points, spacing and kind of normals, of the targets that are clouds of points.
        images: number of views and of those held out, and what distances are to, of the targets that are images.
        complete: seeds of the complete trials, by target and scheme.
        missing: planned trials without a result, by target and scheme, then by seed; only where there are some.
        provenance: versions and devices of the complete trials.
    """

    title: str
    experiment: str
    variant: str
    settings: Settings
    targets: Mapping[str, str]
    schemes: tuple[str, ...]
    baseline: str
    samples: Mapping[tuple[str, str, str], BySeed]
    place: tuple[int, ...] = ()
    name: str = ""
    shortfalls: Mapping[tuple[str, str], Mapping[int, tuple[str, ...]]] = field(default_factory=dict)
    clouds: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    images: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    complete: Mapping[tuple[str, str], frozenset[int]] = field(default_factory=dict)
    missing: Mapping[tuple[str, str], Mapping[int, Missing]] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)


def group_results(
    results: Sequence[Result],
    metrics: Sequence[str],
    *,
    baseline: str | None = None,
    schemes: Sequence[str] = (),
    targets: Sequence[str] = (),
) -> list[Variation]:
    """Group results by their shared settings, in the order in which these first appear.

    Targets and schemes are in the order of the configs where results have their `place` in a plan.

    Args:
        results: the contents of `result.json` files, perhaps from `in_planned_order`, and records of planned trials
            that are `missing`.
        metrics: names of `METRICS`.
        baseline: the scheme that others are compared with; by default the first of each variation.
        schemes: schemes that come first, in this order; without a place in a plan, others follow in the order of
            `SCHEMES`, then alphabetically.
        targets: targets that come first, in this order; without a place in a plan, others follow, those of the paper
            first, then alphabetically.

    Raises:
        StoreError: two results of one trial disagree, or a value is not a finite number.
    """
    shared: dict[str, Settings] = {}
    groups: dict[str, list[Result]] = {}
    for result in results:
        settings = shared_settings(result)
        key = json.dumps(settings, sort_keys=True)
        shared.setdefault(key, settings)
        groups.setdefault(key, []).append(result)
    telling = telling_keys(list(shared.values()))
    experiments = list(dict.fromkeys(result["experiment"] for result in results))
    variations = []
    for key, group in groups.items():
        experiment = " + ".join(dict.fromkeys(result["experiment"] for result in group))
        variants = {result.get("variant") or "" for result in group}
        places = [_places(result, experiments) for result in group]
        by_scheme = _least((result["scheme"], place.scheme) for result, place in zip(group, places, strict=True))
        by_target = _least((target_key(result), place.target) for result, place in zip(group, places, strict=True))
        rows = sorted(by_scheme, key=_rank(schemes, by_scheme, list(SCHEMES)))
        variations.append(
            Variation(
                title=title_of(experiment, shared[key], telling),
                experiment=experiment,
                variant=variants.pop() if len(variants) == 1 else "",
                settings=shared[key],
                targets=_titles(group, _rank(targets, by_target, PAPER_TARGETS)),
                schemes=tuple(rows),
                baseline=baseline or rows[0],
                samples={cell: sample for metric in metrics for cell, sample in _samples(group, metric).items()},
                place=min(place.variation for place in places),
                shortfalls=_shortfalls(group),
                clouds={target_key(result): result["cloud"] for result in group if "cloud" in result},
                images={target_key(result): result["images"] for result in group if "images" in result},
                complete=_complete(group),
                missing=_missing(group),
                provenance=Provenance.of(group),
            )
        )
    return variations


def _shortfalls(results: Sequence[Result]) -> dict[tuple[str, str], dict[int, tuple[str, ...]]]:
    found: dict[tuple[str, str], dict[int, tuple[str, ...]]] = {}
    for result in sorted(results, key=lambda result: int(result["seed"])):
        if texts := result.get("shortfalls"):
            found.setdefault((target_key(result), result["scheme"]), {})[int(result["seed"])] = tuple(texts)
    return found


def _complete(results: Sequence[Result]) -> dict[tuple[str, str], frozenset[int]]:
    seeds: dict[tuple[str, str], set[int]] = {}
    for result in results:
        if "missing" not in result:
            seeds.setdefault((target_key(result), result["scheme"]), set()).add(int(result["seed"]))
    return {cell: frozenset(each) for cell, each in seeds.items()}


def _missing(results: Sequence[Result]) -> dict[tuple[str, str], dict[int, Missing]]:
    """Return the missing trials that are not complete in another experiment."""
    complete = _complete(results)
    missing: dict[tuple[str, str], dict[int, Missing]] = {}
    for result in sorted(results, key=lambda result: int(result["seed"])):
        cell, seed = (target_key(result), result["scheme"]), int(result["seed"])
        if "missing" in result and seed not in complete.get(cell, ()):
            missing.setdefault(cell, {})[seed] = Missing(**result["missing"])
    return missing


def _samples(results: Sequence[Result], metric: str) -> dict[tuple[str, str, str], dict[int, float]]:
    samples: dict[tuple[str, str, str], dict[int, float]] = {}
    first: dict[tuple[str, str, int], tuple[Result, float | None]] = {}
    for result in results:
        if "missing" in result:
            continue
        target, scheme, seed, value = target_key(result), result["scheme"], result["seed"], _value(result, metric)
        earlier, expected = first.setdefault((target, scheme, seed), (result, value))
        if value != expected:
            values = " and ".join(f"{number} ({_origin(of)})" for of, number in ((earlier, expected), (result, value)))
            raise StoreError(
                f"{_trial(result)}: two results with the same settings differ in {metric}: {values}; leave one out"
            )
        if value is not None:
            samples.setdefault((metric, target, scheme), {})[seed] = value
    return samples


def _value(result: Result, metric: str) -> float | None:
    value: Any = result
    for key in metric.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    if value is None:
        return None
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise StoreError(f"{_trial(result)}: {metric} is {value}, expected a finite number")
    return float(value)


def _trial(result: Result) -> str:
    return f"{result['target_title']}, {result['scheme']}, seed {result['seed']}"


def _origin(result: Result) -> str:
    """Return the folder of a result, or if it is not known, its experiment and identity."""
    return str(result.get("folder") or f"{result['experiment']}, trial {result['identity'][:10]}")


_Place = tuple[int, ...]
_Rank = Callable[[str], tuple[int, _Place, int, str]]
# Sorts after every place in a plan.
_NO_PLACE = (sys.maxsize,)


class _Places(NamedTuple):
    """The places of a result's variation, target and scheme, each with what decides between equal ones."""

    variation: _Place
    target: _Place
    scheme: _Place


def _places(result: Result, experiments: Sequence[str]) -> _Places:
    if "place" not in result:
        return _Places(_NO_PLACE, _NO_PLACE, _NO_PLACE)
    experiment = experiments.index(result["experiment"])
    variant, target, scheme, trial = result["place"]
    return _Places((experiment, variant), (experiment, target, trial), (experiment, scheme, variant, trial))


def _least(places: Iterable[tuple[str, _Place]]) -> dict[str, _Place]:
    """Return the least place of each name."""
    least: dict[str, _Place] = {}
    for name, place in places:
        least[name] = min(place, least.get(name, place))
    return least


def _rank(first: Sequence[str], places: Mapping[str, _Place], known: Sequence[str]) -> _Rank:
    """Return a sort key: names in `first`, then by place, then specs whose name is in `known`, then alphabetically."""

    def rank(spec: str) -> tuple[int, _Place, int, str]:
        name = spec.partition(":")[0]
        asked = first.index(spec) if spec in first else len(first)
        return asked, places[spec], known.index(name) if name in known else len(known), spec

    return rank


def _titles(results: Sequence[Result], rank: _Rank) -> dict[str, str]:
    """Return the title of each target; to a title that several targets share, the target is added."""
    titles = {target_key(result): result["target_title"] for result in reversed(results)}
    every = list(titles.values())
    return {
        target: f"{titles[target]} [{target}]" if every.count(titles[target]) > 1 else titles[target]
        for target in sorted(titles, key=rank)
    }


def shared_settings(result: Result) -> dict[str, Any]:
    """Return all settings of a result that affect its numbers, except target, scheme and seed, by dotted key.

    The schema version and the hashes of the files that the source is made from are among them.
    """
    settings = flatten({key: value for key, value in result["settings"].items() if key not in _NOT_SHARED})
    settings = {key: value for key, value in settings.items() if key not in _WITHOUT_EFFECT}
    settings["schema_version"] = result["schema_version"]
    for key in sorted(settings.keys() & _PATHS):
        # As in a trial's identity, the content of a file counts, and its folder does not.
        settings[key] = settings[key] and file_stem(settings[key])
    for role, sha256 in result.get("inputs", {}).items():
        if role not in ROLES_OF_TARGETS:
            settings["source.sha256" if role == "source" else f"source.{role}.sha256"] = sha256[:12]
    return settings


def target_key(result: Result) -> str:
    """Return the target's name, or that of its file or images: a user's `bunny.ply` is not the target `bunny`."""
    if _TARGET_KEY in result:
        return str(result[_TARGET_KEY])
    target = result["settings"]["targets"][0]
    return str(result["target"]) if target.startswith(_OF_IMAGES) or target.endswith(".json") else Path(target).name


def flatten(nested: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Flatten nested mappings to one, by dotted key."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        flat |= flatten(value, f"{above}{key}.") if isinstance(value, Mapping) else {f"{above}{key}": value}
    return flat


# Names of variations.


def title_of(experiment: str, settings: Settings, keys: Sequence[str]) -> str:
    """Return an experiment's name with the values of some settings: `table1 · fit.steps=100`."""
    values = ", ".join(f"{key}={setting_text(settings[key])}" for key in keys if key in settings)
    return f"{experiment} · {values}" if values else experiment


def differing_keys(settings: Sequence[Settings]) -> list[str]:
    """Return the keys whose values are not the same in all settings, in the order of the settings."""
    keys = dict.fromkeys(key for each in settings for key in each)
    return [key for key in keys if len({json.dumps(each.get(key)) for each in settings}) > 1]


def telling_keys(settings: Sequence[Settings]) -> list[str]:
    """Return the keys that tell settings apart: without those that only some have, and that are the same in these.

    An engine's keys come with `fit.method`, which says enough. All differing keys are returned where settings would
    be alike without them.
    """
    differing = differing_keys(settings)
    values = {key: {json.dumps(each[key]) for each in settings if key in each} for key in differing}
    telling = [key for key in differing if len(values[key]) > 1]

    def number_of_kinds(keys: Sequence[str]) -> int:
        return len({json.dumps([(key, each[key]) for key in keys if key in each]) for each in settings})

    return telling if number_of_kinds(telling) == number_of_kinds(differing) else differing


def variation_names(settings: Sequence[Settings], variants: Sequence[str]) -> list[str]:
    """Name several settings: by their variant, or else by the values in which they differ, `edge=0.1, levels=3`.

    Keys are shortened to their last part where that is unambiguous. Variants are used only if they make names unique.

    Args:
        settings: all different.
        variants: for each of them, the name under which it was run; empty if it had none.
    """
    keys = telling_keys(settings)
    last = {key: key.rpartition(".")[2] for key in keys}
    short = {key: name if list(last.values()).count(name) == 1 else key for key, name in last.items()}
    by_settings = [
        ", ".join(f"{name}={setting_text(each[key])}" for key, name in short.items() if key in each)
        for each in settings
    ]
    names = [variant or name for variant, name in zip(variants, by_settings, strict=True)]
    return names if len(set(names)) == len(names) else by_settings


def natural_order(settings: Sequence[Settings]) -> list[int]:
    """Order settings by the values in which they differ, numbers by size and texts naturally; return their indices."""
    keys = differing_keys(settings)
    return sorted(range(len(settings)), key=lambda place: [_natural(settings[place].get(key)) for key in keys])


_NUMBER = re.compile(r"\d[\d.]*(?:e[-+]?\d+)?")


def without_numbers(text: str) -> str:
    """Return a text with each number replaced by #: texts on the same finding are then equal."""
    return _NUMBER.sub("#", text)


def numbers_in(text: str) -> list[float]:
    """Return the numbers in a text."""
    return [float(number.rstrip(".")) for number in _NUMBER.findall(text)]


def setting_text(value: object) -> str:
    """Return the value of a setting as text."""
    return value if isinstance(value, str) else json.dumps(value)


def _natural(value: object) -> tuple[int, float, list[tuple[int, float, str]]]:
    if value is None:
        return 0, 0.0, []
    if isinstance(value, int | float):
        return 1, float(value), []
    parts = re.findall(r"\d+(?:\.\d+)?|\D+", setting_text(value))
    return 2, 0.0, [(1, 0.0, part) if not part[0].isdigit() else (0, float(part), "") for part in parts]


# Custom schemes. A result names its scheme by a spec, and has the definitions among its settings.


def distinguish_targets(results: Sequence[Result]) -> list[Result]:
    """Distinguish different files of one name: by the labels that their runs gave them, or else by their content."""
    contents: dict[str, dict[str, set[str]]] = {}
    for result in results:
        if content := _content(result):  # not known of all trials that are missing
            by_content = contents.setdefault(target_key(result), {})
            by_content.setdefault(content, set()).add(str(result["target"]))
    several = {key: by_content for key, by_content in contents.items() if len(by_content) > 1}

    def distinguished(result: Result) -> Result:
        key, content = target_key(result), _content(result)
        if key not in several or not content:
            return result
        labels = several[key][content]
        others = {label for other, each in several[key].items() if other != content for label in each}
        own = len(labels) == 1 and not labels & others
        name = next(iter(labels)) if own else f"{result['target']} [{content[:6]}]"
        return {**result, _TARGET_KEY: name, "target_title": name}

    return list(map(distinguished, results))


def _content(result: Mapping[str, Any]) -> str:
    return str(result.get("inputs", {}).get("target", ""))


def distinguish_definitions(results: Sequence[Result]) -> list[Result]:
    """Distinguish different definitions of one scheme by what differs: `mine [edge.end=3/8]`.

    A name has several definitions if one was changed between two runs, or is swept. All other results stay as they are.
    So are different files of one name distinguished; see `distinguish_targets`.
    """
    results = distinguish_targets(results) if all("target" in result for result in results) else list(results)
    definitions: dict[str, dict[str, Mapping[str, Any]]] = {}
    for result in results:
        definition = _definitions(result)
        definitions.setdefault(_scheme_name(result), {})[_key(definition)] = definition
    suffixes = {name: _suffixes(name, by_key) for name, by_key in definitions.items() if len(by_key) > 1}
    return [
        {**result, "scheme": _spec(result) + suffixes[name][_key(_definitions(result))]}
        if (name := _scheme_name(result)) in suffixes
        else result
        for result in results
    ]


def resolve_scheme(results: Sequence[Mapping[str, Any]], text: str) -> str:
    """Return the name under which results have a scheme: their own, or the canonical form of a spec.

    Raises:
        SchemeError: the text is no scheme.
        ConfigError: a result has an invalid definition of it.
    """
    text = scheme_name_for(text)
    if any(result["scheme"] == text for result in results):
        return text
    if spec_of(text).name in SCHEMES:
        return canonical(text)
    define = {name: definition for result in results for name, definition in _definitions(result).items()}
    return canonical(text, registry_with(build(UserSchemes, {"define": define}).define))


def describe_definitions(results: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Describe each custom scheme among the results in one line, by the name that results give it."""
    lines: dict[str, str] = {}
    for result in results:
        if result["scheme"] not in lines and (definitions := _definitions(result)):
            entries = _entries(_scheme_name(result), definitions)
            lines[result["scheme"]] = "; ".join(
                f"{key}: {_entry_text(value)}" for key, value in entries.items() if value is not None
            )
    return lines


def _entry_text(value: object) -> str:
    return f"[{', '.join(map(setting_text, value))}]" if isinstance(value, list) else setting_text(value)


def _scheme_name(result: Mapping[str, Any]) -> str:
    return _spec(result).partition(":")[0]


def _spec(result: Mapping[str, Any]) -> str:
    """Return the scheme as the settings have it, even where the result was renamed."""
    return str(result["settings"].get("schemes", [result["scheme"]])[0])


def _definitions(result: Mapping[str, Any]) -> Mapping[str, Any]:
    define = result["settings"].get("define", {})
    return define if isinstance(define, Mapping) else {}


def _key(definitions: Mapping[str, Any]) -> str:
    return json.dumps(definitions, sort_keys=True)


def _suffixes(name: str, by_key: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Return the suffix of a scheme's name, by the key of its definitions."""
    names = variation_names([_entries(name, definitions) for definitions in by_key.values()], [""] * len(by_key))
    return {key: f" [{differences}]" if differences else "" for key, differences in zip(by_key, names, strict=True)}


def _entries(name: str, definitions: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a scheme's definition, then those of its base below the base's name, by dotted key."""
    base = {key: definition for key, definition in definitions.items() if key != name}
    return flatten(definitions.get(name, {})) | flatten(base)
