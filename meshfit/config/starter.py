"""The starter config: every key with its meaning and its default, from the settings models."""

import textwrap
from typing import Any

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.strict_yaml import dump
from meshfit.settings import Settings

_HEADER = """\
# An experiment for `meshfit run`: every target with every scheme and every seed.
# All keys are optional and have their defaults here; delete those that you do not change.
# `meshfit schema` prints the JSON Schema, for completion in an editor.
"""
_WIDTH = 110


def starter_config() -> str:
    """Return the text of a config with every key at its default, each with a comment."""
    return _HEADER + "".join(f"\n{part}" for part in _sections(ExperimentSettings(), 0))


def _sections(settings: Settings, depth: int) -> list[str]:
    indent = "  " * depth
    sections = []
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        comment = " ".join((field.description or "").split())
        lines = textwrap.wrap(comment, _WIDTH - len(indent), break_on_hyphens=False)
        text = "".join(f"{indent}# {line}\n" for line in lines)
        if isinstance(value, Settings):
            text += f"{indent}{name}:\n" + "".join(_sections(value, depth + 1))
        else:
            text += f"{indent}{_entry(name, settings.model_dump(mode='json')[name])}"
        for example in field.examples or ():
            lines = ["For example:", *_entry(name, example).splitlines()]
            text += "".join(f"{indent}# {line}\n" for line in lines)
        sections.append(text)
    return sections


def _entry(name: str, value: Any) -> str:  # noqa: ANN401  any YAML value
    return dump({name: value})
