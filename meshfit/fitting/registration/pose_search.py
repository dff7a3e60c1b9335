"""Search for the pose of a surface that covers another, or a part of it, by trimmed ICP from a grid of rotations.

Many starts take the first rounds of ICP at once, with few points and nearest points that are looked up in a grid of
cells; the best go on with more points. No overlap, scale or side of the surfaces is assumed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float64, Int
from pykdtree.kdtree import KDTree
from scipy.spatial.transform import Rotation

from meshfit.fitting.registration.poses import Pose, principal_turns
from meshfit.mesh.geometry import bounding_box_diagonal

Points = Float[np.ndarray, "N 3"]
Distances = Float[np.ndarray, "B M"]
Way = Literal["forth", "back"]
"""From points of the source to the target, or from points of the target to the source."""

_ROTATIONS = 400
# Sizes of the larger surface relative to that of the part, and places of the part: the middle, and some on the
# way to the ends.
_GROWTHS, _ENDS, _TOWARDS_ENDS = (1.0, 1.5), 6, 0.7
# Points, rounds, and number of poses of each stage, one way; then of those that go on, both ways.
_STAGES = ((100, 4, None), (150, 6, 400), (300, 8, 60))
_GO_ON = 8
_AXES_POINTS, _AXES_ROUNDS, _AXES_GO_ON = 150, 6, 5
_LAST_POINTS, _LAST_ROUNDS = 1000, 15
# Share of pairs that count one way, and both ways where all of both may match.
_TRIM, _TRIM_BOTH = 0.7, 0.65
# Least share of pairs that match, and the power of this share that outweighs their distance.
_LEAST_OVERLAP, _OVERLAP_POWER = 0.2, 3.0
_POINT_WEIGHT = 0.1
# Scale relative to that of equal sizes, and the change of scale up to which the scale as given is tried.
_MOST_SCALED, _NEARLY_GIVEN = 3.0, 0.3
# Distances count up to this share of the target's diagonal.
_CAP = 0.15
# Poses closer than this angle and this change of scale are one.
_ALIKE, _ALIKE_SCALE = 0.3, 0.15
_LARGEST_TURN, _LARGEST_GROWTH = 0.6, 0.3
_CELLS, _MARGIN = 40, 0.3


@dataclass(frozen=True, eq=False)
class PoseBatch:
    """B similarities x ↦ s R x + t.

    Attributes:
        rotations: (B, 3, 3).
        translations: (B, 3).
        scales: (B,).
        free: (B,) those whose scale is to be found.
    """

    rotations: Float[np.ndarray, "B 3 3"]
    translations: Float[np.ndarray, "B 3"]
    scales: Float[np.ndarray, " B"]
    free: Bool[np.ndarray, " B"]

    @classmethod
    def of(
        cls,
        rotations: Float64[np.ndarray, "B 3 3"],
        translations: Float64[np.ndarray, "B 3"],
        scales: Float64[np.ndarray, " B"],
        *,
        free: bool = False,
    ) -> "PoseBatch":
        """Return poses that all have their scale fixed, or free."""
        return cls(rotations, translations, scales, np.full(len(scales), free))

    @classmethod
    def joined(cls, batches: Sequence["PoseBatch"]) -> "PoseBatch":
        """Return the poses of several batches, one after the other."""
        columns = zip(*((b.rotations, b.translations, b.scales, b.free) for b in batches), strict=True)
        return cls(*(np.concatenate(column) for column in columns))

    def __len__(self) -> int:
        """Return B."""
        return len(self.scales)

    def __getitem__(self, rows: Int[np.ndarray, " C"] | Bool[np.ndarray, " B"]) -> "PoseBatch":
        """Return some of the poses."""
        return PoseBatch(self.rotations[rows], self.translations[rows], self.scales[rows], self.free[rows])

    def astype(self, dtype: type[np.floating]) -> "PoseBatch":
        """Return the poses in another precision."""
        rotations, translations, scales = (
            part.astype(dtype) for part in (self.rotations, self.translations, self.scales)
        )
        return PoseBatch(rotations, translations, scales, self.free)

    def moved(self, points: Float[np.ndarray, "... M 3"]) -> Float[np.ndarray, "B M 3"]:
        """Return points in each pose."""
        turned = np.matmul(points, self.rotations.transpose(0, 2, 1))
        return np.asarray(self.scales[:, None, None] * turned + self.translations[:, None])

    def moved_back(self, points: Points) -> Float[np.ndarray, "B M 3"]:
        """Return the points that each pose takes to some."""
        return np.asarray(np.matmul(points - self.translations[:, None], self.rotations) / self.scales[:, None, None])


@dataclass(frozen=True, eq=False)
class _Side:
    """Points of one surface, with the nearest of them for each cell of a grid around it."""

    points: Points
    normals: Points
    tree: KDTree
    low: Float[np.ndarray, "3"]
    cell: float
    rows: Int[np.ndarray, "I J K"]

    @classmethod
    def of(cls, points: Points, normals: Points) -> "_Side":
        tree = KDTree(np.ascontiguousarray(points), leafsize=16)
        low, high = points.min(axis=0), points.max(axis=0)
        margin = _MARGIN * (high - low).max()
        low, cell = low - margin, float(((high - low).max() + margin) / _CELLS)
        shape = np.ceil((high + margin - low) / cell).astype(int)
        middles = (np.indices(tuple(shape)).reshape(3, -1).T + 0.5) * cell + low
        rows = np.asarray(tree.query(middles)[1]).astype(np.int32).reshape(shape)
        return cls(points, normals, tree, low, cell, rows)

    def some(self, count: int, generator: np.random.Generator) -> Points:
        return self.points[generator.choice(len(self.points), min(count, len(self.points)), replace=False)]

    def ends(self) -> Points:
        """Return the middle of the points, and places on the way from there to their ends, which are far apart."""
        distances, ends = np.linalg.norm(self.points, axis=1), list[int]()
        for _ in range(_ENDS):
            ends.append(int(distances.argmax()))
            apart = np.linalg.norm(self.points - self.points[ends[-1]], axis=1)
            distances = apart if len(ends) == 1 else np.minimum(distances, apart)
        return np.concatenate([np.zeros((1, 3)), _TOWARDS_ENDS * self.points[ends]])

    def nearest(self, queries: Float[np.ndarray, "B M 3"], *, exact: bool) -> Int[np.ndarray, "B M"]:
        if exact:
            rows = self.tree.query(np.ascontiguousarray(queries.reshape(-1, 3)))[1].astype(np.int64)
            return np.asarray(np.minimum(rows, len(self.points) - 1).reshape(queries.shape[:-1]))
        cells = ((queries - self.low.astype(queries.dtype)) / queries.dtype.type(self.cell)).astype(np.int32)
        np.clip(cells, 0, np.array(self.rows.shape, dtype=np.int32) - 1, out=cells)
        return np.asarray(self.rows[cells[..., 0], cells[..., 1], cells[..., 2]])


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Points of the source in each pose, their partners on the target, and normals there: (B, M, 3) each."""

    starts: Float[np.ndarray, "B M 3"]
    goals: Float[np.ndarray, "B M 3"]
    normals: Float[np.ndarray, "B M 3"]

    def distances(self) -> Distances:
        return np.asarray(np.linalg.norm(self.goals - self.starts, axis=2))


