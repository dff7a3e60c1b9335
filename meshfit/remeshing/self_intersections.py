"""Fans that lie flat: the faces about a vertex of which none can run through another."""

from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from meshfit.remeshing.broad_phase import boxes_near, overlapping_boxes

# The least cosine between the normals of a fan and their mean.
_UPRIGHT = 0.1


def simple_fans(
    faces: Int64[Tensor, "F 3"], corners: Float64[Tensor, "F 3 3"], normals: Float64[Tensor, "F 3"], num_verts: int
) -> Bool[Tensor, " V"]:
    """Which verts have faces that, seen along the mean of their normals, close once around them without overlap.

    Of the faces about such a vertex, no two meet but at it and along sides that they share: seen so, all of them are
    counter-clockwise, the verts they lead to are those they come from, and one of them crosses a half-line from the
    vertex, so that they go around once (compare Volino and Magnenat-Thalmann, Efficient self-collision detection on
    smoothly discretized surface animations, 1994). Verts on a boundary have no such fan.

    Args:
        faces: int64, vertex indices.
        corners: float64, the positions of these.
        normals: float64, across each face; 0 where it has none.
        num_verts: V.
    """
    units = normals / dot(normals, normals).sqrt().clamp_min(torch.finfo(torch.float64).tiny)[:, None]
    mean = corners.new_zeros(num_verts, 3)
    for k in range(3):
        mean.index_add_(0, faces[:, k], units)
    mean /= dot(mean, mean).sqrt().clamp_min(torch.finfo(torch.float64).tiny)[:, None]
    level = _level(mean)
    label = _scrambled(torch.arange(num_verts, device=faces.device))
    upright = torch.ones(num_verts, dtype=torch.bool, device=faces.device)
    balance, turns = torch.zeros_like(label), torch.zeros_like(label)
    for k in range(3):
        vert, ahead, behind = faces[:, k], (k + 1) % 3, (k + 2) % 3
        upright[vert[dot(mean.index_select(0, vert), units) < _UPRIGHT]] = False
        balance.index_add_(0, vert, label.index_select(0, faces[:, ahead]) - label.index_select(0, faces[:, behind]))
        axis = level.index_select(0, vert)
        below, above = (dot(corners[:, end] - corners[:, k], axis) < 0 for end in (ahead, behind))
        turns.index_add_(0, vert, (below & ~above).long())
    return upright & (balance == 0) & (turns == 1)


def dot(a: Float64[Tensor, "N 3"], b: Float64[Tensor, "N 3"]) -> Float64[Tensor, " N"]:
    """Inner products of rows, rounded alike wherever a row stands."""
    products = a * b
    return products[:, 0] + products[:, 1] + products[:, 2]


def _level(mean: Float64[Tensor, "V 3"]) -> Float64[Tensor, "V 3"]:
    """A direction across each of some others."""
    x, y, z = mean.unbind(1)
    zero = torch.zeros_like(x)
    return torch.where((x.abs() > z.abs())[:, None], torch.stack([-y, x, zero], 1), torch.stack([zero, -z, y], 1))


def _scrambled(index: Int64[Tensor, " V"]) -> Int64[Tensor, " V"]:
    """Indices as numbers all over 64 bits, sums of which agree for different indices by accident only (SplitMix64)."""
    for shift, factor in ((30, -0x40A7B892E31B1A47), (27, -0x6B2FB644ECCEEE15)):
        index = (index + 1) * factor
        index = index ^ (index >> shift)
    return index


Rows = Int64[Tensor, " P"]

# Of the longest edge of the smaller of two faces: what comes closer touches, and is reported. This is far above the
# rounding of float64 and far below the gap between faces of a sound mesh that have no common vertex. Faces that have
# one, in one plane up to rounding, have whole sectors between them, far wider again: where they meet is looked for on
# an edge of one, which ends before the other begins.
_TOUCH = 1e-6
# Twice the area over the square of the longest edge: below, the normal is mere rounding, and a face has no inside.
_NEEDLE = 1e-12
# Coordinates beyond are taken for infinite, so that no product of them overflows.
_LARGEST = 1e50


