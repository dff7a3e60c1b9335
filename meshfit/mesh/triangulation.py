"""Triangulation of polygons: the same whichever corner is first, and inside the polygon where it is concave."""

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.mesh import Verts

Corners = Int64[np.ndarray, " C"]
Sizes = Int64[np.ndarray, " F"]
Rows = Int64[np.ndarray, "G N"]
Triangles = Int64[np.ndarray, "G T 3"]

# Parts of a polygon's area that count as none, and lengths that count as equal, relative to the polygon's own.
_FLAT = 1e-9
_TIE = 1e-9
# Convex polygons of more corners are cut like concave ones, as the number of diagonals grows with the square of theirs.
_LARGEST_FAN = 12
# Polygons of more corners are not cut again, as the time grows with the cube of their number.
_LARGEST_CUT = 128
# Polygons of a smaller thickness, relative to their length, are flat.
_FLAT_POLYGON = 1e-3


def triangulate(verts: Verts, corners: Corners, sizes: Sizes) -> Int64[np.ndarray, "T 3"]:
    """Split each polygon into triangles without new vertices; n corners give n - 2 consecutive triangles.

    A quadrilateral is cut along its shorter diagonal, if both lie inside. Other convex polygons become the fan of
    smallest total length, and the rest is cut by ear clipping in the plane of the polygon's area vector. A corner
    between two collinear edges gets a triangle with an area wherever there is one, so that a closed mesh stays closed.
    Where polygons share several sides, they are cut along different diagonals, as far as these lie inside.

    Args:
        verts: V positions.
        corners: vertex indices of all polygons, one polygon after another.
        sizes: number of corners of each of the F polygons, 3 or more.

    Returns:
        The triangles, in the order of the polygons and with their orientation. They do not depend on which corner of a
        polygon comes first.

    Raises:
        MeshError: a vertex index out of range.
    """
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    return np.asarray(corners[triangle_corners(verts, corners, sizes)])


def triangle_corners(verts: Verts, corners: Corners, sizes: Sizes) -> Int64[np.ndarray, "T 3"]:
    """Return the triangles of `triangulate` as places in `corners`."""
    if len(corners) and not (corners.min() >= 0 and corners.max() < len(verts)):
        raise MeshError(f"polygons have vertices {corners.min()} to {corners.max()}, of {len(verts)} vertices")
    starts, counts = np.cumsum(sizes) - sizes, sizes - 2
    first = np.cumsum(counts) - counts
    triangles = np.empty((int(counts.sum()), 3), dtype=np.int64)
    for size in np.unique(sizes):
        faces = np.flatnonzero(sizes == size)
        rows = starts[faces][:, None] + np.arange(size)
        places = first[faces][:, None] + np.arange(size - 2)
        if size > 3:
            rows = np.take_along_axis(rows, _rotations(corners[rows]), axis=1)
            triangles[places] = np.take_along_axis(rows[:, None], _split(verts[corners[rows]]), axis=2)
        else:
            triangles[places] = rows[:, None]
    _separate_diagonals(verts, corners, sizes, triangles)
    return triangles


def _rotations(rows: Rows) -> Rows:
    """Return the order of each row's entries in which it is the smallest of its rotations, in lexicographic order."""
    size = rows.shape[1]
    shift = rows.argmin(axis=1)
    for row in np.flatnonzero((rows == rows.min(axis=1, keepdims=True)).sum(axis=1) > 1):
        shift[row] = min(range(size), key=lambda start: np.roll(rows[row], -start).tolist())
    return np.asarray((np.arange(size) + shift[:, None]) % size)


def _split(points: Float64[np.ndarray, "G N 3"]) -> Triangles:
    """Return the triangles of polygons with N corners, by corner from 0 to N - 1."""
    points = points - points[:, :1]
    size = points.shape[1]
    with np.errstate(over="ignore", invalid="ignore"):
        normals = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
        if size == 4:
            return _cut_quads(points, normals)
        convex = _convex(points, normals) if size <= _LARGEST_FAN else np.zeros(len(points), dtype=bool)
    result = np.empty((len(points), size - 2, 3), dtype=np.int64)
    result[convex] = _shortest_fan(points[convex])
    for row in np.flatnonzero(~convex):
        result[row] = _clip_ears(points[row], normals[row])
    return result