Samples = dict[Way, Points]


class PoseSearch:
    """Search for poses of a source on a target.

    Each pose is settled by ICP both ways. Pairs farther apart than the overlap of the two suggests are left out
    (Chetverikov et al., Robust Euclidean alignment of 3D point sets: the trimmed iterative closest point algorithm,
    2005, eq. 6). Where the scale of a pose is near to 1, it has a twin of scale 1.

    Args:
        source: (N, 3) points spread evenly on the source, a thousand or more.
        target: (M, 3) those of the target.
        normals: of both, of either sign.
    """

    def __init__(self, source: Points, target: Points, normals: tuple[Points, Points]) -> None:
        both = source, target
        self._centres = [points.mean(axis=0) for points in both]
        self._sizes = [float(np.sqrt(points.var(axis=0).sum())) for points in both]
        self._source, self._target = (
            _Side.of((points - centre) / size, own)
            for points, centre, size, own in zip(both, self._centres, self._sizes, normals, strict=True)
        )
        shift = (self._centres[0] - self._centres[1]) / self._sizes[1]
        self._given = PoseBatch.of(np.eye(3)[None], shift[None], np.array([self._sizes[0] / self._sizes[1]]))
        self._generator = np.random.default_rng(0)
        self._diagonal = bounding_box_diagonal(self._target.points)
        self._stages = [(self._samples(count), rounds, most) for count, rounds, most in _STAGES]
        self._last = self._samples(_LAST_POINTS)

    def from_axes(self) -> list[Pose]:
        """Return poses that the pose as given, and turns of principal axes onto principal axes, lead to."""
        given = self._given
        free = PoseBatch(given.rotations, given.translations, given.scales, np.ones(1, dtype=bool))
        return self._settled([given, free, self._by_axes()])

    def from_grid(self) -> list[Pose]:
        """Return poses that a grid of rotations leads to, with the middle of either surface at places of the other."""
        return self._settled([self._one_way("back"), self._one_way("forth")])

    def _settled(self, batches: list[PoseBatch]) -> list[Pose]:
        batch = PoseBatch.joined(batches)
        batch = PoseBatch.joined([batch, self._of_given_scale(batch)])
        for _ in range(_LAST_ROUNDS):
            batch = self._round(batch, self._last, trim=None, exact=True)
        return [self._pose(batch, row) for row in range(len(batch))]

    def _pose(self, batch: PoseBatch, row: int) -> Pose:
        factor = float(batch.scales[row] / self._given.scales[0])
        rotation, (centre, goal) = batch.rotations[row], self._centres
        shift = self._sizes[1] * batch.translations[row] + goal - factor * rotation @ centre
        return Pose(rotation, shift, factor)

    def _samples(self, count: int) -> Samples:
        return {
            "forth": self._source.some(count, self._generator),
            "back": self._target.some(count, self._generator),
        }

    def _one_way(self, way: Way) -> PoseBatch:
        """Return the best poses in which all of one surface lies on the other."""
        batch = self._grid(way).astype(np.float32)
        for samples, rounds, most in self._stages:
            chosen = {way: samples[way].astype(np.float32)}
            if most is not None:
                batch = batch[np.argsort(self._scores(batch, chosen), kind="stable")[:most]]
            for _ in range(rounds):
                batch = self._round(batch, chosen, trim=_TRIM, exact=False)
        return batch[_distinct(batch, self._scores(batch, chosen), _GO_ON)].astype(np.float64)

    def _grid(self, way: Way) -> PoseBatch:
        rotations = rotation_grid(_ROTATIONS)
        scales = [(growth if way == "back" else 1 / growth, True) for growth in _GROWTHS]
        own = float(self._given.scales[0])
        if 1 / _MOST_SCALED < own < _MOST_SCALED:
            scales.append((own, False))
        places = (self._source if way == "back" else self._target).ends()
        batches = list[PoseBatch]()
        for scale, free in scales:
            for place in places:
                shifts = -scale * rotations @ place if way == "back" else np.tile(place, (len(rotations), 1))
                batches.append(PoseBatch.of(rotations, shifts, np.full(len(rotations), scale), free=free))
        return PoseBatch.joined(batches)

    def _by_axes(self) -> PoseBatch:
        """Return the best poses that turns of principal axes lead to."""
        rotations = np.array([np.eye(3), *principal_turns(self._source.points, self._target.points)])
        batch = PoseBatch.of(rotations, np.zeros((len(rotations), 3)), np.ones(len(rotations)), free=True)
        samples = self._samples(_AXES_POINTS)
        for _ in range(_AXES_ROUNDS):
            batch = self._round(batch, samples, trim=_TRIM_BOTH, exact=False)
        return batch[_distinct(batch, self._scores(batch, samples), _AXES_GO_ON)]

    def _of_given_scale(self, batch: PoseBatch) -> PoseBatch:
        """Return those of poses whose scale is nearly that given with this scale; what lies at the middle stays."""
        own = self._given.scales[0]
        near = batch[batch.free & (np.abs(np.log(batch.scales / own)) < _NEARLY_GIVEN)]
        scales = np.full(len(near), own)
        translations = near.translations * (scales / near.scales)[:, None]
        return PoseBatch.of(near.rotations, translations, scales)

    def _pairs(self, batch: PoseBatch, way: Way, samples: Points, *, exact: bool) -> _Pairs:
        dtype = samples.dtype
        if way == "forth":
            starts = batch.moved(samples)
            rows = self._target.nearest(starts, exact=exact)
            return _Pairs(starts, *(part[rows].astype(dtype) for part in (self._target.points, self._target.normals)))
        rows = self._source.nearest(batch.moved_back(samples), exact=exact)
        starts = batch.moved(self._source.points[rows].astype(dtype))
        normals = np.matmul(self._source.normals[rows].astype(dtype), batch.rotations.transpose(0, 2, 1))
        return _Pairs(starts, np.broadcast_to(samples, starts.shape), normals)

    def _scores(self, batch: PoseBatch, samples: Samples) -> Float[np.ndarray, " B"]:
        """Return the mean square of capped distances; of two ways, mostly the better, as one may show a part."""
        cap = _CAP * self._diagonal
        ways = [self._pairs(batch, way, points, exact=False).distances() for way, points in samples.items()]
        means = np.sort([(np.minimum(way, cap) ** 2).mean(axis=1) for way in ways], axis=0)
        return np.asarray(means[0] + (0.02 * means[1] if len(means) > 1 else 0))

    def _round(self, batch: PoseBatch, samples: Samples, *, trim: float | None, exact: bool) -> PoseBatch:
        """Make one round of ICP: small similarities that reduce distances to planes, and a little to points."""
        ways = [self._pairs(batch, way, points, exact=exact) for way, points in samples.items()]
        weights = np.concatenate([_weights(way.distances(), trim) for way in ways], axis=1) / len(ways)
        starts, goals, normals = (
            np.concatenate([getattr(way, name) for way in ways], axis=1) for name in ("starts", "goals", "normals")
        )
        centre = np.einsum("bm,bmi->bi", weights, starts)
        arms, gaps = starts - centre[:, None], goals - starts
        free = batch.free.astype(arms.dtype)
        along = (normals * arms).sum(axis=2) * free[:, None]
        rows = np.concatenate([np.cross(arms, normals), normals, along[:, :, None]], axis=2)
        weighted = (rows * weights[:, :, None]).transpose(0, 2, 1)
        square = np.matmul(weighted, rows).astype(np.float64)
        right = np.matmul(weighted, (gaps * normals).sum(axis=2)[:, :, None])[:, :, 0].astype(np.float64)
        pulled = (weights[:, :, None] * arms).transpose(0, 2, 1)
        spread, moment = np.matmul(pulled, arms), np.matmul(pulled, gaps)
        size = np.trace(spread, axis1=1, axis2=2)
        square[:, :3, :3] += _POINT_WEIGHT * (size[:, None, None] * np.eye(3) - spread)
        square[:, 3:6, 3:6] += _POINT_WEIGHT * np.eye(3)
        square[:, 6, 6] += np.where(batch.free, _POINT_WEIGHT * size, 1.0)
        turning = moment - moment.transpose(0, 2, 1)
        right[:, :3] += _POINT_WEIGHT * turning[:, [1, 2, 0], [2, 0, 1]]
        right[:, 3:6] += _POINT_WEIGHT * np.einsum("bm,bmi->bi", weights, gaps)
        right[:, 6] += _POINT_WEIGHT * np.trace(moment, axis1=1, axis2=2) * free
        steps = np.linalg.solve(square + 1e-9 * np.eye(7), right[:, :, None])[:, :, 0]
        return _stepped(batch, steps.astype(arms.dtype), centre)


