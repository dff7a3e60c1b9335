"""Base of all settings models, changes to settings, and errors that name the key, the value and the remedy."""

import json
import textwrap
from collections.abc import Callable, Mapping
from types import UnionType
from typing import Annotated, Any, TypeGuard, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler, Tag, ValidationError
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails

from meshfit.errors import ConfigError
from meshfit.specs import suggest

KIND_KEY, DEFAULT_KIND = "method", "first-order"
"""The key that selects among several kinds of settings, and the kind of settings without it."""

MOST_PARTS = 16
"""The most parts of a dotted key."""
_LONGEST_VALUE = 100
_MOST_FAULTS = 20
_LARGEST_EXACT = 2**53
"""The largest integer up to which every integer is a float."""
# By the start of pydantic's error type, in words for readers who do not know Python.
_EXPECTED = {
    "int": "an integer",
    "float": "a number",
    "finite_number": "a finite number",
    "string": "text",
    "tuple": "a list, such as [a, b]",
    "model": "a mapping of keys to values",
    "dict": "a mapping of keys to values",
    "too_short": "at least one entry",
    "too_long": "a shorter list",
    "greater_than_equal": "a number of {ge:.12g} or more",
    "greater_than": "a number above {gt:.12g}",
    "less_than_equal": "a number of {le:.12g} or less",
    "less_than": "a number below {lt:.12g}",
}
# pydantic's last part of the location where the key of a mapping is at fault, not its value.
_AT_KEY = "[key]"


class Settings(BaseModel):
    """A frozen group of settings that refuses unknown keys, NaN and infinity."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        validate_default=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )

    @classmethod
    def with_dependent_defaults(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return plain data with the defaults that depend on other values; `build` adds them."""
        return data

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe the settings by the text of their docstring, without its example."""
        described = handler.resolve_ref_schema(handler(schema))
        if "description" in described:
            described["description"] = described["description"].partition("\n\nExample:")[0]
        return described


Model = TypeVar("Model", bound=Settings)
KeyPath = tuple[str | int, ...]


def build(model: type[Model], data: Mapping[str, Any], where: Callable[[KeyPath], str] = lambda _: "") -> Model:
    """Validate plain data as settings.

    Args:
        model: the class of the settings.
        data: nested mappings, as a YAML file holds them.
        where: maps the path of a key to the place where it was written, with which the message begins.

    Raises:
        ConfigError: with a line for each key at fault.
    """
    try:
        # Through JSON, where strict validation takes a list for a tuple and 1 for 1.0, but neither "1" nor true.
        complete = _with_integers(model, model.with_dependent_defaults(data))
        return model.model_validate_json(json.dumps(complete, default=_to_plain))
    except ValidationError as error:
        faults: dict[KeyPath, str] = {}
        listed: set[KeyPath] = set()
        for details in _reported(error.errors(include_url=False)):
            details["loc"], keys = _without_tags(model, details["loc"])
            if details["type"] == "union_tag_invalid":
                details["loc"] = (*details["loc"], KIND_KEY)
            message = _message(details, keys)
            if details["type"] == "extra_forbidden":
                above = details["loc"][:-1]
                message = message.partition("allowed: ")[0].rstrip(": ") if above in listed else message
                listed.add(above)
            # Of several types that a value could have, the first.
            faults.setdefault(details["loc"], f"{where(details['loc'])}{message}")
        shown = list(faults.values())[:_MOST_FAULTS]
        more = [f"and {len(faults) - len(shown)} more faults"] if len(faults) > len(shown) else []
        raise ConfigError(*shown, *more) from None


def override(settings: Model, changes: Mapping[str, Any]) -> Model:
    """Return settings with some keys changed; a mapping changes only the keys it holds.

    Raises:
        ConfigError: a change that is not allowed.
    """
    return build(type(settings), apply_changes(settings.model_dump(), changes))


def deep_merge(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Merge nested mappings; the second wins."""
    return _merge(data, changes, _are_mappings)