def _cut_quads(points: Float64[np.ndarray, "G 4 3"], normals: Float64[np.ndarray, "G 3"]) -> Triangles:
    """Cut each quadrilateral along the better diagonal; of equal ones, along that of the first corner."""
    before, behind = np.roll(points, 1, axis=1) - points, np.roll(points, -1, axis=1) - points
    doubled = np.cross(behind, before)  # area vectors of the triangles that the diagonals cut off at each corner
    inside = np.einsum("gnk,gk->gn", doubled, normals) > _FLAT * (normals**2).sum(axis=1, keepdims=True)
    # The diagonal of corners 0 and 2 cuts off the triangles at 1 and 3.
    even, odd = inside[:, 1] & inside[:, 3], inside[:, 0] & inside[:, 2]
    areas = np.linalg.norm(doubled, axis=2)
    cost = np.stack([points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]], axis=1)
    lengths, waste = np.linalg.norm(cost, axis=2), np.stack([areas[:, [1, 3]].sum(1), areas[:, [0, 2]].sum(1)], axis=1)
    undecided = np.where(even, _second_is_less(lengths), _second_is_less(waste))
    chosen = np.where(even == odd, undecided, odd)
    return np.where(chosen[:, None, None], [[1, 2, 3], [3, 0, 1]], [[0, 1, 2], [2, 3, 0]])


def _second_is_less(pairs: Float64[np.ndarray, "G 2"]) -> Bool[np.ndarray, " G"]:
    return np.asarray(pairs[:, 1] < pairs[:, 0] * (1 - _TIE))


