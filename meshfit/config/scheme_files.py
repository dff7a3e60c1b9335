"""Scheme files: each holds one user-defined scheme, and its path may be used in place of a scheme's name."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from meshfit.config.strict_yaml import Document, read_document
from meshfit.errors import ConfigError
from meshfit.paths import CONFIG_SUFFIXES, is_regular_file, not_a_file_message, path_text
from meshfit.settings import KeyPath, Settings, build, dotted
from meshfit.subdivision.custom.definitions import Definition
from meshfit.subdivision.registry import UserSchemes

_FILE_SPEC = re.compile(r"(?P<path>.*\.ya?ml)(?P<parameters>:.*)?", re.DOTALL)


def scheme_name_for(text: str) -> str:
    """Return a spec with the name of the scheme in place of the path of its file."""
    match = _FILE_SPEC.fullmatch(text.strip())
    return text if match is None else Path(match["path"]).stem + (match["parameters"] or "")


def relative_to_folder(text: str, folder: Path) -> str:
    """Return a spec with the path of its file, if it has one, taken relative to a folder."""
    match = _FILE_SPEC.fullmatch(text.strip())
    return text if match is None else str(folder / match["path"]) + (match["parameters"] or "")


@dataclass(frozen=True)
class SchemeFile:
    """A file that holds a definition."""

    path: Path
    document: Document


@dataclass(frozen=True)
class SettingsWithFiles:
    """Settings together with the definitions in the scheme files that they name.

    Attributes:
        data: the settings: names in place of paths, and under `define` a definition for each file.
        files: the files, by the name of the scheme.
    """

    data: dict[str, Any]
    files: Mapping[str, SchemeFile]

    def where(self, key: KeyPath) -> str:
        """Return the place in a scheme file where a key's value was written; empty if it is not in one."""
        if key[:1] != ("define",) or len(key) < 2 or key[1] not in self.files:
            return ""
        file = self.files[str(key[1])]
        line = file.document.line_of(key[2:])
        return f"{file.path}: " if line is None else f"{file.path}, line {line}: "


def read_scheme_files(data: Mapping[str, Any], where: Callable[[KeyPath], str] = lambda _: "") -> SettingsWithFiles:
    """Read the scheme files that settings name, and those of their bases.

    Args:
        data: settings as plain data, not validated yet; entries that are not specs are left to the validation.
        where: maps the path of a key to the place where it was written.

    Raises:
        ConfigError: a file is missing or is not a YAML mapping, or its scheme has the name of another definition.
    """
    define = data.get("define", {})
    if not isinstance(define, Mapping):
        return SettingsWithFiles(dict(data), {})
    reader = _Reader(dict(define), where)
    for name, definition in define.items():
        reader.define[name] = reader.with_base(definition, ("define", str(name), "base"))
    named = dict(data)
    if isinstance(schemes := data.get("schemes"), list | tuple):
        named["schemes"] = [reader.named(spec, ("schemes", index)) for index, spec in enumerate(schemes)]
    return SettingsWithFiles(named | ({"define": reader.define} if reader.define else {}), reader.files)


def resolve_specs(
    specs: Sequence[str], definitions: Mapping[str, Definition]
) -> tuple[list[str], dict[str, Definition]]:
    """Return specs with names in place of paths, and all definitions that they may name.

    Args:
        specs: as typed by the user.
        definitions: schemes that may be named in addition to those in files.

    Raises:
        ConfigError: as `read_scheme_files`, or a definition that is not allowed; with file and line.
    """
    define = {name: definition.model_dump(mode="json") for name, definition in definitions.items()}
    settings = read_scheme_files({"schemes": list(specs), "define": define})
    schemes = build(UserSchemes, {"define": settings.data.get("define", {})}, settings.where)
    return settings.data["schemes"], schemes.define


class _Reader:
    def __init__(self, define: dict[str, Any], where: Callable[[KeyPath], str]) -> None:
        self.define, self.files = define, dict[str, SchemeFile]()
        self._where = where

    def named(self, spec: Any, key: KeyPath) -> Any:  # noqa: ANN401  any YAML value
        """Return a spec with a name in place of a path, after reading its file."""
        match = _FILE_SPEC.fullmatch(spec.strip()) if isinstance(spec, str) else None
        if match is None:
            return spec
        self._read(Path(match["path"]), key)
        return scheme_name_for(spec)

    def with_base(self, definition: Any, key: KeyPath) -> Any:  # noqa: ANN401  any YAML value
        """Return a definition with a name in place of the path of its base."""
        if not isinstance(definition, Mapping) or "base" not in definition:
            return definition
        return {**definition, "base": self.named(definition["base"], key)}

    def _read(self, path: Path, key: KeyPath) -> None:
        name, where = path.stem, self._where(key)
        place = f"{where}{dotted(key)}: " if where else ""
        if name in self.files:
            if self.files[name].path.resolve() != path.resolve():
                raise ConfigError(f"{place}{path}: {self.files[name].path} defines '{name}' too; rename one")
            return
        if not is_regular_file(path):
            raise ConfigError(f"{place}{path_text(path)}: {not_a_file_message(path, CONFIG_SUFFIXES)}")
        document = read_document(path)
        self.files[name] = SchemeFile(path, document)
        base = document.data.get("base")
        located = {"base": relative_to_folder(base, path.parent)} if isinstance(base, str) else {}
        definition = self.with_base(document.data | located, key)
        if name in self.define and not _are_same(self.define[name], definition):
            raise ConfigError(f"{place}{path}: 'define' has another '{name}'; rename one")
        self.define[name] = definition


class _SingleDefinition(Settings):
    """A single definition, of which the base is not checked."""

    definition: Definition


def _are_same(first: Any, second: Any) -> bool:  # noqa: ANN401  any YAML values
    """Whether two definitions are equal; an invalid one equals no other."""
    try:
        settings = [build(_SingleDefinition, {"definition": definition}) for definition in (first, second)]
    except ConfigError:
        return False
    return settings[0] == settings[1]
