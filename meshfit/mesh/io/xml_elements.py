"""XML elements of a mesh file: parsing, names without namespaces, and numbers in attributes and text."""

import re
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError

Element = ElementTree.Element
_LONGEST = 40


def parse_xml(content: bytes, root: str, place: str = "") -> Element:
    """Return the root element, whose name without namespace has to be `root`.

    Raises:
        MeshError: not XML, or another root.
    """
    try:
        element = ElementTree.fromstring(content)  # noqa: S314  expat bounds entities, and external ones are not read
    except ElementTree.ParseError as error:
        line, column = error.position
        raise MeshError(f"{place}line {line}, column {column + 1}: its XML is damaged or cut short") from None
    except (LookupError, ValueError):  # an encoding that is not known
        raise MeshError(f"{place}its XML is in an encoding that is not known") from None
    if local_name(element) != root:
        raise MeshError(f"{place}expected XML with the root '{root}', got '{local_name(element)[:_LONGEST]}'")
    return element


def local_name(element: Element) -> str:
    """Return the name of an element without its namespace."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def children(element: Element, *names: str) -> Iterator[Element]:
    """Yield the direct children with one of these names, in any namespace."""
    return (child for child in element if local_name(child) in names)


def child(element: Element, name: str) -> Element | None:
    """Return the first direct child with this name; None if there is none."""
    return next(children(element, name), None)


def attribute(element: Element, name: str) -> str | None:
    """Return an attribute, in any namespace; None if there is none."""
    value = element.get(name)
    if value is not None:
        return value
    return next((value for key, value in element.attrib.items() if key.rpartition("}")[2] == name), None)


def integer_attribute(element: Element, name: str, place: str, default: int | None = None) -> int:
    """Return an attribute as an integer from 0 on.

    Raises:
        MeshError: naming the place.
    """
    text = element.get(name)
    if text is None and default is not None:
        return default
    if text is None or not re.fullmatch(r"\s*\+?\d{1,15}\s*", text):
        raise MeshError(f"{place}: expected an integer from 0 on as '{name}', got {shown(text)}")
    return int(text)


def numbers(text: str | None, dtype: type[Any], place: str) -> NDArray[Any]:
    """Return the numbers of a text, separated by blanks.

    Raises:
        MeshError: naming the place.
    """
    words = (text or "").split()
    try:
        return np.array(words, dtype=dtype) if words else np.empty(0, dtype)
    except (ValueError, OverflowError):
        kind = "integers" if np.issubdtype(dtype, np.integer) else "numbers"
        bad = next((word for word in words if not _is_number(word, kind)), words[0])
        raise MeshError(f"{place}: expected {kind}, got {shown(bad)}") from None


def require_finite_rows(points: NDArray[np.float64], place: str) -> None:
    """Refuse points of which a coordinate is not finite.

    Raises:
        MeshError: with the number of the point after the place.
    """
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise MeshError(f"{place} {bad[0]} has a coordinate that is not finite: {points[bad[0]].tolist()}")


def shown(text: str | None) -> str:
    """Return a text of a file for a message."""
    if text is None:
        return "nothing"
    return repr(text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…")


def _is_number(word: str, kind: str) -> bool:
    try:
        float(word) if kind == "numbers" else int(word)
    except ValueError:
        return False
    return True
