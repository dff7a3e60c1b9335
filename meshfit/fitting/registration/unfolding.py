"""Unfolding: faces that a registration has made cross each other are taken apart, as rigidly as possible."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from scipy.sparse import csr_array, diags_array

from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.registration.template import Template
from meshfit.mesh.geometry import nearest_rotations
from meshfit.mesh.mesh import Verts
from meshfit.mesh.sparse_factors import SymmetricFactors, nested_dissection
from meshfit.remeshing.self_intersections import intersecting_pairs

_ROUNDS, _PATIENCE, _ITERATIONS = 30, 8, 4
# Faces that cross are near on the template if they are at most so many mean edges apart; the others are drawn inwards
# by this share of one.
_NEAR, _INWARDS = 8.0, 0.15
# Rings around faces that cross, at most, and the rings beyond that are held.
_MOST_RINGS, _HELD_RINGS = 8, 2
# Weights by which vertices stay where they are: those that unfold, those around them, those drawn inwards.
_FREE, _HELD, _DRAWN = 1e-3, 1e3, 1.0
_IMMOVABLE = 1e9
_SMOOTHINGS = 3
_SMOOTHING_ROUNDS = 12
# Double area of a face, in squares of its longest edge, that is none.
_NO_AREA = 1e-6


@dataclass
class _Ties:
    """Pairs of vertices whose offset at rest is to be restored."""

    keys: Int64[np.ndarray, " T"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def add(self, first: np.ndarray, second: np.ndarray, count: int) -> None:
        self.keys = np.union1d(self.keys, np.minimum(first, second) * count + np.maximum(first, second))

    def ends(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        return self.keys // count, self.keys % count


@dataclass(frozen=True, eq=False)
class Unfolding:
    """Takes faces apart that cross now and did not at rest.

    Where they cross, the surface is let go and follows its shape at rest, as rigidly as possible (Sorkine and Alexa
    2007). Vertices of faces that cross are tied: extra edges restore their offsets at rest. As the template does not
    cross itself there, ties that hold make the faces not cross. Pairs that are far apart at rest are drawn inwards.

    Faces that are flipped or have lost their area are smoothed away where nothing comes to cross by it.

    Attributes:
        template: the template.
        pairs_at_rest: (P, 2) pairs of faces that cross at rest, the lower first.
        crossing_at_rest: (F,) faces that cross others at rest; two of them may cross each other.
        folded_at_rest: (F,) faces that are flipped or without area at rest, and may stay so.
        held: (V,) vertices that do not move; None for none.
    """

    template: Template
    pairs_at_rest: Int64[np.ndarray, "P 2"]
    crossing_at_rest: Bool[np.ndarray, " F"]
    folded_at_rest: Bool[np.ndarray, " F"]
    held: Bool[np.ndarray, " V"] | None = None

    @classmethod
    def of(cls, template: Template, held: Bool[np.ndarray, " V"] | None = None) -> "Unfolding":
        """Return the unfolding of a template."""
        crossing, pairs = np.zeros(template.mesh.num_faces, dtype=bool), _crossing(template, template.mesh.verts)
        crossing[pairs.ravel()] = True
        return cls(template, pairs, crossing, _folded(template, template.mesh.verts), held)

    def new_pairs(self, verts: Verts) -> Int64[np.ndarray, "P 2"]:
        """Return the pairs of faces that cross at some positions, and did not at rest."""
        pairs = _crossing(self.template, verts)
        return np.asarray(pairs[~self.crossing_at_rest[pairs].all(axis=1)])

    def num_changed_pairs(self, verts: Verts) -> int:
        """Count the pairs of faces that cross at some positions, and at rest cross others, but not each other."""
        size = np.array([self.template.mesh.num_faces, 1])
        pairs = _crossing(self.template, verts)
        among = pairs[self.crossing_at_rest[pairs].all(axis=1)]
        return len(np.setdiff1d(among @ size, self.pairs_at_rest @ size))

    def new_folds(self, verts: Verts) -> Int64[np.ndarray, " N"]:
        """Return the faces that are flipped or without area at some positions, and were not at rest."""
        return np.flatnonzero(_folded(self.template, verts) & ~self.folded_at_rest)

    def faults(self, verts: Verts) -> tuple[int, int]:
        """Return the number of pairs that cross and of faces that are folded, without those at rest."""
        return len(self.new_pairs(verts)), len(self.new_folds(verts))

    def unfolded(
        self, verts: Verts, on_round: Callable[[int], None] = lambda _: None, *, stiffer: bool = False
    ) -> tuple[Verts, tuple[int, int]]:
        """Return the positions with the fewest pairs that cross, and their number and that of folded faces.

        Args:
            verts: (V, 3) positions.
            on_round: called with the number of pairs in each round.
            stiffer: follow the shape at rest more closely, and on larger patches.
        """
        most_rings, iterations = (4 * _MOST_RINGS, 4 * _ITERATIONS) if stiffer else (_MOST_RINGS, _ITERATIONS)
        template, count = self.template, len(verts)
        edge = float(template.rest_lengths.mean())
        ties, level = _Ties(), np.zeros(count, dtype=np.int64)
        far, loose = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        best, fewest, since = verts, (np.iinfo(np.int64).max, 0), 0
        for number in range(_ROUNDS):
            pairs, folds = self.new_pairs(verts), self.new_folds(verts)
            faults = len(pairs), len(folds)
            on_round(len(pairs))
            if faults < fewest:
                best, fewest, since = verts, faults, number
            if not len(pairs) or number - since > _PATIENCE:
                break
            corners = template.mesh.faces[pairs]
            crossing = np.zeros(count, dtype=bool)
            crossing[corners.ravel()] = True
            level[crossing] += 1
            first, second = corners[:, 0].repeat(3, axis=1).ravel(), np.tile(corners[:, 1], 3).ravel()
            apart = np.linalg.norm(template.mesh.verts[first] - template.mesh.verts[second], axis=1) >= _NEAR * edge
            tied = (first != second) & ~apart
            ties.add(first[tied], second[tied], count)
            far[first[apart]] = far[second[apart]] = True
            for value in np.unique(level[crossing]):
                loose |= template.grown(crossing & (level >= value), min(1 + int(value), most_rings))
            drawn = template.grown(far & crossing)
            goals = verts.copy()
            goals[drawn] -= _INWARDS * edge * template.points_at(verts).normals[drawn]
            stay = np.where(loose, _FREE, _HELD)
            stay[drawn] = _DRAWN
            if self.held is not None:
                stay[self.held], goals[self.held] = _IMMOVABLE, verts[self.held]
            relaxed = self._relaxed(verts, goals, stay, template.grown(loose, _HELD_RINGS), ties, iterations)
            verts = relaxed if self.held is None else np.where(self.held[:, None], verts, relaxed)
        return best, fewest

    def smoothed(self, verts: Verts) -> tuple[Verts, int]:
        """Return positions with fewer folded faces, by smoothing, where nothing comes to cross, and how many stay."""
        connectivity, most = self.template.connectivity, len(self.new_pairs(verts))
        folds = self.new_folds(verts)
        best, fewest, moved = verts, len(folds), torch.tensor(verts)
        for number in range(_SMOOTHING_ROUNDS):
            if not len(folds):
                break
            near = connectivity.verts_of(torch.tensor(np.isin(np.arange(self.template.mesh.num_faces), folds)))
            for _ in range(number // 2):
                near = connectivity.grown(near)
            if self.held is not None:
                near &= ~torch.tensor(self.held)
            moved = torch.where(near[:, None], moved - (connectivity.umbrella @ moved) / 2, moved)
            folds = self.new_folds(smooth := np.asarray(moved.numpy()))
            if len(folds) < fewest and len(self.new_pairs(smooth)) <= most:
                best, fewest = smooth, len(folds)
        return best, fewest

    def _relaxed(
        self,
        verts: Verts,
        goals: Verts,
        stay: Float64[np.ndarray, " V"],
        patch: Bool[np.ndarray, " V"],
        ties: _Ties,
        iterations: int,
    ) -> Verts:
        """Return a patch relaxed towards its shape at rest, with ties, each vertex drawn to its goal."""
        rest, count = self.template.mesh.verts, len(verts)
        rows = np.flatnonzero(patch)
        local = np.full(count, -1)
        local[rows] = np.arange(len(rows))
        tail, head = (np.concatenate(pair) for pair in zip(self.template.edges.T, ties.ends(count), strict=True))
        inside = (local[tail] >= 0) & (local[head] >= 0)
        tail, head = tail[inside], head[inside]
        tail, head = np.concatenate([tail, head]), np.concatenate([head, tail])
        offsets = rest[tail] - rest[head]
        tail, head, size = local[tail], local[head], len(rows)
        ones = np.ones(len(tail))
        links = csr_array((ones, (tail, head)), shape=(size, size))
        gather = csr_array((ones, (tail, np.arange(len(tail)))), shape=(size, len(tail)))
        neighbours = self.template.adjacency[rows][:, rows]
        degree = (neighbours.sum(axis=1) + 1)[:, None]
        held = stay[rows][:, None]
        square = csr_array(diags_array(links.sum(axis=1) + held[:, 0]) - links)
        factors = SymmetricFactors(square, nested_dissection(square, rest[rows]))
        moving = verts[rows]
        for _ in range(iterations):
            moments = gather @ (offsets[:, :, None] * (moving[tail] - moving[head])[:, None, :]).reshape(-1, 9)
            for _ in range(_SMOOTHINGS):  # a folded vertex would keep its flipped turn
                moments = (neighbours @ moments + moments) / degree
            rotations = nearest_rotations(moments.reshape(-1, 3, 3))
            turned = np.einsum("eij,ej->ei", (rotations[tail] + rotations[head]) / 2, offsets)
            moving = factors.solve(gather @ turned + held * goals[rows])
        result = verts.copy()
        result[rows] = moving
        return result


def _crossing(template: Template, verts: Verts) -> Int64[np.ndarray, "P 2"]:
    pairs = intersecting_pairs(torch.tensor(verts), torch.tensor(template.mesh.faces))
    return np.asarray(pairs.numpy())


def _folded(template: Template, verts: Verts) -> Bool[np.ndarray, " F"]:
    """Return which faces are flipped, against the mean of their neighbours, or have no area."""
    shape = Shape(template.connectivity, torch.tensor(verts))
    longest = shape.edge_lengths[template.connectivity.edges.of_side].amax(1)
    flat = shape.double_area <= _NO_AREA * longest.square()
    return np.asarray((template.connectivity.edges.flipped(shape.normals) | flat).numpy())
