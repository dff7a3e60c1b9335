"""Load the settings of an experiment from the name or path of a config and overrides."""

import hashlib
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from meshfit.config.experiment import ExperimentSettings, canonical_key, with_canonical_keys
from meshfit.config.path_parts import path_part
from meshfit.config.scheme_files import read_scheme_files, relative_to_folder, resolve_specs
from meshfit.config.source_settings import SOURCE_FILE_KEYS
from meshfit.config.strict_yaml import parse_value, read_document
from meshfit.config.sweeps import MOST_TRIALS, variants_of
from meshfit.config.target_settings import TRUTH_KEY
from meshfit.errors import ConfigError, ViewError
from meshfit.images.folders import is_image_folder
from meshfit.images.specs import image_spec
from meshfit.mesh.targets import NAMED_TARGETS
from meshfit.paths import (
    CONFIG_SUFFIXES,
    MESH_SUFFIXES,
    bundled_folder,
    file_stem,
    format_suffix,
    is_folder,
    is_regular_file,
    not_a_file_message,
    path_text,
    quoted_path,
    shell_path,
)
from meshfit.printable import printable
from meshfit.settings import KeyPath, apply_changes, build, deep_merge, nested, takes_list, whole_number
from meshfit.specs import listed, suggest
from meshfit.subdivision.custom.definitions import Definition

_COMPARED = ("targets", "schemes", "sweep")
_COMMAND_KEYS = (("fit", "command"), ("fit", "version_command"))
_LONGEST_NAME = 80
CheckSweep = Callable[[ExperimentSettings, Callable[[], str]], object]
SHARED_PREFIX = "x-"
"""Beginning of the top-level keys of a config that hold no settings, but values for aliases."""


@dataclass(frozen=True)
class Experiment:
    """An experiment.

    Attributes:
        name: of its folder in a run directory.
        settings: its settings.
        changed: the settings of what is compared that are not those of its config: targets, schemes, sweep.
    """

    name: str
    settings: ExperimentSettings
    changed: frozenset[str] = frozenset()


def bundled_configs() -> dict[str, Path]:
    """Return the configs that come with meshfit, by name."""
    return {path.stem: path for path in sorted(bundled_folder("configs").glob("*.yaml"))}


def load_experiment(
    name_or_path: str, overrides: Sequence[str] = (), check_sweep: CheckSweep = variants_of
) -> Experiment:
    """Read a config.

    Args:
        name_or_path: the path of a YAML file, or the name of a bundled config.
        overrides: `key=value` texts such as `fit.steps=500`; values are YAML, or lists without brackets, and paths in
            them are relative to the current directory.
        check_sweep: called with the settings, and with what returns the place of the sweep; it refuses a sweep that
            cannot be used.

    Raises:
        ConfigError: no such config, or a key or value that is not allowed; with file and line, or the override.
    """
    path = config_path(name_or_path)
    document = read_document(path)
    changes = _with_absolute_paths(with_canonical_keys(parse_overrides(overrides)), Path())

    def where(key: KeyPath) -> str:
        if _is_within(key, changes):
            return "--set: "
        line = document.line_of(key)
        return f"{path}: " if line is None else f"{path}, line {line}: "

    written = {key: value for key, value in document.data.items() if not str(key).startswith(SHARED_PREFIX)}
    original = _with_absolute_paths(with_canonical_keys(written), path.parent)
    data = apply_changes(original, changes)
    with_files = read_scheme_files(data, where)
    settings = build(ExperimentSettings, with_files.data, lambda key: with_files.where(key) or where(key))
    check_sweep(settings, lambda: where(("sweep",)))
    defaults = ExperimentSettings().model_dump(mode="json", include=set(_COMPARED))
    pairs = {key: [_in_any_order(each.get(key, defaults[key])) for each in (original, data)] for key in _COMPARED}
    changed = (key for key, (before, after) in pairs.items() if before != after)
    return Experiment(path.stem, settings, frozenset(changed))


def _in_any_order(value: Any) -> Any:  # noqa: ANN401  any YAML value
    return sorted(map(str, value)) if isinstance(value, list | tuple) else value


def load_definitions(name_or_path: str | None) -> dict[str, Definition]:
    """Return the user's own schemes in a config, or none without a config.

    Raises:
        ConfigError: as `load_experiment`.
    """
    return {} if name_or_path is None else load_experiment(name_or_path).settings.define


def config_path(name_or_path: str) -> Path:
    """Return the file of a config.

    Raises:
        ConfigError: neither a file nor a bundled config; the most similar name is suggested.
    """
    configs = bundled_configs()
    if name_or_path in configs:
        return configs[name_or_path]
    path = Path(name_or_path)
    if is_regular_file(path):
        return path
    if format_suffix(path) in CONFIG_SUFFIXES or len(path.parts) > 1 or os.path.lexists(path):
        remedy = f"`meshfit init {shell_path(path)}` writes one"
        raise ConfigError(f"{path_text(name_or_path)}: {not_a_file_message(path, CONFIG_SUFFIXES, remedy)}")
    raise ConfigError(f"'{name_or_path}' is neither a config nor a file: {suggest(name_or_path, configs)}")


