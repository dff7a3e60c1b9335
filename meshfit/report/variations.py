"""Variations of an experiment: what to call settings that differ, and in which order."""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

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
        ", ".join(f"{name}={shown(some[key])}" for key, name in clear.items() if key in some) for some in settings
    ]
    named = [variant or name for variant, name in zip(variants, by_settings, strict=True)]
    return named if len(set(named)) == len(named) else by_settings


def natural_order(settings: Sequence[Settings]) -> list[int]:
    """The places of some settings, ordered by the values in which they differ: numbers by size, texts naturally."""
    keys = differing_keys(settings)
    return sorted(range(len(settings)), key=lambda place: [_rank(settings[place].get(key)) for key in keys])


def shown(value: object) -> str:
    """A setting's value as titles have it."""
    return value if isinstance(value, str) else json.dumps(value)


def _rank(value: object) -> tuple[int, float, list[tuple[int, float, str]]]:
    if value is None:
        return 0, 0.0, []
    if isinstance(value, int | float):
        return 1, float(value), []
    parts = re.findall(r"\d+(?:\.\d+)?|\D+", shown(value))
    return 2, 0.0, [(1, 0.0, part) if not part[0].isdigit() else (0, float(part), "") for part in parts]
