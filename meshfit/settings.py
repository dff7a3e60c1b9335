"""The base of every settings model: frozen, strict about its keys; and errors that name key, finding and remedy."""

import json
import textwrap
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeGuard, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Tag, ValidationError
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


KIND_KEY, DEFAULT_KIND = "method", "first-order"
"""The key by which settings that may be of several kinds are told apart, and the kind of those that lack it."""

Model = TypeVar("Model", bound=Settings)
KeyPath = tuple[str | int, ...]


def build(model: type[Model], data: Mapping[str, Any], where: Callable[[KeyPath], str] = lambda _: "") -> Model:
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
        first = _first(error.errors(include_url=False))
        first["loc"], keys = _followed(model, first["loc"])
        if first["type"] == "union_tag_invalid":
            first["loc"] = (*first["loc"], KIND_KEY)
        raise ConfigError(f"{where(first['loc'])}{_describe(first, keys)}") from None


def override(settings: Model, changes: Mapping[str, Any]) -> Model:
    """The same settings with some keys changed; a mapping changes only the keys it holds.

    Raises:
        ConfigError: a change that is not allowed.
    """
    return build(type(settings), apply_changes(settings.model_dump(), changes))


def deep_merge(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Nested mappings, one laid over the other."""
    return _joined(data, changes, _are_mappings)


def apply_changes(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with changes laid over them; changes that name another kind of settings replace those that are there."""
    return _joined(data, changes, _are_of_one_kind)


def nested(key: str, value: Any) -> dict[str, Any]:  # noqa: ANN401  any YAML value
    """The mapping that sets a dotted key: `fit.steps`, 5 → {"fit": {"steps": 5}}."""
    first, dot, rest = key.partition(".")
    return {first: nested(rest, value) if dot else value}


def _joined(data: Mapping[str, Any], changes: Mapping[str, Any], join: Callable[[Any, Any], bool]) -> dict[str, Any]:
    result: dict[str, Any] = dict(data)
    for key, change in changes.items():
        result[key] = _joined(result[key], change, join) if join(result.get(key), change) else change
    return result


def _are_mappings(before: Any, change: Any) -> bool:  # noqa: ANN401  any YAML values
    return isinstance(before, Mapping) and isinstance(change, Mapping)


def _are_of_one_kind(before: Any, change: Any) -> bool:  # noqa: ANN401  any YAML values
    return _are_mappings(before, change) and (
        KIND_KEY not in change or change[KIND_KEY] == before.get(KIND_KEY, DEFAULT_KIND)
    )


def dotted(key: KeyPath) -> str:
    """A key's path as it is written: `fit.losses.edge`, `seeds[2]`."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _first(errors: list[ErrorDetails]) -> ErrorDetails:
    """The error to tell of: a key that is misspelt rather than that the right one is missing."""
    first = errors[0]
    beside = [one for one in errors if one["type"] == "extra_forbidden" and one["loc"][:-1] == first["loc"][:-1]]
    return beside[0] if beside and first["type"] == "missing" else first


def _describe(error: ErrorDetails, allowed: list[str]) -> str:
    key = " ".join(dotted(error["loc"]).split())
    if error["type"] == "json_invalid":
        return f"settings that JSON cannot hold: {error['ctx']['error'].partition(' at line')[0]}"
    if error["type"] == "extra_forbidden":
        return f"{key}: no such key: {suggest(str(error['loc'][-1]), allowed)}"
    if error["type"] == "value_error":
        return f"{key}: {error['ctx']['error']}" if key else str(error["ctx"]["error"])
    if error["type"] == "union_tag_invalid":
        tag = error["ctx"]["tag"]
        return f'{key}: found "{tag}"; {suggest(tag, _literals(error["ctx"]["expected_tags"]))}'
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
    "tuple": "a list, such as [a, b],",
    "model": "a mapping of keys to values",
    "dict": "a mapping of keys to values",
    "too_short": "at least one entry",
    "too_long": "a shorter list",
    "missing": "an entry",
}


def _literals(expected: str) -> list[str]:
    return [word.strip("'") for part in expected.split(" or ") for word in part.split(", ")]


def _plain(value: Any) -> Any:  # noqa: ANN401  numpy scalars and paths, from Python callers
    return value.item() if hasattr(value, "item") else str(value)


def _followed(model: type[BaseModel], path: KeyPath) -> tuple[KeyPath, list[str]]:
    """Where an error is, without the tags by which pydantic tells models apart, and the keys that may stand there."""
    if path[-1:] == (_NAME_OF_KEY,):
        path = path[:-1]
    shown: list[str | int] = []
    kind: Any = model
    for part in path[:-1]:
        tagged = _tagged(kind)
        if part in tagged:
            kind = tagged[str(part)]
            continue
        shown.append(part)
        kind = _kind_at(kind, part)
    last = () if set(path[-1:]) & _tagged(kind).keys() else path[-1:]
    return (*shown, *last), list(kind.model_fields) if _is_model(kind) else []


# By which pydantic tells that a mapping's key is at fault, and not the value.
_NAME_OF_KEY = "[key]"


def _is_model(kind: Any) -> TypeGuard[type[BaseModel]]:  # noqa: ANN401  any annotation
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _kind_at(kind: Any, key: str | int) -> Any:  # noqa: ANN401  any annotation
    """The type of the value at a key."""
    if _is_model(kind):
        found = kind.model_fields[key].annotation if key in kind.model_fields else None
        # A model or null is a model.
        return next((part for part in get_args(found) if _is_model(part)), found)
    return get_args(kind)[1] if get_origin(kind) is dict else None


def _tagged(kind: Any) -> dict[str, type[BaseModel]]:  # noqa: ANN401  any annotation
    """The models that a value may be of, by tag, where there are several."""
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    tagged = [get_args(part) for part in get_args(kind) if get_origin(part) is Annotated]
    return {part[1].tag: part[0] for part in tagged if len(part) == 2 and isinstance(part[1], Tag)}
