"""Thinning of meshes of many faces: fast removal of vertices where the surface is flat, before a careful decimation."""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from meshfit.mesh.geometry import area_vectors
from meshfit.mesh.mesh import Mesh

_Verts = Float64[np.ndarray, "V 3"]
_Faces = Int64[np.ndarray, "F 3"]
_Mask = Bool[np.ndarray, " V"]
_Sides = list[tuple[Int64[np.ndarray, " F"], Int64[np.ndarray, " F"], Int64[np.ndarray, " F"]]]

# Share of its area that counts as error of a vertex, so that flat parts lose their smallest faces first; and the share
# of all vertices, those of least error, that a round chooses from.
_AREA, _CHEAPEST = 1e-3, 0.75
# Powers of two by which errors differ that count the same.
_SAME = 2
# Largest valence of a vertex that is removed, and that a neighbour may get; and the least numbers of faces that are
# left at a neighbour, inside and at the boundary.
_MOST_REMOVED, _MOST_LEFT, _LEAST_INNER, _LEAST_OUTER = 9, 12, 4, 2
# Least cosine between the normals of a face before and after, and least double area over the sum of squared sides.
_TURN, _SLIM = 0.8, 0.05
# A round that removes a smaller share of the faces is the last.
_WORTHWHILE = 0.005


