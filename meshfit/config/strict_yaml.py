"""Strict YAML: nothing is executed, `1e-3` is a number, `no` is a word, and keys must be unique.

Anchors, aliases and merge keys (`<<: *name`) are read, up to a number of nodes.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from meshfit.errors import ConfigError
from meshfit.settings import KeyPath

MOST_BYTES = 2_000_000
"""The largest size of a document."""
MOST_NODES = 120_000
"""The most nodes of a document."""
MOST_COPIES = 10_000
"""The most nodes (values, lists and mappings) that the aliases of a document may add to it."""

_KINDS: dict[type[yaml.Node], str] = {yaml.ScalarNode: "single value", yaml.SequenceNode: "list"}
_MERGE = "<<"


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader with the scalars of YAML 1.2's core schema."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012  PyYAML's own attribute

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._open: set[str] = set()
        self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse tags, aliases of the value that they stand in, and a document that is too large."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        anchor = getattr(event, "anchor", None)
        refused = None
        if isinstance(event, yaml.AliasEvent) and anchor in self._open:
            refused = f"*{anchor} stands inside &{anchor}, which would never end"
        elif getattr(event, "tag", None) not in (None, "!"):
            refused = "tags (!name) are not allowed; write the value out"
        self._nodes += 1
        if self._nodes > MOST_NODES:
            refused = f"more than {MOST_NODES:,} values; expected fewer"
        if refused is not None:
            raise yaml.composer.ComposerError(problem=refused, problem_mark=event.start_mark)
        if isinstance(event, yaml.AliasEvent) or anchor is None:
            return super().compose_node(parent, index)
        self._open.add(anchor)
        node = super().compose_node(parent, index)
        self._open.discard(anchor)
        return node


class _Expansion:
    """Copies of nodes in place of aliases and merge keys, so that every node of a document has one parent.

    Attributes:
        faults: a line for each duplicate key.
    """

    def __init__(self, origin: str) -> None:
        self.faults: list[str] = []
        self._origin = origin
        self._seen: set[int] = set()
        self._copies = 0
        self._line = 1  # of the last node that is not a copy

    def __call__(self, node: yaml.Node) -> yaml.Node:
        """Return the node with all below it copied.

        Raises:
            ConfigError: too many copies, or something other than mappings to merge.
        """
        self._count(node)
        if isinstance(node, yaml.SequenceNode):
            entries = [self(entry) for entry in node.value]
            return yaml.SequenceNode(node.tag, entries, node.start_mark, node.end_mark, node.flow_style)
        if isinstance(node, yaml.MappingNode):
            return yaml.MappingNode(node.tag, self._pairs(node), node.start_mark, node.end_mark, node.flow_style)
        return node

    def _count(self, node: yaml.Node) -> None:
        if id(node) not in self._seen:
            self._seen.add(id(node))
            self._line = node.start_mark.line + 1
            return
        self._copies += 1
        if self._copies > MOST_COPIES:
            raise ConfigError(
                f"{self._origin}, line {self._line}: aliases (*name) make more than {MOST_COPIES:,} values; "
                "use fewer of them"
            )

    def _pairs(self, node: yaml.MappingNode) -> list[tuple[yaml.Node, yaml.Node]]:
        """Return the keys of a mapping with their values; its own keys win over those that are merged."""
        own: dict[str, yaml.Node] = {}
        for key, _ in node.value:
            name = str(key.value)
            if name in own:
                line, first = key.start_mark.line + 1, own[name].start_mark.line + 1
                shown = " ".join(name.split())
                self.faults.append(f"{self._origin}, line {line}: duplicate key '{shown}' (first on line {first})")
            own.setdefault(name, key)
        pairs: list[tuple[yaml.Node, yaml.Node]] = []
        for key, value in node.value:
            if not _is_merge_key(key):
                pairs.append((self(key), self(value)))
                continue
            merged: dict[str, tuple[yaml.Node, yaml.Node]] = {}
            for mapping in self._merged(key, value):
                for pair in mapping.value:
                    merged.setdefault(str(pair[0].value), pair)
            pairs += [pair for name, pair in merged.items() if name not in own]
        return pairs

    def _merged(self, key: yaml.Node, value: yaml.Node) -> list[yaml.Node]:
        """Return the mappings that a merge key names, with their own merge keys resolved; the first wins."""
        mappings = value.value if isinstance(value, yaml.SequenceNode) else [value]
        for mapping in mappings:
            if not isinstance(mapping, yaml.MappingNode):
                raise ConfigError(
                    f"{self._origin}, line {key.start_mark.line + 1}: {_MERGE}: expected a mapping such as *name, or a "
                    f"list of them, got a {_KINDS[type(mapping)]}"
                )
        return [self(mapping) for mapping in mappings]


def _is_merge_key(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and node.value == _MERGE and node.style is None


# A number such as 012 stays a word: some parsers read twelve, others ten.
_INT = r"[-+]?(0|[1-9][0-9]*)"
_FLOAT = r"(?![-+]?0[0-9])[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
for _tag, _pattern, _first in (
    ("null", "~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", "true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", _INT, list("-+0123456789")),
    ("float", _FLOAT, list("-+.0123456789")),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(rf"(?:{_pattern})\Z"), _first)


class _Dumper(yaml.SafeDumper):
    """PyYAML's safe dumper with lists on one line and no anchors."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002  PyYAML's signature
        """Write equal values in full each time."""
        return True

    def represent_list(self, data: Iterable[Any]) -> yaml.SequenceNode:
        """Write a list as [a, b]."""
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True)


