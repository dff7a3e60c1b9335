"""JSON objects of a file, whose members are checked when they are read, so that an error names the member."""

import copy
import json
import math
from typing import Any, NoReturn

from meshfit.errors import MeshError

_LONGEST = 40
_LARGEST_INTEGER = 2**53


class JsonObject:
    """A JSON object and its place in the file, such as `accessors[3].sparse`."""

    def __init__(self, members: dict[str, Any], place: str = "") -> None:
        self._members = members
        self.place = place

    @classmethod
    def parse(cls, content: bytes) -> "JsonObject":
        """Return the object that a whole JSON text holds.

        Raises:
            MeshError: not JSON in UTF-8, or not an object.
        """
        try:
            members = json.loads(content.decode("utf-8-sig"), parse_constant=_refuse_constant)
        except json.JSONDecodeError as error:
            raise MeshError(f"its JSON is damaged at line {error.lineno}, column {error.colno}") from None
        except UnicodeDecodeError as error:
            raise MeshError(f"its JSON is not UTF-8 text: byte {error.start}") from None
        except (ValueError, RecursionError):  # an integer of thousands of digits, or thousands of brackets
            raise MeshError("its JSON is damaged") from None
        if not isinstance(members, dict):
            raise MeshError(f"expected a JSON object, got {_shown(members)}")
        return cls(members)

    def __contains__(self, key: str) -> bool:
        return self._members.get(key) is not None

    def names(self) -> list[str]:
        """Return the names of the members."""
        return list(self._members)

    def plain(self) -> dict[str, Any]:
        """Return a copy of the members, whatever they are."""
        return copy.deepcopy(self._members)

    def integer(self, key: str, default: int | None = None, least: int = 0) -> int:
        """Return an integer of at least `least`; the default, if there is one, in the place of a missing member."""
        value = self._members.get(key, default)
        number = _integer(value)
        if number is None or number < least:
            self._fail(key, f"an integer of at least {least}", value)
        return number

    def integers(self, key: str) -> list[int]:
        """Return a list of integers from 0 on; an empty one in the place of a missing member."""
        numbers = [_integer(value) for value in self._list(key)]
        for value, number in zip(self._list(key), numbers, strict=True):
            if number is None or number < 0:
                self._fail(key, "integers from 0 on", value)
        return [number for number in numbers if number is not None]

    def numbers(self, key: str, count: int | None = None) -> list[float] | None:
        """Return a list of finite numbers, `count` of them if it is given; None in the place of a missing member."""
        if key not in self:
            return None
        values = self._list(key)
        if count is not None and len(values) != count:
            self._fail(key, f"{count} numbers", f"{len(values)} values")
        return [self._number(key, value) for value in values]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text; the default, if there is one, in the place of a missing member."""
        value = self._members.get(key, default)
        if not isinstance(value, str):
            self._fail(key, "a text", value)
        return value

    def name(self) -> str:
        """Return the member `name`, empty where it is missing or is not a text."""
        value = self._members.get("name")
        return value if isinstance(value, str) else ""

    def texts(self, key: str) -> list[str]:
        """Return a list of texts; an empty one in the place of a missing member."""
        values = self._list(key)
        for value in values:
            if not isinstance(value, str):
                self._fail(key, "texts", value)
        return values

    def flag(self, key: str) -> bool:
        """Return a truth value; False in the place of a missing member."""
        value = self._members.get(key, False)
        if not isinstance(value, bool):
            self._fail(key, "true or false", value)
        return value

    def member(self, key: str) -> "JsonObject | None":
        """Return an object; None in the place of a missing member."""
        value = self._members.get(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            self._fail(key, "an object", value)
        return JsonObject(value, self._place(key))

    def objects(self, key: str) -> "list[JsonObject]":
        """Return a list of objects; an empty one in the place of a missing member."""
        values = self._list(key)
        for value in values:
            if not isinstance(value, dict):
                self._fail(key, "objects", value)
        return [JsonObject(value, f"{self._place(key)}[{number}]") for number, value in enumerate(values)]

    def _list(self, key: str) -> list[Any]:
        value = self._members.get(key)
        if value is None:
            return []
        if not isinstance(value, list):
            self._fail(key, "a list", value)
        return value

    def _number(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self._fail(key, "numbers", value)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self._fail(key, "finite numbers", value)
        return number

    def _place(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key

    def _fail(self, key: str, expected: str, value: object) -> NoReturn:
        raise MeshError(f"{self._place(key)}: expected {expected}, got {_shown(value)}")


def _refuse_constant(text: str) -> NoReturn:
    raise MeshError(f"its JSON holds {text}, which JSON does not allow")


def _integer(value: object) -> int | None:
    if isinstance(value, bool):
        return None
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return value if isinstance(value, int) and abs(value) <= _LARGEST_INTEGER else None


def _shown(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
