"""Creases from a text file, in the vertex numbers of the mesh file that it goes with."""

from math import inf
from pathlib import Path

import numpy as np

from meshfit.errors import MeshError
from meshfit.mesh.io.text import read_word_lines
from meshfit.mesh.topology import NONE, Indices, Topology
from meshfit.subdivision.creases import Creases, edges_between


def read_creases(path: str | Path, topology: Topology, numbering: Indices, sharpness: int | float = inf) -> Creases:
    """The creases and corners that a text file lists.

    A line each: `a b` for the edge between verts a and b, `a b sharpness` for one that is sharp for so many levels, `a`
    alone for a corner; verts are counted from 0 in the mesh file's order, and `#` begins a comment.

    Args:
        path: of the text file.
        topology: of the mesh.
        numbering: (N,) the vertex that each of the mesh file's verts is in it, as `load_numbered` tells it.
        sharpness: of edges that are listed without.

    Raises:
        MeshError: it cannot be read, lists nothing, or a line names no vertex or edge of the mesh, or no sharpness.
        SchemeError: `sharpness` is below 0.
    """
    corners, listed = list[int](), dict[int, float]()
    for line, words in read_word_lines(path):
        where = f"{path}, line {line}"
        ends, levels = _numbers(words)
        if not ends or len(levels) > 1:
            raise MeshError(
                f"{where}: found '{' '.join(words)}'; a crease 'a b' or 'a b sharpness', or a corner 'a', is needed"
            )
        (given,) = levels or [sharpness]
        if not given >= 0:
            raise MeshError(f"{where}: sharpness {given:g} is not allowed: 0 or more is, and inf for ever")
        verts = [_vertex(end, numbering, where) for end in ends]
        if len(verts) == 1:
            corners.append(verts[0])
            continue
        edge = _edge(verts, ends, topology, where)
        if listed.setdefault(edge, given) != given:
            raise MeshError(
                f"{where}: edge ({ends[0]}, {ends[1]}) is listed twice, of sharpness {listed[edge]:g} before"
            )
    if not corners and not listed:
        raise MeshError(f"{path}: no creases and no corners in it")
    return Creases.of(topology, topology.edges[list(listed)], list(listed.values()), corners)


def _numbers(words: list[str]) -> tuple[list[int], list[float]]:
    """The verts and the sharpness of a line; none where its words are no numbers."""
    try:
        return [int(word) for word in words[:2]], [float(word) for word in words[2:]]
    except ValueError:
        return [], []


def _vertex(number: int, numbering: Indices, where: str) -> int:
    if not 0 <= number < len(numbering):
        raise MeshError(f"{where}: vertex {number}: those of the mesh file are numbered 0 to {len(numbering) - 1}")
    if numbering[number] == NONE:
        raise MeshError(f"{where}: vertex {number} was dropped when the mesh was read, since no proper face uses it")
    return int(numbering[number])


def _edge(verts: list[int], ends: list[int], topology: Topology, where: str) -> int:
    try:
        return int(edges_between(topology, np.array([verts]))[0])
    except MeshError:
        raise MeshError(f"{where}: the mesh has no edge between verts {ends[0]} and {ends[1]}") from None
