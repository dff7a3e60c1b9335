"""From a config's name or path and some overrides to an experiment's settings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from meshfit.config.experiment import SOURCE_FILE_KEYS, ExperimentSettings
from meshfit.config.scheme_files import read_scheme_files, relative_to_folder
from meshfit.config.strict_yaml import Document, parse_value, read_document
from meshfit.config.sweeps import variants_of
from meshfit.errors import ConfigError
from meshfit.paths import CONFIG_SUFFIXES, bundled_folder, missing_file_message
from meshfit.settings import KeyPath, apply_changes, build, deep_merge, nested
from meshfit.specs import suggest
from meshfit.subdivision.custom.definitions import Definition

_INIT = "`meshfit init {}` writes one"


@dataclass(frozen=True)
class Experiment:
    """An experiment's settings, and the name that its results are filed under."""

    name: str
    settings: ExperimentSettings


def bundled_configs() -> dict[str, Path]:
    """The configs that come with meshfit, by name."""
    return {path.stem: path for path in sorted(bundled_folder("configs").glob("*.yaml"))}


def load_experiment(name_or_path: str, overrides: Sequence[str] = ()) -> Experiment:
    """Read a config.

    Args:
        name_or_path: the path of a YAML file, or the name of a bundled config.
        overrides: `key=value` texts such as `fit.steps=500`; values are YAML.

    Raises:
        ConfigError: no such config, or a key or value that is not allowed; with file and line, or the override.
    """
    path = config_path(name_or_path)
    document = read_document(path)
    changes = _parse_overrides(overrides)

    def where(key: KeyPath) -> str:
        return _where(key, document, path, changes)

    data = apply_changes(_with_absolute_paths(document.data, path.parent), changes)
    found = read_scheme_files(data, where)
    settings = build(ExperimentSettings, found.data, lambda key: found.where(key) or where(key))
    variants_of(settings, lambda: where(("sweep",)))
    return Experiment(path.stem, settings)


def load_definitions(name_or_path: str | None) -> dict[str, Definition]:
    """The schemes of the user's own in a config; none where there is no config.

    Raises:
        ConfigError: as `load_experiment`.
    """
    return {} if name_or_path is None else load_experiment(name_or_path).settings.define


def config_path(name_or_path: str) -> Path:
    """The file of a config.

    Raises:
        ConfigError: neither a file nor a bundled config; the nearest name is suggested.
    """
    configs = bundled_configs()
    if name_or_path in configs:
        return configs[name_or_path]
    path = Path(name_or_path)
    if path.is_file():
        return path
    if path.is_dir():
        raise ConfigError(f"{name_or_path}: a directory; the path of a YAML file is needed")
    if path.suffix in CONFIG_SUFFIXES or len(path.parts) > 1:
        raise ConfigError(f"{name_or_path}: {missing_file_message(path, CONFIG_SUFFIXES, _INIT.format(path))}")
    raise ConfigError(f"'{name_or_path}' is no config and no file: {suggest(name_or_path, configs)}")


def _with_absolute_paths(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Files named in a config, of meshes and of schemes, lie relative to it; so a config runs from anywhere."""

    def absolute(value: Any, key: Sequence[str]) -> Any:  # noqa: ANN401  any YAML value
        if isinstance(value, dict):
            return {name: absolute(inner, (*key, *str(name).split("."))) for name, inner in value.items()}
        if key == ("schemes",) or (key[:1] == ("define",) and key[2:] == ("base",)):
            specs = value if isinstance(value, list) else [value]
            placed = [relative_to_folder(spec, folder) if isinstance(spec, str) else spec for spec in specs]
            return placed if isinstance(value, list) else placed[0]
        if key != ("targets",) and not any(tuple(key[-len(path) :]) == path for path in SOURCE_FILE_KEYS):
            return value
        if isinstance(value, list):
            return [absolute(entry, key) for entry in value]
        return str((folder / value).resolve()) if isinstance(value, str) and (folder / value).is_file() else value

    return {key: absolute(value, (key,)) for key, value in data.items()}


def _parse_overrides(overrides: Sequence[str]) -> dict[str, Any]:
    changes: dict[str, Any] = {}
    for text in overrides:
        key, equals, value = text.partition("=")
        parts = key.strip().split(".")
        if not equals or not all(parts):
            raise ConfigError(f"--set {_shown(text)}: 'key=value' is needed, such as fit.steps=500")
        changes = deep_merge(changes, nested(".".join(parts), parse_value(value, f"--set {_shown(text)}")))
    return changes


def _where(key: KeyPath, document: Document, path: Path, changes: dict[str, Any]) -> str:
    if _is_within(key, changes):
        return "--set: "
    line = document.line_of(key)
    return f"{path}: " if line is None else f"{path}, line {line}: "


def _is_within(key: KeyPath, changes: Any) -> bool:  # noqa: ANN401  any YAML value
    """Whether the value at this key, or one that holds it, comes from the changes."""
    for part in key:
        if not isinstance(changes, dict):
            return True
        if part not in changes:
            return False
        changes = changes[part]
    return bool(key)


def _shown(text: str) -> str:
    return " ".join(text.split())