def apply_changes(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Merge changes into settings; a change to another kind of settings replaces them as a whole."""
    return _merge(data, changes, _are_of_one_kind)


def nested(key: str, value: Any) -> dict[str, Any]:  # noqa: ANN401  any YAML value
    """Return the mapping that sets a dotted key: `fit.steps`, 5 → {"fit": {"steps": 5}}.

    Raises:
        ConfigError: the key has more parts than any setting.
    """
    parts = key.split(".")
    if len(parts) > MOST_PARTS:
        raise ConfigError(
            f"{'.'.join(parts[:3])}…: no such key: it has {len(parts):,} parts; settings have {MOST_PARTS} or fewer"
        )
    for part in reversed(parts):
        value = {part: value}
    result: dict[str, Any] = value
    return result


def takes_list(model: type[BaseModel], key: str) -> bool:
    """Return whether the setting at a dotted key is a list; for settings of several kinds, in any of them."""
    kinds: list[Any] = [model]
    for part in key.split("."):
        kinds = [
            kind
            for above in kinds
            if _is_model(above) and part in above.model_fields
            for kind in _alternatives(above.model_fields[part].annotation)
        ]
    return any(get_origin(kind) in (list, tuple) for kind in kinds)


def _alternatives(annotation: Any) -> list[Any]:  # noqa: ANN401  any annotation
    """Return the types of a union, without what annotates them."""
    if get_origin(annotation) is Annotated:
        return _alternatives(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [kind for part in get_args(annotation) for kind in _alternatives(part)]
    return [annotation]


def dotted(key: KeyPath) -> str:
    """Return the path of a key as text: `fit.losses.edge`, `seeds[2]`."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _merge(data: Mapping[str, Any], changes: Mapping[str, Any], merges: Callable[[Any, Any], bool]) -> dict[str, Any]:
    result: dict[str, Any] = dict(data)
    for key, change in changes.items():
        result[key] = _merge(result[key], change, merges) if merges(result.get(key), change) else change
    return result


def _are_mappings(value: Any, change: Any) -> bool:  # noqa: ANN401  any YAML values
    return isinstance(value, Mapping) and isinstance(change, Mapping)


def _are_of_one_kind(value: Any, change: Any) -> bool:  # noqa: ANN401  any YAML values
    if not _are_mappings(value, change):
        return False
    return KIND_KEY not in change or change[KIND_KEY] == value.get(KIND_KEY, DEFAULT_KIND)


def _with_integers(kind: Any, value: Any) -> Any:  # noqa: ANN401  any annotation and YAML value
    """Return a value with whole numbers such as 1e2 and 100.0 as integers where its type has integers, not numbers."""
    alternatives = _alternatives(kind)
    if int in alternatives and float not in alternatives:
        return whole_number(value)
    if isinstance(value, Mapping):
        tagged = _tagged_models(kind).get(str(value.get(KIND_KEY, DEFAULT_KIND)))
        model = tagged or next(filter(_is_model, alternatives), None)
        if model is not None:
            fields = model.model_fields
            return {
                key: _with_integers(fields[key].annotation, inner) if key in fields else inner
                for key, inner in value.items()
            }
    for alternative in alternatives:
        parts = get_args(alternative)
        if get_origin(alternative) is dict and isinstance(value, Mapping):
            return {key: _with_integers(parts[1], inner) for key, inner in value.items()}
        if get_origin(alternative) in (list, tuple) and isinstance(value, list | tuple):
            kinds = parts if len(parts) == len(value) and parts[-1] is not ... else [parts[0]] * len(value)
            return [_with_integers(part, inner) for part, inner in zip(kinds, value, strict=True)]
    return value


def whole_number(value: Any) -> Any:  # noqa: ANN401  any YAML value
    """Return a whole number such as 1e2 or 100.0 as an integer, and any other value as it is."""
    is_whole = isinstance(value, float) and value.is_integer() and abs(value) <= _LARGEST_EXACT
    return int(value) if is_whole else value


def _to_plain(value: Any) -> Any:  # noqa: ANN401  numpy scalars and paths, from Python callers
    return value.item() if hasattr(value, "item") and getattr(value, "shape", ()) == () else str(value)


def _reported(errors: list[ErrorDetails]) -> list[ErrorDetails]:
    """Return the errors to report: of entries rather than of their list, of misspelt keys rather than missing ones."""
    misspelt = {error["loc"][:-1] for error in errors if error["type"] == "extra_forbidden"}
    containing = {error["loc"][:end] for error in errors for end in range(len(error["loc"]))}
    return [
        error
        for error in errors
        if error["loc"] not in containing and not (error["type"] == "missing" and error["loc"][:-1] in misspelt)
    ]


def _message(error: ErrorDetails, allowed_keys: list[str]) -> str:
    key, context = " ".join(dotted(error["loc"]).split()), error.get("ctx", {})
    if error["type"] == "json_invalid":
        return f"settings that JSON cannot hold: {context['error'].partition(' at line')[0]}"
    reason = _reason(error, context, allowed_keys)
    return f"{key}: {reason}" if key else reason


def _reason(error: ErrorDetails, context: dict[str, Any], allowed_keys: list[str]) -> str:
    value = textwrap.shorten(json.dumps(error["input"], default=str), _LONGEST_VALUE, placeholder=" …")
    match error["type"]:
        case "extra_forbidden":
            return f"no such key: {suggest(str(error['loc'][-1]), allowed_keys)}"
        case "missing":
            return "missing"
        case "value_error":
            return str(context["error"])
        case "union_tag_invalid":
            return f'got "{context["tag"]}"; {suggest(context["tag"], _literals(context["expected_tags"]))}'
        case "literal_error":
            return f"got {value}; {suggest(str(error['input']), _literals(context['expected']))}"
    expected = next((text for prefix, text in _EXPECTED.items() if error["type"].startswith(prefix)), "")
    text = f"expected {expected.format(**context) or error['msg'].removeprefix('Input should be ')}, got {value}"
    plain = str(error["input"]).replace("_", "").replace(",", "")
    is_grouped = error["type"].startswith(("int", "float")) and isinstance(error["input"], str) and plain.isdecimal()
    return f"{text}; write {plain}" if is_grouped else text


def _literals(expected: str) -> list[str]:
    return [word.strip("'") for part in expected.split(" or ") for word in part.split(", ")]


def _without_tags(model: type[BaseModel], path: KeyPath) -> tuple[KeyPath, list[str]]:
    """Return an error's path without the tags by which pydantic tells models apart, and the keys allowed there."""
    if path[-1:] == (_AT_KEY,):
        path = path[:-1]
    keys: list[str | int] = []
    kind: Any = model
    for part in path[:-1]:
        tagged = _tagged_models(kind)
        if part in tagged:
            kind = tagged[str(part)]
            continue
        keys.append(part)
        kind = _type_at(kind, part)
    last = () if set(path[-1:]) & _tagged_models(kind).keys() else path[-1:]
    return (*keys, *last), list(kind.model_fields) if _is_model(kind) else []


def _is_model(kind: Any) -> TypeGuard[type[BaseModel]]:  # noqa: ANN401  any annotation
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _type_at(kind: Any, key: str | int) -> Any:  # noqa: ANN401  any annotation
    """Return the type of the value at a key."""
    if _is_model(kind):
        annotation = kind.model_fields[key].annotation if key in kind.model_fields else None
        # A model or null is a model.
        return next((part for part in get_args(annotation) if _is_model(part)), annotation)
    return get_args(kind)[1] if get_origin(kind) is dict else None


def _tagged_models(kind: Any) -> dict[str, type[BaseModel]]:  # noqa: ANN401  any annotation
    """Return the models of a value that may be of several, by their tags."""
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    tagged = [get_args(part) for part in get_args(kind) if get_origin(part) is Annotated]
    return {part[1].tag: part[0] for part in tagged if len(part) == 2 and isinstance(part[1], Tag)}