@torch.no_grad()
def intersecting_pairs(
    verts: Float[Tensor, "V 3"],
    faces: Int64[Tensor, "F 3"],
    members: Int64[Tensor, " F"] | None = None,
    among: Bool[Tensor, " F"] | None = None,
) -> Int64[Tensor, "P 2"]:
    """Pairs of faces of which one runs through the other.

    Faces without a common vertex cross where an edge of the one meets the other, be it at its rim; faces with one where
    the side opposite that vertex does. Faces with two, neighbours across an edge, never cross; with three, always do.
    These are MeshLab's rules, in float64 and with a tolerance on the side of reporting, relative to the smaller face.
    But an edge within the tolerance of a face's plane all along does not meet it: faces in one plane may overlap.

    Candidates come from `overlapping_boxes`, less the faces about one vertex that is among `simple_fans`. They are
    tested as in Möller, A Fast Triangle-Triangle Intersection Test (1997), but that the points where edges meet planes
    are computed, as points of the edges, which they stay where the planes are almost one.

    Args:
        verts: float32 or float64. A face with a corner that is not finite, or beyond 1e50, is in no pair.
        faces: int64, vertex indices. Faces without area are allowed; those shrunk to a point, or that name a vertex
            twice, are in no pair.
        members: int64, at least 0: which mesh of a batch each face belongs to. Faces of different ones never cross.
        among: look only for pairs with one of these faces, which is faster where they are few.

    Returns:
        int64, each pair once, the lower face first, in lexicographic order.
    """
    rows = _regular(verts, faces)
    shapes = _Faces.of(verts.double(), faces.index_select(0, rows))
    company = torch.zeros_like(rows) if members is None else members.index_select(0, rows)
    rough = ~simple_fans(shapes.verts, shapes.corners, shapes.normals, len(verts))[shapes.verts].all(1)
    if among is not None:
        near = boxes_near(*shapes.boxes(), among.index_select(0, rows)).nonzero()[:, 0]
        rows, rough, company, shapes = *_at(near, rows, rough, company), shapes.only(near)
    count, found = max(1, len(faces)), [rows.new_empty(0)]
    for pairs in overlapping_boxes(*shapes.boxes(), company):
        i, j = shapes.crossing(*shapes.worth_testing(*pairs, rough))
        i, j = rows[i], rows[j]
        found.append(torch.minimum(i, j) * count + torch.maximum(i, j))
    codes = torch.cat(found).sort().values
    codes = codes[codes.diff(prepend=codes.new_full((1,), -1)) > 0]
    crossing = torch.stack([codes.div(count, rounding_mode="floor"), codes % count], 1)
    return crossing if among is None else crossing[among[crossing].any(1)]


def intersecting_faces(
    verts: Float[Tensor, "V 3"],
    faces: Int64[Tensor, "F 3"],
    members: Int64[Tensor, " F"] | None = None,
    among: Bool[Tensor, " F"] | None = None,
) -> Bool[Tensor, " F"]:
    """Which faces run through another or are run through, as `crossing_pairs` has it; the arguments are the same."""
    crossing = torch.zeros(len(faces), dtype=torch.bool, device=faces.device)
    crossing[intersecting_pairs(verts, faces, members, among).view(-1)] = True
    return crossing


