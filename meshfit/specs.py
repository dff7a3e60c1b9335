"""Specs: a name with parameters, such as `interp-loop:alpha=0.5`, in YAML, on command lines and in tables."""

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass

from meshfit.errors import ConfigError

Value = float | int | str

_SPEC = re.compile(r"(?P<name>[^:=,\s]+)(?::(?P<parameters>.*))?", re.DOTALL)


# A comma before `key=` separates parameters of one spec.
_BETWEEN_ENTRIES = re.compile(r",(?!\s*\w+=)")


@dataclass(frozen=True)
class Spec:
    """A name and its parameters, in the order given."""

    name: str
    parameters: tuple[tuple[str, Value], ...] = ()

    def __str__(self) -> str:
        """Return the spec as text."""
        if not self.parameters:
            return self.name
        return f"{self.name}:" + ",".join(f"{key}={value}" for key, value in self.parameters)


def parse_spec(text: str) -> Spec:
    """Parse `name` or `name:key=value,key=value`.

    Raises:
        ConfigError: the text has another form.
    """
    match = _SPEC.fullmatch(text.strip())
    if match is None:
        raise ConfigError(f"'{text}': expected a name or 'name:key=value,key=value'")
    parameters = match["parameters"]
    pairs = [_parse_pair(pair, text) for pair in parameters.split(",")] if parameters is not None else []
    if len(dict(pairs)) < len(pairs):
        raise ConfigError(f"'{text}': duplicate parameter")
    return Spec(match["name"], tuple(pairs))


def _parse_pair(pair: str, text: str) -> tuple[str, Value]:
    key, equals, value = (part.strip() for part in pair.partition("="))
    if not (key and equals and value):
        raise ConfigError(f"'{text}': expected 'key=value', got '{pair}'")
    return key, _parse_value(value)


def _parse_value(text: str) -> Value:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def suggest(word: str, allowed: Iterable[str]) -> str:
    """Return the end of an error message: the most similar allowed word, if there is one, and all allowed words."""
    words = list(allowed)
    similar = difflib.get_close_matches(word, words, n=1) or [other for other in words if word and word in other]
    hint = f"did you mean '{similar[0]}'? " if similar else ""
    return f"{hint}allowed: {', '.join(words)}"


def listed(text: str) -> list[str]:
    """Split a list without brackets at its commas: `interp-loop:alpha=0,valence3=zorin,loop` has two entries."""
    return [entry.strip() for entry in _BETWEEN_ENTRIES.split(text) if entry.strip()]


def spec_folder(spec: str) -> str:
    """Return the name of the folder for the trials of a spec: `interp-loop-alpha-0.5`."""
    return spec.replace(":", "-").replace("=", "-").replace(",", "-")
