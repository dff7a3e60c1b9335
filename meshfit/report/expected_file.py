"""The expected file: the numbers that a reproduction is checked against, as JSON with strict keys."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, JsonValue

from meshfit.errors import ConfigError
from meshfit.settings import Settings, build

SCHEMA_VERSION = 1


class ExpectedCell(Settings):
    """The mean of one cell."""

    target: str
    target_title: str
    scheme: str
    mean: float
    spread: Annotated[float, Field(ge=0)] | None
    seeds: Annotated[tuple[int, ...], Field(min_length=1)]
    tolerance: Annotated[float, Field(ge=0)]


class ExpectedTable(Settings):
    """The cells of one table, and the metric and settings that they are for."""

    metric: str
    experiment: str
    settings: dict[str, JsonValue]
    cells: Annotated[tuple[ExpectedCell, ...], Field(min_length=1)]


class Expected(Settings):
    """The content of an expected file."""

    schema_version: Literal[1]
    tables: Annotated[tuple[ExpectedTable, ...], Field(min_length=1)]


def read_expected(path: Path) -> Expected:
    """Read an expected file.

    Raises:
        ConfigError: it cannot be read, or a key in it is not as it should be.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; `meshfit expect` writes such files") from error
    except ValueError as error:
        raise ConfigError(f"{path}: not valid JSON: {error}; `meshfit expect` writes such files") from None
    return parse_expected(content, f"{path}: ")


def parse_expected(content: object, where: str = "") -> Expected:
    """The content of an expected file, checked.

    Raises:
        ConfigError: a key in it is not as it should be; the message starts with `where`.
    """
    if not isinstance(content, Mapping):
        raise ConfigError(f"{where}found a {type(content).__name__}, a JSON object is needed")
    return build(Expected, content, lambda _: where)