def rotation_grid(count: int) -> Float64[np.ndarray, "N 3 3"]:
    """Return rotations spread evenly (Alexa, Super-Fibonacci spirals, 2022)."""
    numbers = np.arange(count) + 0.5
    inner, outer = np.sqrt(numbers / count), np.sqrt(1 - numbers / count)
    first, second = 2 * np.pi * numbers / np.sqrt(2), 2 * np.pi * numbers / 1.533751168755204288
    parts = inner * np.sin(first), inner * np.cos(first), outer * np.sin(second), outer * np.cos(second)
    return np.asarray(Rotation.from_quat(np.stack(parts, axis=1)).as_matrix())


def _stepped(batch: PoseBatch, steps: Float[np.ndarray, "B 7"], centre: Float[np.ndarray, "B 3"]) -> PoseBatch:
    angles = np.linalg.norm(steps[:, :3], axis=1)
    turns = steps[:, :3] * np.minimum(1, _LARGEST_TURN / np.maximum(angles, 1e-12))[:, None]
    rotations = Rotation.from_rotvec(turns).as_matrix().astype(steps.dtype)
    grown = batch.scales * np.exp(np.clip(steps[:, 6], -_LARGEST_GROWTH, _LARGEST_GROWTH))
    scales = np.where(batch.free, np.clip(grown, 1 / _MOST_SCALED, _MOST_SCALED), batch.scales)
    arms = (scales / batch.scales)[:, None] * np.einsum("bij,bj->bi", rotations, batch.translations - centre)
    return PoseBatch(np.matmul(rotations, batch.rotations), arms + centre + steps[:, 3:6], scales, batch.free)


