"""Specs: a name with its parameters, `interp-loop:alpha=0.5`, written alike in YAML, on command lines and in tables."""

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass

from meshfit.errors import ConfigError

Value = float | int | str

_SPEC = re.compile(r"(?P<name>[^:=,\s]+)(?::(?P<parameters>.*))?", re.DOTALL)


@dataclass(frozen=True)
class Spec:
    """A name and its parameters, as written by the user."""

    name: str
    parameters: tuple[tuple[str, Value], ...] = ()

    def __str__(self) -> str:
        """The spec in its written form, parameters in the order given."""
        if not self.parameters:
            return self.name
        return f"{self.name}:" + ",".join(f"{key}={value}" for key, value in self.parameters)


def parse_spec(text: str) -> Spec:
    """Read `name` or `name:key=value,key=value`.

    Raises:
        ConfigError: the text does not have that form.
    """
    found = _SPEC.fullmatch(text.strip())
    if found is None:
        raise ConfigError(f"'{text}' is not a name or 'name:key=value,key=value'")
    parameters = found["parameters"]
    pairs = [_parse_pair(pair, text) for pair in parameters.split(",")] if parameters is not None else []
    if len(dict(pairs)) < len(pairs):
        raise ConfigError(f"'{text}': a parameter stands twice")
    return Spec(found["name"], tuple(pairs))


def _parse_pair(pair: str, text: str) -> tuple[str, Value]:
    key, equals, value = (part.strip() for part in pair.partition("="))
    if not (key and equals and value):
        raise ConfigError(f"'{text}': '{pair}' is not 'key=value'")
    return key, _parse_value(value)


def _parse_value(text: str) -> Value:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def suggest(word: str, allowed: Iterable[str]) -> str:
    """A phrase for an error message: the nearest allowed word, if one is near, and all that are allowed."""
    words = list(allowed)
    near = difflib.get_close_matches(word, words, n=1) or [other for other in words if word and word in other]
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"{hint}allowed: {', '.join(words)}"