_Dumper.add_representer(list, _Dumper.represent_list)
# Quote words that YAML 1.1 or 1.2 would take for something else.
_Dumper.yaml_implicit_resolvers = {
    first: yaml.SafeDumper.yaml_implicit_resolvers.get(first, []) + _Loader.yaml_implicit_resolvers.get(first, [])
    for first in {*yaml.SafeDumper.yaml_implicit_resolvers, *_Loader.yaml_implicit_resolvers}
}


@dataclass(frozen=True)
class Document:
    """A YAML document: its data, and the line of each key."""

    data: dict[str, Any]
    lines: dict[KeyPath, int]

    def line_of(self, key: KeyPath) -> int | None:
        """Return the line of a key, or of the nearest key that contains it; None for the document as a whole."""
        while key and key not in self.lines:
            key = key[:-1]
        return self.lines[key] if key else None


def read_document(path: Path) -> Document:
    """Read a file that holds one YAML mapping.

    Raises:
        ConfigError: the file cannot be read, or is invalid; with the line.
    """
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise ConfigError(f"{path}: larger than {MOST_BYTES // 1_000_000} MB; expected a config, which is smaller")
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_document(text, str(path))


def parse_document(text: str, origin: str) -> Document:
    """Parse one YAML mapping.

    Args:
        text: of the document.
        origin: its name in messages, usually a path.

    Raises:
        ConfigError: invalid YAML, another value than a mapping, or a duplicate key; with the line.
    """
    loader, node = _compose(text, origin)
    if node is None:
        raise ConfigError(f"{origin}: the file is empty; expected a mapping of settings, such as `meshfit init` writes")
    if not isinstance(node, yaml.MappingNode):
        raise ConfigError(f"{origin}: expected a mapping of settings ('key: value' lines), got a {_KINDS[type(node)]}")
    lines: dict[KeyPath, int] = {}
    return Document(_construct(loader, node, lines, origin), lines)


def parse_value(text: str, origin: str) -> Any:  # noqa: ANN401  any YAML value
    """Parse one YAML value, such as that of `--set key=value`.

    Raises:
        ConfigError: invalid YAML, or a duplicate key.
    """
    loader, node = _compose(text, origin)
    return None if node is None else _construct(loader, node, {}, origin)


def dump(data: dict[str, Any]) -> str:
    """Return plain data as YAML text: keys in their order, one per line; lists on one line."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=False, width=120)


def _compose(text: str, origin: str) -> tuple[_Loader, yaml.Node | None]:
    try:
        loader = _Loader(text)
        return loader, loader.get_single_node()
    except yaml.YAMLError as error:
        raise ConfigError(f"{origin}: {_reason(error)}") from None
    except RecursionError:
        raise ConfigError(f"{origin}: nested too deeply") from None


def _construct(loader: _Loader, node: yaml.Node, lines: dict[KeyPath, int], origin: str) -> Any:  # noqa: ANN401
    try:
        expansion = _Expansion(origin)
        node = expansion(node)
        if expansion.faults:
            raise ConfigError(*dict.fromkeys(expansion.faults))
        _record_lines(node, (), lines)
        return loader.construct_document(node)
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigError(f"{origin}: {_reason(error)}") from None
    except RecursionError:
        raise ConfigError(f"{origin}: nested too deeply") from None


def _record_lines(node: yaml.Node, key: KeyPath, lines: dict[KeyPath, int]) -> None:
    """Record the line of each key and entry; that of an alias is the line of its anchor."""
    lines.setdefault(key, node.start_mark.line + 1)
    if isinstance(node, yaml.SequenceNode):
        for i, child in enumerate(node.value):
            _record_lines(child, (*key, i), lines)
    if isinstance(node, yaml.MappingNode):
        for name, child in node.value:
            inner = (*key, str(name.value))
            lines[inner] = name.start_mark.line + 1
            _record_lines(child, inner, lines)


def _reason(error: Exception) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        return f"line {error.problem_mark.line + 1}: not valid YAML: {error.problem}"
    return f"not valid YAML: {' '.join(str(error).split())}"