def thinned(mesh: Mesh, num_faces: int) -> Mesh:
    """Return a mesh with fewer faces, about `num_faces` or more, and the same pieces, handles and boundaries.

    Each round removes inner vertices that are no neighbours: each becomes its nearest neighbour, where the link
    condition holds (Dey, Edelsbrunner, Guha and Nekhayev, Topology preserving edge contraction, 1999) and no face turns
    far. Among neighbours, the one of least error goes first: the area around it less the length of its area vector,
    which grows with the square of its height. Vertices that stay keep their places.

    Args:
        mesh: oriented manifold pieces.
        num_faces: number of faces to reach.
    """
    faces, refused = mesh.faces, np.zeros(mesh.num_verts, dtype=bool)
    while (left := len(faces) - num_faces) > 0:
        before = len(faces)
        faces = _with_fewer(mesh.verts, faces, refused, (left + 1) // 2)
        if before - len(faces) < _WORTHWHILE * before:
            break
    if len(faces) == mesh.num_faces:
        return mesh
    used = np.zeros(mesh.num_verts, dtype=bool)
    used[faces.reshape(-1)] = True
    return Mesh(mesh.verts[used], (used.cumsum() - 1)[faces])


def _with_fewer(verts: _Verts, faces: _Faces, refused: _Mask, most: int) -> Int64[np.ndarray, "G 3"]:
    """Remove at most some vertices in one round, and mark those that cannot be removed.

    Args:
        verts: (V, 3) positions.
        faces: (F, 3).
        refused: (V,) vertices that cannot be removed; changed in place.
        most: number of vertices.
    """
    columns = np.ascontiguousarray(faces.T)
    # Each corner of each face, the next, and the last.
    sides: _Sides = [(columns[k], columns[k - 2], columns[k - 1]) for k in range(3)]
    count = len(verts)
    valence = np.bincount(columns.reshape(-1), minlength=count)
    # The numbers of the vertices around an inner one cancel.
    closed = np.sum([np.bincount(tail, head - apex, count) for tail, head, apex in sides], axis=0) == 0
    removed = _cheapest(verts, faces, sides, closed & ~refused & (valence > 0) & (valence <= _MOST_REMOVED))[:most]
    # Rows of the faces around them: the vertex by its place among those removed, and the others in order.
    place = np.full(count, -1)
    place[removed] = np.arange(len(removed))
    around = [np.flatnonzero(place[tail] >= 0) for tail, _, _ in sides]
    vert, first, second = (
        np.concatenate([side[k][rows] for side, rows in zip(sides, around, strict=True)]) for k in range(3)
    )
    owner = place[vert]
    length = np.square(verts[first] - verts[vert]).sum(axis=1)
    least = np.full(len(removed), np.inf)
    np.minimum.at(least, owner, length)
    into = np.empty(len(removed), dtype=np.int64)
    nearest = length == least[owner]
    into[owner[nearest]] = first[nearest]
    target = into[owner]
    adjacent = (first != target) & _have(_keys(sides, closed, count), _key(target, first, count))
    fine = np.bincount(owner, adjacent, len(removed)) == 2  # the link condition
    stays = (first != target) & (second != target)
    fine[owner[stays][_turns(*(verts[rows[stays]] for rows in (vert, target, first, second)))]] = False
    fine &= valence[removed] + valence[into] - 4 <= _MOST_LEFT
    refused[removed[~fine]] = True
    # Together, they must not make an edge twice, lead to one vertex, or take too many faces from one.
    fine &= _is_first(into, fine)
    new = fine[owner] & (first != target) & ~adjacent
    fine[owner[_repeats(_key(target, first, count), new)]] = False
    apexes = fine[owner] & adjacent
    lost = np.bincount(first[apexes], minlength=count)
    poor = valence - lost < np.where(closed, _LEAST_INNER, _LEAST_OUTER)
    fine[owner[apexes & poor[first]]] = False
    number = np.arange(count)
    number[removed[fine]] = into[fine]
    a, b, c = (number[column] for column in columns)
    fewer = np.stack([a, b, c], axis=1)
    return np.asarray(fewer[(a != b) & (b != c) & (c != a)])


def _cheapest(verts: _Verts, faces: _Faces, sides: _Sides, eligible: _Mask) -> np.ndarray:
    """Return the eligible vertices whose removal has the least error among their neighbours, by error."""
    vectors = area_vectors(Mesh(verts, faces))
    area = np.sqrt(np.square(vectors).sum(axis=1))
    total, x, y, z = (
        np.sum([np.bincount(tail, values, len(verts)) for tail, _, _ in sides], axis=0)
        for values in (area, *vectors.T.copy())
    )
    error = (1 + _AREA) * total - np.sqrt(x * x + y * y + z * z)
    order = np.flatnonzero(eligible)
    # Within a factor, errors count the same, and the order is scrambled: else few have the least among neighbours.
    scale = np.frexp(error[order])[1].astype(np.int64) // _SAME
    order = order[np.argsort((scale << 32) | ((order * 0x9E3779B1) & 0xFFFFFFFF), kind="stable")]
    order = order[: max(1, int(_CHEAPEST * len(order)))]
    rank = np.full(len(verts), len(verts))
    rank[order] = np.arange(len(order))
    least = np.full(len(verts), len(verts))
    for tail, head, _ in sides:
        np.minimum.at(least, tail, rank[head])
    return order[rank[order] < least[order]]


def _turns(before: np.ndarray, after: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return which faces turn too far, or become too slim, as a corner moves."""
    old, new = (np.cross(first - corner, second - corner) for corner in (before, after))
    sides = np.sum(
        [np.square(p - q).sum(axis=1) for p, q in ((first, after), (second, after), (first, second))], axis=0
    )
    size = np.sqrt(np.square(new).sum(axis=1))
    cosine = np.einsum("nk,nk->n", old, new)
    return np.asarray((cosine < _TURN * size * np.sqrt(np.square(old).sum(axis=1))) | (size < _SLIM * sides))


def _keys(sides: _Sides, closed: _Mask, count: int) -> np.ndarray:
    """Return the keys of all edges, ascending; those at the boundary may be repeated."""
    keys = []
    for tail, head, _ in sides:
        once = (tail < head) | ~(closed[tail] | closed[head])
        keys.append(_key(tail[once], head[once], count))
    return np.sort(np.concatenate(keys))


def _key(a: np.ndarray, b: np.ndarray, count: int) -> np.ndarray:
    return np.asarray(np.minimum(a, b) * count + np.maximum(a, b))


def _have(keys: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    return np.asarray(keys[np.searchsorted(keys, wanted).clip(max=len(keys) - 1)] == wanted)


def _repeats(keys: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Return the rows among some whose key an earlier one has."""
    rows = np.flatnonzero(among)
    repeats = np.ones(len(rows), dtype=bool)
    repeats[np.unique(keys[rows], return_index=True)[1]] = False
    return rows[repeats]


def _is_first(values: np.ndarray, among: np.ndarray) -> np.ndarray:
    first = np.ones(len(values), dtype=bool)
    first[_repeats(values, among)] = False
    return first
