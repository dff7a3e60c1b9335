"""Self-intersections: pairs of faces of which one passes through the other."""

from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from meshfit.remeshing.broad_phase import boxes_near, overlapping_boxes
from meshfit.remeshing.triangle_geometry import dot

Rows = Int64[Tensor, " P"]

# Distance below which two faces touch, and are reported, relative to the longest edge of the smaller. It is far above
# the rounding of float64 and far below the gap between faces of a sound mesh without a common vertex. Faces with a
# common vertex in one plane up to rounding have wide sectors between them, and intersections are looked for on an edge
# of one, which ends before the other face begins.
_TOUCH = 1e-6
# Double area over the square of the longest edge below which the normal is mere rounding, and a face has no inside.
_NEEDLE = 1e-12
# Coordinates beyond this count as infinite, so that no product overflows.
_LARGEST = 1e50
# Least cosine between the normals of the faces around a vertex and their mean.
_LEAST_COSINE = 0.1


@torch.no_grad()
def intersecting_pairs(
    verts: Float[Tensor, "V 3"],
    faces: Int64[Tensor, "F 3"],
    members: Int64[Tensor, " F"] | None = None,
    among: Bool[Tensor, " F"] | None = None,
) -> Int64[Tensor, "P 2"]:
    """Return the pairs of faces of which one passes through the other.

    Faces without a common vertex intersect if an edge of one meets the other, even at its boundary; faces with one
    common vertex, if the side opposite that vertex does. Faces with two never intersect; faces with three always do.
    These are MeshLab's rules, in float64, with a tolerance relative to the smaller face that errs on reporting. An edge
    within the tolerance of a face's plane along its whole length does not meet it: coplanar faces may overlap.

    Candidates come from `overlapping_boxes`, without the faces around vertices that have a normal cone. They are tested
    as in Möller, A Fast Triangle-Triangle Intersection Test (1997), except that the points where edges meet planes are
    computed as points of the edges, which is accurate even for nearly equal planes.

    Args:
        verts: (V, 3) float32 or float64. Faces with a corner that is not finite, or beyond 1e50, are in no pair.
        faces: (F, 3) int64, vertex indices. Faces without area are allowed; those shrunk to a point, or with a vertex
            twice, are in no pair.
        members: (F,) int64, at least 0: mesh of each face. Faces of different meshes never intersect.
        among: (F,) look only for pairs with one of these faces, which is faster if they are few.

    Returns:
        (P, 2) int64, each pair once, the lower face first, in lexicographic order.
    """
    rows = _regular(verts, faces)
    shapes = _Faces.of(verts.double(), faces.index_select(0, rows))
    meshes = torch.zeros_like(rows) if members is None else members.index_select(0, rows)
    rough = ~verts_with_normal_cone(shapes.verts, shapes.corners, shapes.normals, len(verts))[shapes.verts].all(1)
    if among is not None:
        near = boxes_near(*shapes.boxes(), among.index_select(0, rows)).nonzero()[:, 0]
        rows, rough, meshes, shapes = *_select(near, rows, rough, meshes), shapes.only(near)
    count, codes = max(1, len(faces)), [rows.new_empty(0)]
    for candidates in overlapping_boxes(*shapes.boxes(), meshes):
        i, j = shapes.intersecting(*shapes.worth_testing(*candidates, rough))
        i, j = rows[i], rows[j]
        codes.append(torch.minimum(i, j) * count + torch.maximum(i, j))
    code = torch.cat(codes).sort().values
    code = code[code.diff(prepend=code.new_full((1,), -1)) > 0]
    pairs = torch.stack([code.div(count, rounding_mode="floor"), code % count], 1)
    return pairs if among is None else pairs[among[pairs].any(1)]


def intersecting_faces(
    verts: Float[Tensor, "V 3"],
    faces: Int64[Tensor, "F 3"],
    members: Int64[Tensor, " F"] | None = None,
    among: Bool[Tensor, " F"] | None = None,
) -> Bool[Tensor, " F"]:
    """Return which faces are in one of the `intersecting_pairs`, whose arguments these are."""
    mask = torch.zeros(len(faces), dtype=torch.bool, device=faces.device)
    mask[intersecting_pairs(verts, faces, members, among).view(-1)] = True
    return mask