def _weights(distances: Distances, trim: float | None) -> Distances:
    """Return weights of pairs that sum to 1: 0 beyond the trimmed share, or beyond the overlap that is estimated."""
    ordered = np.sort(distances, axis=1)
    if trim is not None:
        widths = ordered[:, int(trim * (ordered.shape[1] - 1))]
    else:
        shares = np.arange(1, ordered.shape[1] + 1) / ordered.shape[1]
        means = np.sqrt(np.cumsum(ordered**2, axis=1)) / np.sqrt(shares) + 1e-9
        least = int(_LEAST_OVERLAP * len(shares))
        last = least + (means / shares**_OVERLAP_POWER)[:, least:].argmin(axis=1)
        widths = ordered[np.arange(len(ordered)), last]
    widths = (widths + 1e-6)[:, None]
    weights = np.where(distances <= widths, (1 + (2 * distances / widths) ** 2) ** -2.0, 0)
    return np.asarray(weights / (weights.sum(axis=1, keepdims=True)), dtype=distances.dtype)


def _distinct(batch: PoseBatch, scores: Float[np.ndarray, " B"], most: int) -> Int[np.ndarray, " C"]:
    """Return the rows of the best poses that differ from each other."""
    chosen = list[int]()
    for row in np.argsort(scores, kind="stable").tolist():
        traces = np.einsum("bij,ij->b", batch.rotations[chosen], batch.rotations[row])
        angles = np.arccos(np.clip((traces - 1) / 2, -1, 1))
        growths = np.abs(np.log(batch.scales[chosen] / batch.scales[row]))
        if not ((angles < _ALIKE) & (growths < _ALIKE_SCALE)).any():
            chosen.append(row)
        if len(chosen) == most:
            break
    return np.array(chosen)
