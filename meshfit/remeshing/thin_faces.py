"""Thin faces: tiny angles are removed by flips, collapses and moves that hardly change the surface."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import point_distances
from meshfit.remeshing.connectivity import Edges
from meshfit.remeshing.self_intersections import intersecting_pairs
from meshfit.remeshing.triangle_geometry import double_area_vectors, unit

LEAST_ANGLE = 1.0
"""Angle in degrees below which a face is thin."""
# Angle that is aimed at, so that rounding leaves none below the least.
_AIM = 1.02
# Largest deviation of the surface, relative to the diagonal of its bounding box: what is tried first, and then.
_DEVIATIONS = (1e-4, 4e-4)
# Largest number of passes over all thin faces, and of thin faces that are tried in all; more are no few exceptions.
_PASSES, _MOST = 6, 300
_LEAST_VALENCE = 3
# Shares of the way from a vertex to the mean of its neighbours.
_MOVES = (0.15, 0.4, 0.8)

Verts = Float64[np.ndarray, "V 3"]
Faces = Int64[np.ndarray, "F 3"]


@dataclass(frozen=True, eq=False)
class _Change:
    """A change of few faces.

    Attributes:
        old: indices of the faces that go.
        new: (N, 3) the faces that replace them.
        places: new positions of vertices.
    """

    old: Int64[np.ndarray, " M"]
    new: Int64[np.ndarray, "N 3"]
    places: dict[int, Float64[np.ndarray, " 3"]]


def without_thin_faces(
    verts: Tensor, faces: Int64[Tensor, "F 3"], piece: Int64[np.ndarray, " V"] | None = None
) -> tuple[Tensor, Int64[Tensor, "F 3"]]:
    """Remove angles below 1 degree where that hardly changes the surface; the topology is kept.

    Each thin face is tried with the flips and collapses of its edges, and with moves of its corners. Of those
    after which no angle nearby is below 1 degree, the one that moves the surface least is made; else the one with the
    largest angle. None is made after which more faces cross or are flipped, or the surface moves by more than 0.04 % of
    its diagonal.

    Args:
        verts: (V, 3) positions.
        faces: (F, 3) int64, an oriented manifold.
        piece: (V,) piece of each vertex, if those may cross each other.

    Returns:
        Vertices and faces, without unused vertices.
    """
    surface = _Surface(verts.cpu().double().numpy().copy(), faces.cpu().numpy().copy(), piece, verts.dtype)
    if not len(surface.thin()):
        return verts, faces
    surface.mend()
    used = np.unique(surface.faces)
    number = np.zeros(len(surface.verts), dtype=np.int64)
    number[used] = np.arange(len(used))
    device = verts.device
    return torch.tensor(surface.verts[used], dtype=verts.dtype, device=device), torch.tensor(
        number[surface.faces], device=device
    )


class _Surface:
    """A surface that is changed in place."""

    def __init__(self, verts: Verts, faces: Faces, piece: Int64[np.ndarray, " V"] | None, dtype: torch.dtype) -> None:
        self.verts, self.faces = verts, faces
        self._piece, self._dtype = piece, dtype
        self._diagonal = float(np.linalg.norm(np.ptp(verts, axis=0)))
        self._rim = _rim(faces, len(verts))

    def thin(self) -> Int64[np.ndarray, " N"]:
        """Return the thin faces, thinnest first."""
        sines = _sines(self.verts[self.faces])
        which = np.flatnonzero(sines < math.sin(math.radians(LEAST_ANGLE)))
        return which[np.argsort(sines[which], kind="stable")]

    def mend(self) -> None:
        """Change the surface at its thin faces until there are none, or nothing helps."""
        tried = 0
        for deviation in _DEVIATIONS:
            for _ in range(_PASSES):
                thin = self.faces[self.thin()]
                made = 0
                for corners in thin[: _MOST - tried]:
                    # Earlier changes may have removed it.
                    at = np.flatnonzero((self.faces == corners).all(axis=1))
                    made += bool(len(at)) and self._improve(int(at[0]), deviation * self._diagonal)
                tried += len(thin)
                if not made:
                    break

    def _improve(self, face: int, deviation: float) -> bool:
        options: list[tuple[tuple[bool, float, int], _Change]] = []
        for change in self._changes(face):
            old, new = self.verts[self.faces[change.old]], self._corners(change)
            before, after = (float(_sines(corners).min(initial=1.0)) for corners in (old, new))
            enough = after >= math.sin(math.radians(_AIM))
            if not (enough or after > 1.05 * before):
                continue
            moved = _deviation(old, new)
            if moved <= deviation:
                options.append(((not enough, moved if enough else -after, len(options)), change))
        for _, change in sorted(options, key=lambda option: option[0]):
            if self._is_sound(change):
                self._make(change)
                return True
        return False

    def _corners(self, change: _Change) -> Float64[np.ndarray, "N 3 3"]:
        corners: Float64[np.ndarray, "N 3 3"] = self.verts[change.new]
        for vert, place in change.places.items():
            corners[change.new == vert] = place
        return corners

    def _around(self, *verts: int) -> Int64[np.ndarray, " N"]:
        return np.flatnonzero(np.isin(self.faces, verts).any(axis=1))

    def _changes(self, face: int) -> Iterator[_Change]:
        corners = self.faces[face]
        for k in range(3):
            a, b, c = (int(vert) for vert in np.roll(corners, -k))
            across = np.flatnonzero(((self.faces == a) | (self.faces == b)).sum(axis=1) == 2)
            across = across[across != face]
            if len(across) == 1:
                d = int(self.faces[across[0]].sum() - a - b)
                yield from self._flips(face, int(across[0]), a, b, c, d)
            yield from self._collapses(a, b)
            yield from self._moves(a, b, c)

    def _flips(self, face: int, other: int, a: int, b: int, c: int, d: int) -> Iterator[_Change]:
        if c == d or self._are_neighbours(c, d) or min(self._valence(a), self._valence(b)) <= _LEAST_VALENCE:
            return
        old, new = np.array([face, other]), np.array([[a, d, c], [d, b, c]])
        yield _Change(old, new, {})

    def _collapses(self, a: int, b: int) -> Iterator[_Change]:
        around = self._around(a, b)
        faces = self.faces[around]
        both = np.isin(faces, (a, b)).sum(axis=1) == 2
        common = set(self._neighbours(a)) & set(self._neighbours(b))
        at_rim = [bool(self._rim[vert]) for vert in (a, b)]
        if len(common) != both.sum() or any(self._valence(int(vert)) <= _LEAST_VALENCE for vert in common):
            return
        if all(at_rim) and both.sum() != 1:
            return
        new = np.where(faces[~both] == b, a, faces[~both])
        if len(new) < _LEAST_VALENCE or len(np.unique(np.sort(new, axis=1), axis=0)) < len(new):
            return
        places = [self.verts[a], self.verts[b], (self.verts[a] + self.verts[b]) / 2]
        if any(at_rim):
            places = [place for place, is_at in zip(places, at_rim, strict=False) if is_at]
        for place in places:
            yield _Change(around, new, {a: self._rounded(place)})

    def _moves(self, a: int, b: int, c: int) -> Iterator[_Change]:
        if self._rim[a]:
            return
        around = self._around(a)
        faces, start = self.faces[around], self.verts[a]
        goals = [self.verts[self._neighbours(a)].mean(axis=0), *(2 * start - self.verts[vert] for vert in (b, c))]
        along = self.verts[c] - self.verts[b]
        foot = self.verts[b] + along * np.clip((start - self.verts[b]) @ along / max(along @ along, 1e-300), 0, 1)
        away = start - foot
        # A multiple of its height over the opposite side, if that is what is small.
        goals += [start + 2 * away, start + 4 * away]
        for goal in goals:
            for share in _MOVES:
                yield _Change(around, faces, {a: self._rounded(start + share * (goal - start))})

    def _rounded(self, place: Float64[np.ndarray, " 3"]) -> Float64[np.ndarray, " 3"]:
        return torch.tensor(place).to(self._dtype).double().numpy()

    def _neighbours(self, vert: int) -> Int64[np.ndarray, " N"]:
        near = np.unique(self.faces[self._around(vert)])
        others: Int64[np.ndarray, " N"] = near[near != vert]
        return others

    def _valence(self, vert: int) -> int:
        return len(self._neighbours(vert))

    def _are_neighbours(self, a: int, b: int) -> bool:
        return bool((np.isin(self.faces, (a, b)).sum(axis=1) == 2).any())

    def _is_sound(self, change: _Change) -> bool:
        """Return whether no more faces cross or are flipped than before."""
        old, new = self.verts[self.faces[change.old]], self._corners(change)
        points = np.concatenate([old.reshape(-1, 3), new.reshape(-1, 3)])
        margin = 1e-3 * float(np.ptp(points, axis=0).max())
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        corners = self.verts[self.faces]
        near = ((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1)
        # Neighbours tell whether a face is flipped.
        near |= np.isin(self.faces, self.faces[change.old]).any(axis=1)
        near[change.old] = False
        rest = self.faces[near]
        before = self._faults(self.verts, rest, self.faces[change.old])
        after = self._faults(self._moved(change), rest, change.new)
        return after[0] <= before[0] and after[1] <= before[1]

    def _faults(self, verts: Verts, rest: Faces, changed: Int64[np.ndarray, "C 3"]) -> tuple[int, int]:
        """Return how many pairs cross with some changed faces, and how many faces are flipped."""
        faces = np.concatenate([changed, rest])
        used, flat = np.unique(faces, return_inverse=True)
        small, rows = torch.tensor(verts[used]), torch.tensor(flat.reshape(-1, 3))
        among = torch.arange(len(faces)) < len(changed)
        members = None if self._piece is None else torch.tensor(self._piece[faces[:, 0]])
        crossing = intersecting_pairs(small, rows, members, among)
        edges = Edges.of(rows, len(small))
        flipped = edges.flipped(unit(double_area_vectors(small, rows)))
        near = torch.zeros(len(small), dtype=torch.bool)
        near[rows[: len(changed)].reshape(-1)] = True
        return len(crossing), int((flipped & near[rows].any(1)).sum())

    def _moved(self, change: _Change) -> Verts:
        verts = self.verts.copy()
        for vert, place in change.places.items():
            verts[vert] = place
        return verts

    def _make(self, change: _Change) -> None:
        self.verts = self._moved(change)
        self.faces = np.concatenate([np.delete(self.faces, change.old, axis=0), change.new])


def _sines(corners: Float64[np.ndarray, "N 3 3"]) -> Float64[np.ndarray, " N"]:
    """Return the sine of the smallest angle of each triangle."""
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    product = sides.prod(axis=1)
    double_area = np.linalg.norm(across, axis=1)
    sines: Float64[np.ndarray, " N"] = double_area * sides.min(axis=1) / np.maximum(product, np.finfo(float).tiny)
    return sines


def _deviation(old: Float64[np.ndarray, "M 3 3"], new: Float64[np.ndarray, "N 3 3"]) -> float:
    """Return the largest distance between two patches, from corners, middles of sides and middles."""
    ways = []
    for origin, surface in ((old, new), (new, old)):
        points = np.concatenate(
            [origin.reshape(-1, 3), ((origin + np.roll(origin, -1, axis=1)) / 2).reshape(-1, 3), origin.mean(axis=1)]
        )
        mesh = Mesh(surface.reshape(-1, 3), np.arange(3 * len(surface)).reshape(-1, 3))
        ways.append(float(point_distances(mesh, points).max()))
    return max(ways)


def _rim(faces: Faces, num_verts: int) -> np.ndarray:
    edges = Edges.of(torch.tensor(faces), num_verts)
    return edges.on_boundary.numpy()