@dataclass(frozen=True, eq=False)
class _Faces:
    """Faces with their geometry.

    Attributes:
        verts: (F, 3) vertices at the corners.
        corners: (F, 3, 3) positions of the corners.
        normals: (F, 3) normals, of twice the area as length; 0 for needles.
        lengths: (F,) length of the longest edge.
    """

    verts: Int64[Tensor, "F 3"]
    corners: Float64[Tensor, "F 3 3"]
    normals: Float64[Tensor, "F 3"]
    lengths: Float64[Tensor, " F"]

    @classmethod
    def of(cls, positions: Float64[Tensor, "V 3"], verts: Int64[Tensor, "F 3"]) -> "_Faces":
        """Return the faces with these vertices."""
        corners = positions.index_select(0, verts.view(-1)).view(-1, 3, 3)
        a, b, c = corners.unbind(1)
        sides = b - a, c - b, a - c
        normals = torch.linalg.cross(sides[0], sides[1])
        squares = torch.stack([dot(side, side) for side in sides]).amax(0)
        needles = dot(normals, normals).sqrt() <= _NEEDLE * squares
        return cls(verts, corners, normals.masked_fill(needles[:, None], 0.0), squares.sqrt())

    def only(self, which: Rows) -> "_Faces":
        """Return some of them."""
        return _Faces(*_select(which, self.verts, self.corners, self.normals, self.lengths))

    def boxes(self) -> tuple[Float64[Tensor, "F 3"], Float64[Tensor, "F 3"]]:
        """Return the least and the greatest corner of the bounding box of each, enlarged by the tolerance."""
        a, b, c = self.corners.unbind(1)
        reach = _TOUCH * self.lengths[:, None]
        return torch.minimum(torch.minimum(a, b), c) - reach, torch.maximum(torch.maximum(a, b), c) + reach

    def worth_testing(self, i: Rows, j: Rows, rough: Bool[Tensor, " F"]) -> tuple[Tensor, Tensor]:
        """Drop pairs of adjacent faces, and pairs with a common vertex unless both are `rough`."""
        columns = self.verts.T.int().contiguous()
        verts_i, verts_j = ([column.index_select(0, rows) for column in columns] for rows in (i, j))
        shared = torch.zeros_like(i, dtype=torch.uint8)
        for vert_i, vert_j in product(verts_i, verts_j):
            shared += vert_i == vert_j
        both = rough.index_select(0, i) & rough.index_select(0, j)
        worth = ((shared == 0) | (shared != 2) & both).nonzero()[:, 0]
        return i.index_select(0, worth), j.index_select(0, worth)

    def intersecting(self, i: Rows, j: Rows) -> tuple[Tensor, Tensor]:
        """Return the pairs that intersect."""
        heights_i = self._heights(i, j)
        i, j, heights_i = _select(_not_on_one_side(heights_i), i, j, heights_i)
        heights_j = self._heights(j, i)
        i, j, heights_i, heights_j = _select(_not_on_one_side(heights_j), i, j, heights_i, heights_j)
        same = self.verts.index_select(0, i)[:, :, None] == self.verts.index_select(0, j)[:, None]
        mask = same.any(2).all(1)
        mask |= self._pierces(i, j, heights_i, ~same.any(2)) | self._pierces(j, i, heights_j, ~same.any(1))
        return i[mask], j[mask]

    def _tolerance(self, i: Rows, j: Rows) -> Float64[Tensor, " P"]:
        """Return the tolerance of pairs times the length of the normals of j; 0 where a face of j has no inside."""
        (length_i,), (length_j, normals) = _select(i, self.lengths), _select(j, self.lengths, self.normals)
        return _TOUCH * torch.minimum(length_i, length_j) * dot(normals, normals).sqrt()

    def _heights(self, i: Rows, j: Rows) -> Float64[Tensor, "P 3"]:
        """Return the heights of the corners of i over the planes of j, in tolerances; 0 where j has no inside."""
        (corners,), (foot, normals) = _select(i, self.corners), _select(j, self.corners[:, 0], self.normals)
        unit = self._tolerance(i, j)[:, None]
        heights = ((corners - foot[:, None]) @ normals[:, :, None])[:, :, 0]
        return (heights / unit).masked_fill(unit == 0, 0.0)

    def _pierces(
        self, i: Rows, j: Rows, heights: Float64[Tensor, "P 3"], free: Bool[Tensor, "P 3"]
    ) -> Bool[Tensor, " P"]:
        """Return whether a side of a face i, between two `free` corners, meets the face j."""
        ahead, near = heights.roll(-1, 1), heights.abs() <= 1
        level, touching = near & near.roll(-1, 1), near | near.roll(-1, 1)
        across = (((heights <= 0) != (ahead <= 0)) | touching) & ~level & free & free.roll(-1, 1)
        pair, side = across.nonzero().unbind(1)
        above, below = heights[pair, side], ahead[pair, side]
        rows, others = _select(pair, i, j)
        start, end = self.corners[rows, side], self.corners[rows, (side + 1) % 3]
        share = (above / (above - below)).clamp(0, 1)[:, None]
        inside = self._inside(start + share * (end - start), rows, others)
        pierces = torch.zeros_like(i, dtype=torch.bool)
        pierces[pair[inside]] = True
        return pierces

    def _inside(self, points: Float64[Tensor, "P 3"], i: Rows, j: Rows) -> Bool[Tensor, " P"]:
        """Return whether points of faces i, in the planes of faces j, lie in these within the tolerance."""
        (corners, normals), tolerance = _select(j, self.corners, self.normals), self._tolerance(i, j)
        inside = torch.ones_like(i, dtype=torch.bool)
        for k in range(3):
            along = corners[:, (k + 1) % 3] - corners[:, k]
            left = dot(torch.linalg.cross(along, points - corners[:, k]), normals)
            inside &= left >= -tolerance * dot(along, along).sqrt()
        return inside


