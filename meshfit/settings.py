"""The base of every settings model: frozen, strict about its keys; and errors that name key, finding and remedy."""

import json
import textwrap
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from meshfit.errors import ConfigError
from meshfit.specs import suggest


class Settings(BaseModel):
    """A frozen group of settings. Unknown keys are refused, and so are NaN and infinity."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        validate_default=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )


Model = TypeVar("Model", bound=Settings)
Key = tuple[str | int, ...]


def build(model: type[Model], data: Mapping[str, Any], where: Callable[[Key], str] = lambda _: "") -> Model:
    """Settings from plain data.

    Args:
        model: which settings.
        data: nested mappings, as a YAML file holds them.
        where: from a key's path to where it was written, put in front of the message.

    Raises:
        ConfigError: for the first key at fault.
    """
    try:
        # By way of JSON, where strictness still takes a list for a tuple and 1 for 1.0, but no "1" and no true.
        return model.model_validate_json(json.dumps(data, default=_plain))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ConfigError(f"{where(first['loc'])}{_describe(model, first)}") from None


def override(settings: Model, changes: Mapping[str, Any]) -> Model:
    """The same settings with some keys changed; a mapping changes only the keys it holds.

    Raises:
        ConfigError: a change that is not allowed.
    """
    return build(type(settings), merged(settings.model_dump(), changes))


def merged(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Nested mappings, one laid over the other."""
    result = dict(data)
    for key, change in changes.items():
        both = isinstance(change, Mapping) and isinstance(result.get(key), Mapping)
        result[key] = merged(result[key], change) if both else change
    return result


def dotted(key: Key) -> str:
    """A key's path as it is written: `fit.losses.edge`, `seeds[2]`."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _describe(model: type[Settings], error: ErrorDetails) -> str:
    key = " ".join(dotted(error["loc"]).split())
    if error["type"] == "json_invalid":
        return f"settings that JSON cannot hold: {error['ctx']['error'].partition(' at line')[0]}"
    if error["type"] == "extra_forbidden":
        allowed = _keys_beside(model, error["loc"])
        return f"{key}: no such key: {suggest(str(error['loc'][-1]), allowed)}"
    if error["type"] == "value_error":
        return f"{key}: {error['ctx']['error']}" if key else str(error["ctx"]["error"])
    found = textwrap.shorten(json.dumps(error["input"], default=str), _LONGEST_SHOWN, placeholder=" …")
    if error["type"] == "literal_error":
        return f"{key}: found {found}; {suggest(str(error['input']), _literals(error['ctx']['expected']))}"
    kind = next((need for prefix, need in _NEEDS.items() if error["type"].startswith(prefix)), None)
    reason = kind or error["msg"].removeprefix("Input should be ")
    return f"{key}: found {found}; {reason} is needed"


_LONGEST_SHOWN = 100

# By the start of pydantic's error type, in words that do not presuppose Python.
_NEEDS = {
    "int": "an integer",
    "float": "a number",
    "finite_number": "a finite number",
    "string": "a text",
    "tuple": "a list",
    "model": "a mapping of keys to values",
    "too_short": "at least one entry",
    "too_long": "a shorter list",
    "missing": "an entry",
}


def _literals(expected: str) -> list[str]:
    return [word.strip("'") for part in expected.split(" or ") for word in part.split(", ")]


def _plain(value: Any) -> Any:  # noqa: ANN401  numpy scalars and paths, from Python callers
    return value.item() if hasattr(value, "item") else str(value)


def _keys_beside(model: type[BaseModel], key: Key) -> list[str]:
    for part in key[:-1]:
        inner = model.model_fields[part].annotation if isinstance(part, str) and part in model.model_fields else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return []
        model = inner
    return list(model.model_fields)