def _with_absolute_paths(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Resolve the mesh and scheme files of settings relative to a folder, so that the settings hold anywhere."""

    def absolute(value: Any, key: Sequence[str]) -> Any:  # noqa: ANN401, PLR0911  any YAML value
        if key == ("targets",) and not isinstance(value, list):
            return absolute_target(value, folder)
        if isinstance(value, dict):
            return {name: absolute(inner, (*key, *str(name).split("."))) for name, inner in value.items()}
        if isinstance(value, list):
            is_command = key[-2:] in _COMMAND_KEYS and value and isinstance(value[0], str)
            return _absolute_command(value, folder) if is_command else [absolute(entry, key) for entry in value]
        if not isinstance(value, str):
            return value
        if key == ("schemes",) or (key[:1] == ("define",) and key[2:] == ("base",)):
            return relative_to_folder(value, folder)
        patterns = (TRUTH_KEY, ("target", "landmarks"))
        files = (*SOURCE_FILE_KEYS, *patterns)
        if any(tuple(key[-len(path) :]) == path for path in files):
            is_pattern = tuple(key[-2:]) in patterns and "{" in value
            return str(folder.resolve() / value) if is_pattern else absolute_path(value, folder)
        return value

    return {key: absolute(value, (key,)) for key, value in data.items()}


def absolute_target(value: Any, folder: Path = Path()) -> Any:  # noqa: ANN401  any YAML value
    """Return a target with its paths, relative to a folder, as absolute ones; names remain names."""
    if isinstance(value, dict):
        views = value.get("views")
        if isinstance(views, dict) and isinstance(views.get("of"), str):
            return value | {"views": views | {"of": absolute_path(views["of"], folder)}}
        paths = {key: value[key] for key in ("images", "cameras", "truth") if isinstance(value.get(key), str)}
        return value | {key: _absolute_place(path, folder) for key, path in paths.items()}
    if not isinstance(value, str):
        return value
    if value.startswith(("views:", "images:")):
        try:
            spec = image_spec(value)
        except ViewError:  # validation says what is wrong
            return value
        keys = [key for key in ("of", "images", "cameras", "truth") if getattr(spec, key, "")]
        places: dict[str, Any] = {key: _absolute_place(getattr(spec, key), folder) for key in keys}
        return str(replace(spec, **places))
    return _absolute_place(value, folder) if is_image_folder(folder / value) else absolute_path(value, folder)


def _absolute_place(text: str, folder: Path) -> str:
    """Return the path of a file or folder as an absolute one; names of targets remain names."""
    return text if text in NAMED_TARGETS else os.path.abspath(folder / text)  # noqa: PTH100  keeps links


def _absolute_command(command: list[Any], folder: Path) -> list[Any]:
    """Resolve the files among the arguments of a command; a program without a folder is looked for in the PATH."""

    def is_file(number: int, part: Any) -> bool:  # noqa: ANN401  any YAML value
        is_path = isinstance(part, str) and "{" not in part and (number > 0 or len(Path(part).parts) > 1)
        return is_path and is_regular_file(folder / part)

    return [absolute_path(part, folder) if is_file(*each) else part for each in enumerate(command) for part in each[1:]]


def absolute_path(text: str, folder: Path = Path()) -> str:
    """Return a path relative to a folder as an absolute one, without following a link; names remain names.

    A path relative to the current directory, where there is no such file, stays as the user wrote it.
    """
    path = folder / text
    is_file = os.path.lexists(path) and not is_folder(path)
    is_missing = (
        folder != Path()
        and format_suffix(text) in (*MESH_SUFFIXES, ".txt", ".csv", ".fcsv", ".json")
        and not os.path.lexists(text)
    )
    return str(path.parent.resolve() / path.name) if is_file or is_missing else text


def parse_overrides(overrides: Sequence[str]) -> dict[str, Any]:
    """Return the nested mapping that `key=value` texts set.

    Raises:
        ConfigError: a text of another form, or a value that is not YAML; with a line for each.
    """
    changes: dict[str, Any] = {}
    faults: list[str] = []
    for text in overrides:
        origin = f"--set {' '.join(text.split())}"
        key, equals, value = text.partition("=")
        parts = key.strip().split(".")
        if not equals or not all(parts):
            faults.append(f"{origin}: expected 'key=value', such as fit.steps=500")
            continue
        try:
            changes = deep_merge(changes, nested(".".join(parts), _parse_override(parts, value, origin)))
        except ConfigError as error:
            faults += error.faults
    if faults:
        raise ConfigError(*faults)
    return changes


def _parse_override(parts: Sequence[str], text: str, origin: str) -> Any:  # noqa: ANN401  any YAML value
    """Parse the value of an override: YAML, or a list without brackets."""
    value = parse_value(text, origin)
    in_sweep = parts[0] == "sweep" and parts[1:2] != ["variants"]
    if not isinstance(value, str) or text.strip()[:1] in ("'", '"'):
        return value
    if in_sweep and "," in value:
        return [parse_value(entry, origin) for entry in listed(value)]
    if value.strip() and takes_list(ExperimentSettings, canonical_key(".".join(parts))):
        # A comma may also be part of a file's name.
        return [value] if os.path.lexists(value) else [parse_value(entry, origin) for entry in listed(value)]
    return value


def with_axes(
    experiment: Experiment,
    *,
    targets: str | None = None,
    schemes: Sequence[str] | None = None,
    seeds: str | None = None,
) -> Experiment:
    """Return an experiment with other targets, schemes or seeds, as the options of the command line give them.

    Args:
        experiment: the experiment.
        targets: comma-separated; None keeps those of the experiment.
        schemes: specs, or paths of files that define schemes; None keeps those of the experiment.
        seeds: a number of seeds, or a comma-separated list of seeds; None keeps those of the experiment.

    Raises:
        ConfigError: a value that is not allowed, with the option.
        SchemeError: an unknown scheme.
    """
    changes: dict[str, Any] = {}
    if targets is not None:
        named = [targets] if os.path.lexists(targets) else listed(targets)
        changes["targets"] = [absolute_target(target) for target in named]
    if schemes is not None:
        changes["schemes"], own = resolve_specs(schemes, experiment.settings.define)
        changes["define"] = {name: definition.model_dump(mode="json") for name, definition in own.items()}
    if seeds is not None:
        changes["seeds"] = _seeds(seeds)
    # What is not set stays so, since defaults may depend on a setting that is swept.
    data = apply_changes(experiment.settings.model_dump(exclude_unset=True), changes)
    settings = build(ExperimentSettings, data, lambda key: f"--{key[0]}: " if key[0] in ("targets", "seeds") else "")
    before = experiment.settings
    changed = {key for key in ("targets", "schemes") if set(getattr(settings, key)) != set(getattr(before, key))}
    return replace(experiment, settings=settings, changed=experiment.changed | changed)


def renamed(experiment: Experiment, name: str | None, *, compared: bool = False) -> Experiment:
    """Return an experiment under a given name, or, if what it compares is not that of its config, a name of its own.

    Args:
        experiment: the experiment.
        name: the name; None leaves the choice to this function.
        compared: whether its schemes are compared by name, so that it always has a name of its own.

    Raises:
        ConfigError: the name is not that of a single folder.
    """
    if name is not None:
        return replace(experiment, name=_checked_name(name))
    settings, parts = experiment.settings, [experiment.name]
    if "targets" in experiment.changed:
        parts += [file_stem(target) for target in settings.targets]
    if compared:
        parts.append("-vs-".join(settings.schemes))
    elif "schemes" in experiment.changed:
        parts += settings.schemes
    if "sweep" in experiment.changed:
        parts.append("sweep")
    if len(parts) == 1:
        return experiment
    own = re.sub(r"[^\w.+-]+", "-", "-".join(parts))
    if len(own) > _LONGEST_NAME:
        own = f"{own[: _LONGEST_NAME - 8]}-{hashlib.sha256(own.encode()).hexdigest()[:7]}"
    return replace(experiment, name=own)


def _checked_name(name: str) -> str:
    remedy = "expected the name of one folder, such as loop-only"
    if name.strip() != name or name.startswith((".", "-")):
        raise ConfigError(f"--name {quoted_path(name)}: {remedy}")
    return path_part(name, "--name", remedy)


def _seeds(text: str) -> list[Any]:
    """Return the seeds that a text stands for: 0, 1 and 2 for `3`, 4 and 7 for `4,7`."""
    values = [whole_number(parse_value(entry, "--seeds")) for entry in listed(text)]
    if "," in text:
        return values
    if not (len(values) == 1 and type(values[0]) is int and 1 <= values[0] <= MOST_TRIALS):
        numbers = f"a number of seeds, 1 to {MOST_TRIALS:,}"
        raise ConfigError(f"--seeds: expected {numbers}, or a list such as 4,7, got '{printable(text)}'")
    return list(range(values[0]))


def _is_within(key: KeyPath, changes: Any) -> bool:  # noqa: ANN401  any YAML value
    """Whether the value at a key, or one that contains it, comes from the changes."""
    for part in key:
        if not isinstance(changes, dict):
            return True
        if part not in changes:
            return False
        changes = changes[part]
    return bool(key)
