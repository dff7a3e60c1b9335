"""Point clouds: positions, perhaps with normals, and what can be estimated from neighbouring points."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from meshfit.doors import no_type_check
from meshfit.errors import MeshError
from meshfit.mesh.geometry import unit_vectors
from meshfit.mesh.mesh import Verts
from meshfit.mesh.noise import NEIGHBOURHOOD, noise_of_points
from meshfit.units import count_text

Points = Float64[np.ndarray, "N 3"]
Indices = Int64[np.ndarray, " M"]
Normals = Float64[np.ndarray, "N 3"]
_OfSome = Float64[np.ndarray, "_ 3"]
Position = tuple[float, float, float]

MOST_POINTS = 400_000
"""Points of a scan that are worked with; of a larger one, as many are drawn at random."""

MOST_HIDDEN = 0.2
"""A place from which a larger share of the points is hidden is not where they were seen from."""

_LEAST = 4
# Points that vary less across a plane, as a share of their length, are flat up to rounding.
_FLAT = 1e-6
# Neighbours of a point whose plane gives its normal, and the most, where noise is larger than they are apart.
_NEIGHBOURS, _MOST_NEIGHBOURS = 16, 96
# With fewer points than three such neighbourhoods, planes span the whole of a shape, and their normals mean nothing.
_FEWEST = 3 * _NEIGHBOURS
# Neighbours of a point along which orientation is passed on, and from whose distance density is estimated.
_LINKS, _DENSITY = 10, 8
_LARGEST_AREA = 2.0
# Neighbours of a point at a rim, and the angle without any of them, seen along the normal.
_RIM_NEIGHBOURS, _RIM_ANGLE = 24, 0.85 * np.pi
# Points at the rim or next to it, and points over which areas are averaged.
_BESIDE_RIM, _AVERAGED = 8, 24
# Sine of the least angle with the surface at which a place is off it, and not beyond its rim.
_LEAST_SINE = 0.5
_ROUNDING = 1e-12
# Grids of points that are spread evenly, per doubling of the number of cells.
_FINENESSES = 4
# Width of a direction in mean distances of points, and how much nearer a point is that hides another.
_CELL, _DEPTH = 2.0, 10.0
# At most this many points decide how large a neighbourhood is.
_SOME = 2000


@dataclass(frozen=True, eq=False, init=False)
class PointCloud:
    """Points on a surface, such as a scan. All arrays are read-only copies.

    Attributes:
        verts: (V, 3) float64, positions.
        normals: (V, 3) float64, unit normals that point outwards, 0 where one is not known; None if none is.
        sensor: position that all points were seen from, towards which normals that are not known point; None if
            it is not known.

    Example:
        >>> import meshfit
        >>> meshfit.PointCloud([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        PointCloud(4 points, box 1 × 1 × 1)

    Raises:
        MeshError: arrays of other shapes, or fewer than four points.
    """

    verts: Verts
    normals: Normals | None
    sensor: Position | None

    def __init__(
        self, verts: ArrayLike, normals: ArrayLike | None = None, sensor: Sequence[float] | None = None
    ) -> None:
        array = np.array(verts, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != 3:
            raise MeshError(f"points: expected rows of three numbers, got an array of shape {array.shape}")
        if len(array) < _LEAST:
            raise MeshError(f"points: expected {_LEAST} or more, got {len(array)}")
        directions = None if normals is None else np.array(normals, dtype=np.float64)
        if directions is not None and directions.shape != array.shape:
            raise MeshError(f"normals: expected shape {array.shape}, got {directions.shape}")
        if directions is not None:
            directions = _unit_or_zero(directions)
            directions.setflags(write=False)
            directions = directions if directions.any() else None
        array.setflags(write=False)
        object.__setattr__(self, "verts", array)
        object.__setattr__(self, "normals", directions)
        object.__setattr__(self, "sensor", None if sensor is None else _position(sensor))

    @property
    def num_verts(self) -> int:
        """V, the number of points."""
        return len(self.verts)

    @property
    def num_faces(self) -> int:
        """0."""
        return 0

    def with_verts(self, verts: ArrayLike) -> "PointCloud":
        """Return the same normals at other positions, without a sensor."""
        return PointCloud(verts, self.normals)

    def moved(self, move: Callable[[Points], Points]) -> "PointCloud":
        """Return points and sensor moved by a function of positions that scales and shifts them."""
        sensor = None if self.sensor is None else move(np.array([self.sensor]))[0].tolist()
        return PointCloud(move(self.verts), self.normals, sensor)

    def subset(self, rows: Indices) -> "PointCloud":
        """Return some of the points."""
        return PointCloud(self.verts[rows], None if self.normals is None else self.normals[rows], self.sensor)

    def thinned(self, most: int = MOST_POINTS) -> "PointCloud":
        """Return the cloud, or if it is larger, as many of its points, drawn at random, always the same.

        They are in an order that keeps neighbours close in memory, in which the search for neighbours takes half the
        time.
        """
        if self.num_verts <= most:
            return self
        rows = np.sort(np.random.default_rng(0).permutation(self.num_verts)[:most])
        return self.subset(rows[cKDTree(self.verts[rows]).indices])

    def __repr__(self) -> str:
        """Return the number of points, whether there are normals, and the size of the bounding box."""
        size = " × ".join(f"{length:.4g}" for length in np.ptp(self.verts, axis=0))
        with_normals = "" if self.normals is None else " with normals"
        return f"PointCloud({count_text(self.num_verts, 'point')}{with_normals}, box {size})"


def seen_cloud(cloud: PointCloud, sensor: Sequence[float] | None = None) -> PointCloud:
    """Return the cloud with normals towards the sensor, or towards its own; as it is where neither is known."""
    return cloud if sensor is None and cloud.sensor is None else oriented_cloud(cloud, sensor)


@no_type_check
def oriented_cloud(cloud: PointCloud, sensor: Sequence[float] | None = None) -> PointCloud:
    """Return the cloud with normals: its own, or estimated ones.

    Each estimated normal is that of the plane of nearest neighbours, the direction of least variance. Normals are
    oriented towards the sensor if it is given, or else towards that of the cloud. Where only some points of a cloud
    have normals, the others follow the nearest of these. Otherwise orientation is passed on along a minimum spanning
    tree over neighbours, whose links cost 1 - |n · n'| (Hoppe et al. 1992, sec. 3.3), from the highest point of each
    connected part, where the normal points up.

    Args:
        cloud: N points.
        sensor: position that all points were seen from.
    """
    own, sensor = cloud.normals, cloud.sensor if sensor is None else sensor
    known = np.zeros(cloud.num_verts, dtype=bool) if own is None else np.asarray(own.any(axis=1))
    if known.all():
        return cloud
    tree = cKDTree(cloud.verts)
    normals = _plane_normals(cloud.verts, tree)
    if own is not None:
        towards = own[known][cKDTree(cloud.verts[known]).query(cloud.verts)[1]]
        turned = np.where(np.einsum("nk,nk->n", normals, towards)[:, None] < 0, -normals, normals)
        return PointCloud(cloud.verts, np.where(known[:, None], own, turned))
    if sensor is not None:
        towards = np.asarray(sensor, dtype=np.float64) - cloud.verts
        away = np.einsum("nk,nk->n", normals, towards) < 0
        return PointCloud(cloud.verts, np.where(away[:, None], -normals, normals))
    return PointCloud(cloud.verts, _consistently_oriented(cloud.verts, normals, tree))


def no_closed_surface(cloud: PointCloud) -> str:
    """Return why no closed surface can be fitted to points, in words; empty if one can."""
    count = cloud.num_verts
    if count < _FEWEST:
        return f"{count_text(count, 'point')} are too few to tell a surface; give {_FEWEST} or more"
    lengths = np.linalg.svd(cloud.verts - cloud.verts.mean(axis=0), compute_uv=False)
    if lengths[2] > _FLAT * lengths[0]:
        return ""
    flat = f"its {count_text(count, 'point')} lie in a plane, and no closed surface does"
    return f"{flat}; start from a sheet: the path of its mesh as source.mesh"


def hidden_from_sensor(cloud: PointCloud) -> float:
    """Return the share of points that others hide from the sensor, nearer to it in about the same direction."""
    away = cloud.verts - np.array(cloud.sensor)
    depths = np.linalg.norm(away, axis=1)
    rows = np.flatnonzero(depths > 0)
    some = rows[:: max(1, len(rows) // _SOME)]
    directions = away[rows] / depths[rows, None]
    # Of few points, the nearest ones around a direction may all be hidden: cells are some points wide.
    apart = float(np.median(sampled_areas(cloud.verts)) ** 0.5)
    angle = _CELL * apart / float(np.median(depths))
    near = cKDTree(directions).query_ball_point(away[some] / depths[some, None], angle)
    nearest = np.array([depths[rows[found]].min() for found in near])
    return float((depths[some] - nearest > _DEPTH * apart).mean()) if len(some) else 0.0


def plane_normals(points: Points) -> Normals:
    """Return (N, 3) unit normals of the planes of nearest neighbours, on either side."""
    return _plane_normals(points, cKDTree(points))


def evenly_spread(points: Points, most: int) -> Indices:
    """Return the rows of at most some points: the first in each cell of the finest grid that has no more of them.

    Dense parts become sparser, and sparse ones keep their points.

    Args:
        points: (N, 3).
        most: number of points.
    """
    if len(points) <= most:
        return np.arange(len(points))
    places = (points - points.min(axis=0)) / max(float(np.ptp(points, axis=0).max()), np.finfo(float).tiny)

    def first_in_cells(fineness: int) -> Indices:
        cell = (places * 2 ** (fineness / _FINENESSES)).astype(np.int64)
        return np.unique((cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2], return_index=True)[1]

    # The number of cells along the box is 2 to the power of the fineness over the number of finenesses per doubling.
    fineness = bisect_right(range(20 * _FINENESSES), most, key=lambda fineness: len(first_in_cells(fineness))) - 1
    return np.sort(first_in_cells(max(fineness, 0)))


def sampled_areas(points: Points) -> Float64[np.ndarray, " N"]:
    """Return the area of the surface that each point stands for, from the distance of its neighbours.

    Where points are dense, each stands for little, so that a surface that was scanned twice counts once. A point has
    at most twice the median of its neighbours, so that one off the surface stands for hardly more than others.
    """
    count = min(_DENSITY, len(points) - 1)
    distances, neighbours = cKDTree(points).query(points, count + 1)
    areas = np.pi * np.asarray(distances)[:, -1] ** 2 / count
    return np.asarray(np.minimum(areas, _LARGEST_AREA * np.median(areas[neighbours], axis=1)))


def rim_of(cloud: PointCloud) -> Bool[np.ndarray, " N"]:
    """Return (N,) which points are at a boundary: all neighbours lie on one side, within some angle.

    Args:
        cloud: N points with normals.
    """
    assert cloud.normals is not None  # noqa: S101  the caller has oriented them
    return _at_rim(cloud.verts, cKDTree(cloud.verts), np.arange(cloud.num_verts), cloud.normals)


def is_at_rim(points: Points, rows: Indices) -> Bool[np.ndarray, " M"]:
    """Return which of some points of a cloud are at a boundary, or have a neighbour that is, by estimated normals.

    Args:
        points: (N, 3) all points.
        rows: (M,) indices of the points to look at.
    """
    tree = cKDTree(points)
    around = np.asarray(tree.query(points[rows], min(_BESIDE_RIM, len(points)))[1])
    looked_at, inverse = np.unique(around, return_inverse=True)
    rim = _at_rim(points, tree, looked_at, _plane_normals(points, tree, looked_at))
    return np.asarray(rim[inverse.reshape(around.shape)].any(axis=1))


def is_beyond_rim(points: Points, rows: Indices, places: Float64[np.ndarray, "M 3"]) -> Bool[np.ndarray, " M"]:
    """Return which places go on beyond a rim of a cloud: from their nearest point, mostly along the surface there.

    Where the cloud goes on as well, some other point would be nearer.

    Args:
        points: (N, 3) all points.
        rows: (M,) index of the point nearest to each place.
        places: (M, 3) farther from it than points are from each other.
    """
    at_rim = is_at_rim(points, rows)
    rest = np.flatnonzero(~at_rim)
    offsets = places[rest] - points[rows[rest]]
    normals = _plane_normals(points, cKDTree(points), rows[rest])
    across = np.abs((offsets * normals).sum(axis=1))
    at_rim[rest] = across < _LEAST_SINE * np.linalg.norm(offsets, axis=1)
    return at_rim


def local_areas(points: Points) -> Float64[np.ndarray, " N"]:
    """Return the area that each point stands for, as `sampled_areas` does, averaged over neighbours.

    It tells how dense points are, and hardly how far one of them lies off the others by noise.
    """
    areas, tree = sampled_areas(points), cKDTree(points)
    count, smooth = min(_AVERAGED, len(points)), np.empty(len(points))
    for start in range(0, len(points), 1 << 16):
        block = slice(start, start + (1 << 16))
        smooth[block] = areas[tree.query(points[block], count)[1]].mean(axis=1)
    return smooth


def _at_rim(points: Points, tree: "cKDTree[None]", rows: Indices, normals: _OfSome) -> Bool[np.ndarray, " M"]:
    count = min(_RIM_NEIGHBOURS, len(points) - 1)
    rim = np.zeros(len(rows), dtype=bool)
    for start in range(0, len(rows), 1 << 16):
        block = slice(start, start + (1 << 16))
        some = points[rows[block]]
        offsets = points[tree.query(some, count + 1)[1]] - some[:, None]
        first, second = tangent_vectors(normals[block])
        x, y = (np.einsum("nki,ni->nk", offsets[:, 1:], axis) for axis in (first, second))
        angles = np.sort(np.arctan2(y, x), axis=1)
        gaps = np.diff(angles, axis=1, append=angles[:, :1] + 2 * np.pi)
        rim[block] = gaps.max(axis=1) > _RIM_ANGLE
    return rim


def tangent_vectors(normals: Normals) -> tuple[Normals, Normals]:
    """Return two unit vectors orthogonal to each normal and to each other."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = unit_vectors(np.cross(normals, least))
    return first, np.cross(normals, first)


def _position(sensor: Sequence[float]) -> Position:
    numbers = np.array(sensor, dtype=np.float64)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise MeshError(f"sensor: expected three finite numbers, got {numbers.tolist()}")
    x, y, z = numbers.tolist()
    return x, y, z


def _unit_or_zero(vectors: Normals) -> Normals:
    """Return unit vectors, and 0 for those that are not finite; what is of unit length keeps its bits."""
    known = np.where(np.isfinite(vectors).all(axis=1, keepdims=True), vectors, 0.0)
    is_unit = np.abs(np.linalg.norm(known, axis=1, keepdims=True) - 1) < _ROUNDING
    return np.where(is_unit, known, unit_vectors(known))


def _plane_normals(points: Points, tree: "cKDTree[None]", rows: Indices | None = None) -> _OfSome:
    count = num_plane_neighbours(points, tree)
    some = points if rows is None else points[rows]
    normals = np.empty_like(some)
    for start in range(0, len(some), 1 << 16):
        block = slice(start, start + (1 << 16))
        neighbours = points[tree.query(some[block], count)[1]]
        offsets = neighbours - neighbours.mean(axis=1, keepdims=True)
        normals[block] = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))[1][:, :, 0]
    return normals