def _convex(points: Float64[np.ndarray, "G N 3"], normals: Float64[np.ndarray, "G 3"]) -> Bool[np.ndarray, " G"]:
    """Return which polygons turn the same way at every corner, seen along their normals, and once in all."""
    ahead = np.roll(points, -1, axis=1) - points
    behind = np.roll(ahead, 1, axis=1)
    sine = np.einsum("gnk,gk->gn", np.cross(behind, ahead), normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = ((behind * ahead).sum(axis=2) - _along(behind, normals) * _along(ahead, normals)) * length
    turns = np.arctan2(sine, cosine).sum(axis=1) / (2 * np.pi)
    return np.asarray((sine > _FLAT * length**2).all(axis=1) & (turns < 1.5))


def _along(vectors: Float64[np.ndarray, "G N 3"], normals: Float64[np.ndarray, "G 3"]) -> Float64[np.ndarray, "G N"]:
    """Return the components of vectors along normals of any length."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.einsum("gnk,gk->gn", vectors, np.divide(normals, length, where=length > 0, out=0 * normals)))


def _shortest_fan(points: Float64[np.ndarray, "G N 3"]) -> Triangles:
    """Return the fan from the corner whose diagonals are shortest in total; of equal ones, from the first."""
    size = points.shape[1]
    lengths = np.zeros(points.shape[:2])
    for step in range(2, size - 1):
        lengths += np.linalg.norm(points - np.roll(points, -step, axis=1), axis=2)
    apex = (lengths <= lengths.min(axis=1, keepdims=True) * (1 + _TIE)).argmax(axis=1)
    return np.asarray((_fan(size) + apex[:, None, None]) % size)


def _fan(size: int) -> Int64[np.ndarray, "T 3"]:
    """Return the triangles at the first of so many corners."""
    second = np.arange(1, size - 1)
    return np.stack([np.zeros_like(second), second, second + 1], axis=1)


def _clip_ears(points: Float64[np.ndarray, "N 3"], normal: Float64[np.ndarray, "3"]) -> Int64[np.ndarray, "T 3"]:
    """Triangulate one polygon, projected along its normal."""
    import manifold3d  # most meshes have no concave polygons

    fan = _fan(len(points))
    scale = np.abs(points).max()
    if not (np.isfinite(scale) and scale > 0 and np.isfinite(normal).all()):
        return fan
    axis = normal / np.abs(normal).max() if normal.any() else np.array([0.0, 0.0, 1.0])
    u = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    v = np.cross(axis, u) / np.linalg.norm(axis)
    flat = np.stack([points @ u, points @ v], axis=1) / (np.linalg.norm(u) * scale)
    triangles = np.asarray(manifold3d.triangulate([flat]), dtype=np.int64)
    return triangles if triangles.shape == fan.shape else fan


def _separate_diagonals(verts: Verts, corners: Corners, sizes: Sizes, triangles: Int64[np.ndarray, "T 3"]) -> None:
    """Cut polygons again, in place, one of whose diagonals joins the same vertices as another diagonal or as a side.

    Such a diagonal would have four triangles, as it may where two polygons share several sides.
    """
    ends, face = _diagonals(sizes, triangles)
    keys = _edge_keys(corners[ends[:, 0]], corners[ends[:, 1]], len(verts))
    starts, first = np.cumsum(sizes) - sizes, np.cumsum(sizes - 2) - (sizes - 2)
    following = np.arange(1, len(corners) + 1)
    following[starts + sizes - 1] = starts
    sides = np.sort(_edge_keys(corners, corners[following], len(verts)))
    order = np.argsort(keys)
    ordered = keys[order]
    shared = _contains(sides, ordered)
    same = ordered[1:] == ordered[:-1]
    shared[1:] |= same
    shared[:-1] |= same
    if not shared.any():
        return
    # Only few polygons are left here, as a rule.
    polygons = np.unique(face[order[shared]])
    of_others = ordered[~np.isin(face[order], polygons)]
    own_starts = np.searchsorted(face, polygons)
    taken = set[int]()
    for polygon, own_start in zip(polygons.tolist(), own_starts.tolist(), strict=True):
        size = int(sizes[polygon])
        rows = starts[polygon] + np.arange(size)
        rows = rows[_rotations(corners[rows][None])[0]]
        row = corners[rows]
        own = keys[own_start : own_start + size - 3]
        in_use = _contains(sides, own).any() or _contains(of_others, own).any() or not taken.isdisjoint(own.tolist())
        if in_use and len(np.unique(row)) == size <= _LARGEST_CUT:
            near = _edge_keys(row[:, None], row, len(verts))
            blocked = _contains(sides, near) | _contains(of_others, near)
            blocked |= np.isin(near, [key for key in np.unique(near).tolist() if key in taken])
            cut = rows[_best_cut(verts[row], blocked)]
            triangles[first[polygon] + np.arange(size - 2)] = cut
            ends, _ = _diagonals(sizes[[polygon]], cut - starts[polygon])
            tail, head = corners[starts[polygon] + ends.T]
            own = _edge_keys(tail, head, len(verts))
        taken.update(own.tolist())


def _edge_keys(tail: NDArray[np.int64], head: NDArray[np.int64], num_verts: int) -> NDArray[np.int64]:
    return np.asarray(np.minimum(tail, head) * num_verts + np.maximum(tail, head))


def _contains(ordered: NDArray[np.int64], keys: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which keys are among some in ascending order, one at least."""
    return np.asarray(np.append(ordered, -1)[np.searchsorted(ordered, keys)] == keys)


def _diagonals(
    sizes: Sizes, triangles: Int64[np.ndarray, "T 3"]
) -> tuple[Int64[np.ndarray, "D 2"], Int64[np.ndarray, " D"]]:
    """Return the places that each diagonal joins, the smaller first, and its polygon."""
    face = np.repeat(np.arange(len(sizes)), sizes - 2)
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    face = np.repeat(face, 3)
    step = ends[:, 1] - ends[:, 0]
    inner = (step > 1) & (step < sizes[face] - 1)
    return ends[inner], face[inner]


def _best_cut(points: Float64[np.ndarray, "N 3"], blocked: Bool[np.ndarray, "N N"]) -> Int64[np.ndarray, "T 3"]:
    """Return the triangulation with the fewest triangles outside, then blocked diagonals, then the least length.

    In a polygon that is not flat, blocked diagonals come first, as triangles are outside in one view only.
    """
    size, points = len(points), points - points[0]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    lengths = np.linalg.norm(points[:, None] - points, axis=2)
    is_flat = np.ptp(points @ normal) <= _FLAT_POLYGON * np.linalg.norm(normal) * lengths.max()
    of_outside, of_blocked = (size, 1) if is_flat else (1, size)
    weight = lengths / max(lengths.sum(), np.finfo(np.float64).tiny) + of_blocked * blocked
    cost, apex = np.zeros((size, size)), np.zeros((size, size), dtype=np.int64)
    for span in range(2, size):
        for i in range(size - span):
            j, between = i + span, np.arange(i + 1, i + span)
            outside = np.cross(points[between] - points[i], points[j] - points[i]) @ normal <= _FLAT * (normal @ normal)
            total = cost[i, between] + cost[between, j] + of_outside * outside
            apex[i, j] = between[total.argmin()]
            cost[i, j] = total.min() + weight[i, j]
    triangles, pending = list[tuple[int, int, int]](), [(0, size - 1)]
    while pending:
        i, j = pending.pop()
        if j - i > 1:
            k = int(apex[i, j])
            triangles.append((i, k, j))
            pending += [(i, k), (k, j)]
    return np.array(triangles)