@dataclass(frozen=True, eq=False)
class _Faces:
    """Faces, and what is computed once of each.

    Attributes:
        verts: (F, 3) the verts at the corners of each.
        corners: (F, 3, 3) the positions of these.
        normals: (F, 3) across each, twice its area long; 0 where a face is a needle.
        lengths: (F,) of the longest edge of each.
    """

    verts: Int64[Tensor, "F 3"]
    corners: Float64[Tensor, "F 3 3"]
    normals: Float64[Tensor, "F 3"]
    lengths: Float64[Tensor, " F"]

    @classmethod
    def of(cls, positions: Float64[Tensor, "V 3"], verts: Int64[Tensor, "F 3"]) -> "_Faces":
        """The faces with these verts."""
        corners = positions.index_select(0, verts.view(-1)).view(-1, 3, 3)
        a, b, c = corners.unbind(1)
        sides = b - a, c - b, a - c
        normals = torch.linalg.cross(sides[0], sides[1])
        squares = torch.stack([dot(side, side) for side in sides]).amax(0)
        needles = dot(normals, normals).sqrt() <= _NEEDLE * squares
        return cls(verts, corners, normals.masked_fill(needles[:, None], 0.0), squares.sqrt())

    def only(self, which: Rows) -> "_Faces":
        """Some of them."""
        return _Faces(*_at(which, self.verts, self.corners, self.normals, self.lengths))

    def boxes(self) -> tuple[Float64[Tensor, "F 3"], Float64[Tensor, "F 3"]]:
        """The least and the greatest corner of a box about each, as far as it may be touched."""
        a, b, c = self.corners.unbind(1)
        reach = _TOUCH * self.lengths[:, None]
        return torch.minimum(torch.minimum(a, b), c) - reach, torch.maximum(torch.maximum(a, b), c) + reach

    def worth_testing(self, i: Rows, j: Rows, rough: Bool[Tensor, " F"]) -> tuple[Tensor, Tensor]:
        """Pairs less neighbours across an edge, and less those with a common vertex unless both are `rough`."""
        columns = self.verts.T.int().contiguous()
        ours, theirs = ([column.index_select(0, rows) for column in columns] for rows in (i, j))
        shared = torch.zeros_like(i, dtype=torch.uint8)
        for mine, other in product(ours, theirs):
            shared += mine == other
        both = rough.index_select(0, i) & rough.index_select(0, j)
        worth = ((shared == 0) | (shared != 2) & both).nonzero()[:, 0]
        return i.index_select(0, worth), j.index_select(0, worth)

    def crossing(self, i: Rows, j: Rows) -> tuple[Tensor, Tensor]:
        """Which of some pairs cross."""
        ours = self._heights(i, j)
        i, j, ours = _at(_not_on_one_side(ours), i, j, ours)
        theirs = self._heights(j, i)
        i, j, ours, theirs = _at(_not_on_one_side(theirs), i, j, ours, theirs)
        same = self.verts.index_select(0, i)[:, :, None] == self.verts.index_select(0, j)[:, None]
        crossing = same.any(2).all(1)
        crossing |= self._pierces(i, j, ours, ~same.any(2)) | self._pierces(j, i, theirs, ~same.any(1))
        return i[crossing], j[crossing]

    def _touch(self, i: Rows, j: Rows) -> Float64[Tensor, " P"]:
        """How close faces i and j touch, times how long the normals of j are: 0 where a face of j has no inside."""
        (ours,), (theirs, normals) = _at(i, self.lengths), _at(j, self.lengths, self.normals)
        return _TOUCH * torch.minimum(ours, theirs) * dot(normals, normals).sqrt()

    def _heights(self, i: Rows, j: Rows) -> Float64[Tensor, "P 3"]:
        """The corners of faces i over the planes of faces j, in units of what touches; 0 where j has no inside."""
        (corners,), (foot, normals) = _at(i, self.corners), _at(j, self.corners[:, 0], self.normals)
        unit = self._touch(i, j)[:, None]
        heights = ((corners - foot[:, None]) @ normals[:, :, None])[:, :, 0]
        return (heights / unit).masked_fill(unit == 0, 0.0)

    def _pierces(
        self, i: Rows, j: Rows, heights: Float64[Tensor, "P 3"], free: Bool[Tensor, "P 3"]
    ) -> Bool[Tensor, " P"]:
        """Whether a side of a face i, between two corners that are `free`, meets its face j."""
        ahead, near = heights.roll(-1, 1), heights.abs() <= 1
        level, touching = near & near.roll(-1, 1), near | near.roll(-1, 1)
        across = (((heights <= 0) != (ahead <= 0)) | touching) & ~level & free & free.roll(-1, 1)
        pair, side = across.nonzero().unbind(1)
        above, below = heights[pair, side], ahead[pair, side]
        rows, others = _at(pair, i, j)
        start, end = self.corners[rows, side], self.corners[rows, (side + 1) % 3]
        share = (above / (above - below)).clamp(0, 1)[:, None]
        met = self._inside(start + share * (end - start), rows, others)
        pierces = torch.zeros_like(i, dtype=torch.bool)
        pierces[pair[met]] = True
        return pierces

    def _inside(self, points: Float64[Tensor, "P 3"], i: Rows, j: Rows) -> Bool[Tensor, " P"]:
        """Whether points of faces i, in the planes of faces j, lie in these or touch them."""
        (corners, normals), touch = _at(j, self.corners, self.normals), self._touch(i, j)
        inside = torch.ones_like(i, dtype=torch.bool)
        for k in range(3):
            along = corners[:, (k + 1) % 3] - corners[:, k]
            left = dot(torch.linalg.cross(along, points - corners[:, k]), normals)
            inside &= left >= -touch * dot(along, along).sqrt()
        return inside


def _regular(verts: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"]) -> Int64[Tensor, " R"]:
    """The faces with three corners that are finite, can be computed with, and are not one point."""
    a, b, c = faces.unbind(1)
    bounded = (verts.abs() <= _LARGEST).all(1)
    regular = (a != b) & (b != c) & (c != a)
    for corner in (a, b, c):
        regular &= bounded.index_select(0, corner)
    spread = torch.zeros_like(regular)
    for values in verts.T.contiguous():
        here = values.index_select(0, a)
        spread |= (values.index_select(0, b) != here) | (values.index_select(0, c) != here)
    return (regular & spread).nonzero()[:, 0]


def _not_on_one_side(heights: Float64[Tensor, "P 3"]) -> Int64[Tensor, " K"]:
    """Where not all corners of a face are clearly on one side of a plane."""
    a, b, c = heights.unbind(1)
    least, greatest = torch.minimum(torch.minimum(a, b), c), torch.maximum(torch.maximum(a, b), c)
    return ((least <= 1) & (greatest >= -1)).nonzero()[:, 0]


def _at(rows: Rows, *values: Tensor) -> tuple[Tensor, ...]:
    """The same rows of some tensors."""
    return tuple(value.index_select(0, rows) for value in values)