def num_plane_neighbours(points: Points, tree: "cKDTree[None]") -> int:
    """Return how many neighbours a plane needs: some, or as many as reach beyond the noise."""
    noise, most = noise_of_points(points), min(_MOST_NEIGHBOURS, len(points))
    if most <= _NEIGHBOURS:
        return most
    some = points[:: max(1, len(points) // _SOME)]
    radii = np.median(np.asarray(tree.query(some, most)[0]), axis=0)
    return int(np.clip(np.searchsorted(radii, NEIGHBOURHOOD * noise), _NEIGHBOURS, most))


def _consistently_oriented(points: Points, normals: Normals, tree: "cKDTree[None]") -> Normals:
    tail, head = _links(points, tree)
    cost = 1 - np.abs(np.einsum("nk,nk->n", normals[tail], normals[head])) + 1e-6
    graph: Any = coo_array((cost, (tail, head)), shape=(len(points), len(points))).tocsr()
    forest = minimum_spanning_tree(graph)
    count, part = connected_components(forest, directed=False)
    sign = np.zeros(len(points))
    highest = np.lexsort((points[:, 2], part))
    roots = highest[np.flatnonzero(np.diff(part[highest], append=count))]
    for root in roots:
        order, parent = breadth_first_order(forest, root, directed=False)
        sign[root] = 1.0 if normals[root, 2] >= 0 else -1.0
        agrees = np.where(np.einsum("nk,nk->n", normals[order[1:]], normals[parent[order[1:]]]) < 0, -1.0, 1.0)
        for child, ancestor, factor in zip(
            order[1:].tolist(), parent[order[1:]].tolist(), agrees.tolist(), strict=True
        ):
            sign[child] = factor * sign[ancestor]
    return np.asarray(normals * sign[:, None])


def _links(points: Points, tree: "cKDTree[None]") -> tuple[Int64[np.ndarray, " L"], Int64[np.ndarray, " L"]]:
    """Return pairs of neighbouring points, each once."""
    neighbours = np.asarray(tree.query(points, min(_LINKS, len(points) - 1) + 1)[1])
    tail = np.repeat(np.arange(len(points)), neighbours.shape[1] - 1)
    head = neighbours[:, 1:].reshape(-1)
    keys = np.unique((np.minimum(tail, head) * len(points) + np.maximum(tail, head))[tail != head])
    return keys // len(points), keys % len(points)