def _regular(verts: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"]) -> Int64[Tensor, " R"]:
    """Return the faces with three different vertices of moderate finite coordinates, not all at one point."""
    a, b, c = faces.unbind(1)
    bounded = (verts.abs() <= _LARGEST).all(1)
    regular = (a != b) & (b != c) & (c != a)
    for corner in (a, b, c):
        regular &= bounded.index_select(0, corner)
    spread = torch.zeros_like(regular)
    for values in verts.T.contiguous():
        first = values.index_select(0, a)
        spread |= (values.index_select(0, b) != first) | (values.index_select(0, c) != first)
    return (regular & spread).nonzero()[:, 0]


def _not_on_one_side(heights: Float64[Tensor, "P 3"]) -> Int64[Tensor, " K"]:
    """Return the rows where not all corners are clearly on one side of the plane."""
    a, b, c = heights.unbind(1)
    least, greatest = torch.minimum(torch.minimum(a, b), c), torch.maximum(torch.maximum(a, b), c)
    return ((least <= 1) & (greatest >= -1)).nonzero()[:, 0]


def _select(rows: Rows, *values: Tensor) -> tuple[Tensor, ...]:
    """Return the same rows of some tensors."""
    return tuple(value.index_select(0, rows) for value in values)


def verts_with_normal_cone(
    faces: Int64[Tensor, "F 3"], corners: Float64[Tensor, "F 3 3"], normals: Float64[Tensor, "F 3"], num_verts: int
) -> Bool[Tensor, " V"]:
    """Return which vertices have faces that, seen along the mean of their normals, surround them once without overlap.

    The faces around such a vertex meet only at it and along common sides: in this view all are counter-clockwise, they
    form closed loops, and exactly one crosses a half-line from the vertex, so there is one loop of one turn (compare
    Volino and Magnenat-Thalmann, Efficient self-collision detection on smoothly discretized surface animations, 1994).
    Boundary vertices are never among them.

    Args:
        faces: (F, 3) int64, vertex indices.
        corners: (F, 3, 3) float64, positions of the corners.
        normals: (F, 3) float64, normals of any length; 0 where a face has none.
        num_verts: V.
    """
    units = normals / dot(normals, normals).sqrt().clamp_min(torch.finfo(torch.float64).tiny)[:, None]
    mean = corners.new_zeros(num_verts, 3)
    for k in range(3):
        mean.index_add_(0, faces[:, k], units)
    mean /= dot(mean, mean).sqrt().clamp_min(torch.finfo(torch.float64).tiny)[:, None]
    level = _orthogonal(mean)
    label = _hashed(torch.arange(num_verts, device=faces.device))
    upright = torch.ones(num_verts, dtype=torch.bool, device=faces.device)
    balance, turns = torch.zeros_like(label), torch.zeros_like(label)
    for k in range(3):
        vert, ahead, behind = faces[:, k], (k + 1) % 3, (k + 2) % 3
        upright[vert[dot(mean.index_select(0, vert), units) < _LEAST_COSINE]] = False
        balance.index_add_(0, vert, label.index_select(0, faces[:, ahead]) - label.index_select(0, faces[:, behind]))
        axis = level.index_select(0, vert)
        below, above = (dot(corners[:, end] - corners[:, k], axis) < 0 for end in (ahead, behind))
        turns.index_add_(0, vert, (below & ~above).long())
    return upright & (balance == 0) & (turns == 1)


def _orthogonal(mean: Float64[Tensor, "V 3"]) -> Float64[Tensor, "V 3"]:
    """Return a vector orthogonal to each of some others."""
    x, y, z = mean.unbind(1)
    zero = torch.zeros_like(x)
    return torch.where((x.abs() > z.abs())[:, None], torch.stack([-y, x, zero], 1), torch.stack([zero, -z, y], 1))


def _hashed(index: Int64[Tensor, " V"]) -> Int64[Tensor, " V"]:
    """Hash indices to 64 bits, so that sums of different indices agree by accident only (SplitMix64)."""
    for shift, factor in ((30, -0x40A7B892E31B1A47), (27, -0x6B2FB644ECCEEE15)):
        index = (index + 1) * factor
        index = index ^ (index >> shift)
    return index
