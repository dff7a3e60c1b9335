"""Attributes of pieces that become one mesh: the union, with neutral values where a piece lacks some."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from meshfit.mesh.attributes import COLOR, GROUP, JOINTS, MATERIAL, WEIGHTS, Attributes, Values, is_uv
from meshfit.mesh.polygons import PolygonSoup

_COLOR = re.compile(rf"{COLOR}\d*")


def united(pieces: Sequence[PolygonSoup]) -> Attributes:
    """Return the attributes of a mesh that consists of pieces, in their order, without materials, groups and skin.

    Where a piece lacks data that another has, colours are white, materials and groups none, all else 0. Data that is of
    vertices in one piece and of corners in another becomes data of corners.
    """
    parts = [piece.attributes for piece in pieces]
    of_corners = _names([part.corner for part in parts])
    of_verts = [name for name in _names([part.vertex for part in parts]) if name not in of_corners]
    num_verts, num_faces, num_corners = (
        [len(getattr(piece, name)) for piece in pieces] for name in ("verts", "sizes", "corners")
    )
    return Attributes(
        vertex={name: stacked(name, [part.vertex.get(name) for part in parts], num_verts) for name in of_verts},
        face={
            name: stacked(name, [part.face.get(name) for part in parts], num_faces)
            for name in _names([part.face for part in parts])
        },
        corner={
            name: stacked(name, [corner_data(piece, name) for piece in pieces], num_corners) for name in of_corners
        },
    )


def lacking(pieces: Sequence[PolygonSoup]) -> list[str]:
    """Return names of the data that only some of the pieces have, materials and groups apart."""
    held: list[set[str]] = [
        {*piece.attributes.vertex, *piece.attributes.face, *piece.attributes.corner} for piece in pieces
    ]
    if not held:
        return []
    return sorted(set().union(*held) - held[0].intersection(*held) - {MATERIAL, GROUP})


def over_shared_verts(first: PolygonSoup, second: PolygonSoup) -> Attributes:
    """Return the attributes of the faces of two pieces, which have the same vertices.

    Data of vertices that is not equal in both becomes data of corners.
    """
    one, other = first.attributes.vertex, second.attributes.vertex
    same = [name for name in one if name in other and np.array_equal(one[name], other[name])]
    pieces = [_over_corners(piece, without=same) for piece in (first, second)]
    return replace(united(pieces), vertex={name: one[name] for name in same})


def _over_corners(piece: PolygonSoup, *, without: Sequence[str]) -> PolygonSoup:
    """Return a piece with the data of its vertices moved to corners, and without vertices."""
    given = piece.attributes
    moved = {name: values[piece.corners] for name, values in given.vertex.items() if name not in without}
    attributes = Attributes(face=given.face, corner={**moved, **given.corner})
    return piece._replace(verts=piece.verts[:0], attributes=attributes)


def corner_data(piece: PolygonSoup, name: str) -> Values | None:
    """Return data of corners, perhaps from that of their vertices; None if there is none."""
    if name in piece.attributes.corner:
        return piece.attributes.corner[name]
    return piece.attributes.vertex[name][piece.corners] if name in piece.attributes.vertex else None


def stacked(name: str, parts: Sequence[Values | None], counts: Sequence[int]) -> Values:
    """Return the rows of all parts in one type and width; neutral ones for a part that has none."""
    held = [part for part in parts if part is not None]
    if is_color(name) and len({part.dtype for part in held}) > 1:
        parts = [None if part is None else _unit_floats(part) for part in parts]
        held = [part for part in parts if part is not None]
    dtype = np.result_type(*(part.dtype for part in held))
    width = max(part.shape[1] if part.ndim > 1 else 1 for part in held)
    rows = np.full((sum(counts), width), _neutral(name, dtype), dtype)
    start = 0
    for part, count in zip(parts, counts, strict=True):
        if part is not None:
            values = part[:, None] if part.ndim == 1 else part
            rows[start : start + count, : values.shape[1]] = values
        start += count
    return rows[:, 0] if all(part.ndim == 1 for part in held) else rows


def is_color(name: str) -> bool:
    """Return whether data of this name is a set of colours."""
    return _COLOR.fullmatch(name) is not None


def is_reserved(name: str) -> bool:
    """Return whether data of this name has a meaning of its own."""
    return is_uv(name) or is_color(name) or name in {JOINTS, WEIGHTS, MATERIAL, GROUP}


def _names(parts: Sequence[Any]) -> list[str]:
    return list(dict.fromkeys(name for part in parts for name in part))


def _neutral(name: str, dtype: np.dtype[Any]) -> int | float:
    if name in (MATERIAL, GROUP):
        return -1
    if is_color(name):
        return int(np.iinfo(dtype).max) if dtype.kind in "iu" else 1.0
    return 0


def _unit_floats(values: Values) -> Values:
    """Return colours as floats from 0 to 1."""
    if values.dtype.kind in "iu":
        return (values / np.iinfo(values.dtype).max).astype(np.float32)
    return values.astype(np.float32)
