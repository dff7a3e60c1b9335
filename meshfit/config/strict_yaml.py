"""YAML as people mean it: nothing is ever executed, `1e-3` is a number, `no` is a word, a key may not stand twice."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import yaml

from meshfit.errors import ConfigError
from meshfit.settings import Key


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader with the scalars of YAML 1.2's core schema."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012  PyYAML's own attribute

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse aliases: a few lines of them can stand for a document without end."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(problem="aliases (*name) are not allowed; write the value out")
        return super().compose_node(parent, index)


_Loader.add_implicit_resolver("tag:yaml.org,2002:null", re.compile(r"~|null|Null|NULL|$"), ["~", "n", "N", ""])
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"true|True|false|False"), list("tTfF"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"[-+]?(0|[1-9][0-9]*)$"), list("-+0123456789"))
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$|[-+]?\.(inf|Inf)$|\.(nan|NaN)$"),
    list("-+.0123456789"),
)


class _Dumper(yaml.SafeDumper):
    """PyYAML's safe dumper with lists on one line and no anchors."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002  PyYAML's signature
        """Write equal values out each time."""
        return True

    def represent_list(self, data: Iterable[Any]) -> yaml.SequenceNode:
        """A list as [a, b]."""
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True)


_Dumper.add_representer(list, _Dumper.represent_list)


_KINDS: dict[type[yaml.Node], str] = {yaml.ScalarNode: "single value", yaml.SequenceNode: "list"}


@dataclass(frozen=True)
class Document:
    """A YAML document: its data, and the line that each key was written on."""

    data: dict[str, Any]
    lines: dict[Key, int]


def parse_document(text: str, origin: str) -> Document:
    """Read one YAML mapping.

    Raises:
        ConfigError: not YAML, not a mapping, or a key that stands twice; with the line.
    """
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
    except (yaml.YAMLError, RecursionError) as error:
        raise ConfigError(f"{origin}: {_reason(error)}") from None
    if node is None:
        raise ConfigError(f"{origin}: the file is empty; a mapping of settings is needed")
    if not isinstance(node, yaml.MappingNode):
        raise ConfigError(
            f"{origin}: found a {_KINDS[type(node)]}, a mapping of settings ('key: value' lines) is needed"
        )
    lines: dict[Key, int] = {}
    _walk(node, (), lines, origin)
    try:
        data = loader.construct_document(node)
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigError(f"{origin}: {_reason(error)}") from None
    return Document(data, lines)


def parse_value(text: str, origin: str) -> Any:  # noqa: ANN401  any YAML value
    """Read one YAML value, as `--set key=value` gives it.

    Raises:
        ConfigError: it is not YAML.
    """
    try:
        return yaml.load(text, Loader=_Loader)  # noqa: S506  a SafeLoader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(f"{origin}: {_reason(error)}") from None


def dump(data: dict[str, Any]) -> str:
    """YAML text of plain data: keys in their order, one a line, lists on one line."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=False, width=120)


def _walk(node: yaml.Node, key: Key, lines: dict[Key, int], origin: str) -> None:
    lines.setdefault(key, node.start_mark.line + 1)
    if isinstance(node, yaml.SequenceNode):
        for i, child in enumerate(node.value):
            _walk(child, (*key, i), lines, origin)
    if not isinstance(node, yaml.MappingNode):
        return
    for name, child in node.value:
        inner = (*key, str(name.value))
        line = name.start_mark.line + 1
        if inner in lines:
            raise ConfigError(
                f"{origin}, line {line}: the key '{name.value}' stands twice, first in line {lines[inner]}"
            )
        lines[inner] = line
        _walk(child, inner, lines, origin)


def _reason(error: Exception) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        return f"line {error.problem_mark.line + 1}: not valid YAML: {error.problem}"
    return f"not valid YAML: {' '.join(str(error).split())}"
