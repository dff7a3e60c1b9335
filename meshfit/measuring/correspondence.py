"""Correspondence of a registered source with its target: the partner of each vertex, and the share without one."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from meshfit.measuring.shortfalls import FAR
from meshfit.mesh.geometry import bounding_box_diagonal, face_areas, face_normals, unit_vectors, vert_area_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.point_cloud import PointCloud, is_at_rim, local_areas
from meshfit.mesh.proximity import nearest_on_surface
from meshfit.mesh.topology import Topology

# A vertex has no partner beyond this share of the target's diagonal if the nearest point is at the target's rim; nor if
# the nearest face looks the other way, by this cosine. Between points of a cloud, it may be so many spacings away.
_AT_RIM, _FACING, _SPACINGS = 0.005, -0.3, 2.0
# A nearest point is on a boundary edge if the barycentric coordinate of the opposite corner is below this.
_ON_EDGE = 1e-9


@dataclass(frozen=True)
class Unmatched:
    """Parts without a partner.

    Attributes:
        source: share of the source's area.
    """

    source: float


@dataclass(frozen=True, eq=False)
class Correspondence:
    """The nearest point of the target to each vertex of a result.

    Attributes:
        indices: (V,) the faces of the target with these points; for a target of points, the points.
        barycentric: (V, 3) their barycentric coordinates in the faces; None for a target of points.
        points: (V, 3) their positions.
        distances: (V,) of the vertices from them.
    """

    indices: Int64[np.ndarray, " V"]
    barycentric: Float64[np.ndarray, "V 3"] | None
    points: Float64[np.ndarray, "V 3"]
    distances: Float64[np.ndarray, " V"]

    @classmethod
    def of(cls, result: Mesh, target: Mesh | PointCloud) -> "Correspondence":
        """Return the correspondence of a result with its target."""
        if isinstance(target, PointCloud):
            rows = nearest_point_query(target.verts)(result.verts)
            points = target.verts[rows]
            return cls(rows, None, points, np.linalg.norm(result.verts - points, axis=1))
        nearest = nearest_on_surface(target, result.verts)
        barycentric = _barycentric(target.verts[target.faces[nearest.faces]], nearest.points)
        return cls(nearest.faces, barycentric, nearest.points, nearest.distances)

    def restored(self, frame: Frame) -> "Correspondence":
        """Return the same correspondence in the coordinates of the target's file."""
        points = self.points * frame.scale + np.array(frame.centre)
        return replace(self, points=points, distances=self.distances * frame.scale)

    def to_csv(self) -> str:
        """Return one row per vertex: its number, the face and the barycentric coordinates of its partner, or the point.

        Position and distance of the partner follow. Numbers begin at 0 and have 12 digits.
        """
        names, columns = ["point"], [self.indices]
        if self.barycentric is not None:
            names, columns = ["face", "b0", "b1", "b2"], [self.indices, *self.barycentric.T]
        names, columns = [*names, "x", "y", "z", "distance"], [*columns, *self.points.T, self.distances]
        lines = [",".join(["vertex", *names])]
        for vertex, (index, *numbers) in enumerate(zip(*columns, strict=True)):
            lines.append(",".join([str(vertex), str(int(index)), *(f"{number:.12g}" for number in numbers)]))
        return "\n".join(lines) + "\n"


def unmatched(source: Mesh, result: Mesh, target: Mesh | PointCloud) -> Unmatched:
    """Measure the share of a source that has no partner on the target.

    A vertex has one if the nearest point of the target is within 2 % of its diagonal, faces the same way, and is not at
    its rim, unless the vertex is near to that too.

    Args:
        source: the source.
        result: the same faces, registered.
        target: to which they were registered.
    """
    areas = np.zeros(source.num_verts)
    np.add.at(areas, source.faces.reshape(-1), np.repeat(face_areas(source) / 3, 3))
    return Unmatched(float(np.average(~has_partner(result, target), weights=areas)))


def has_partner(result: Mesh, target: Mesh | PointCloud) -> Bool[np.ndarray, " V"]:
    """Return (V,) which vertices of a result have a partner on the target."""
    found = Correspondence.of(result, target)
    diagonal = bounding_box_diagonal(target.verts)
    near, beside_rim = FAR * diagonal, _AT_RIM * diagonal
    if isinstance(target, PointCloud):
        spacing = float(np.sqrt(np.median(local_areas(target.verts))))
        near, beside_rim = max(near, _SPACINGS * spacing), max(beside_rim, _SPACINGS * spacing)
        partner = found.distances <= near
        rows = np.flatnonzero(partner & (found.distances > beside_rim))
        if len(rows):
            partner[rows] = ~is_at_rim(target.verts, found.indices[rows])
        return partner
    assert found.barycentric is not None  # noqa: S101  it is a mesh
    cosines = (unit_vectors(vert_area_vectors(result)) * face_normals(target)[found.indices]).sum(axis=1)
    boundary = (Topology.of(target).twin < 0).reshape(-1, 3)[found.indices]  # from corner k to the next
    opposite = np.roll(found.barycentric, -2, axis=1)  # that of the corner opposite to the edge
    at_rim = (boundary & (opposite <= _ON_EDGE)).any(axis=1)
    partner = (found.distances <= near) & ~(at_rim & (found.distances > beside_rim))
    # Where a vertex lies on the target, a fold of it has the nearest face at random.
    return np.asarray(partner & ((cosines > _FACING) | (found.distances <= _ON_EDGE * diagonal)))


def _barycentric(corners: Float64[np.ndarray, "N 3 3"], points: Float64[np.ndarray, "N 3"]) -> np.ndarray:
    """Return (N, 3) barycentric coordinates of points on triangles; of faces without area, along the longest edge."""
    first, second, rest = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    normal = np.cross(first, second)
    squared = (normal**2).sum(axis=1)
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    flat = squared <= (1e-12 * lengths.max(axis=1) ** 2) ** 2
    safe = np.where(flat, 1.0, squared)
    second_share = (np.cross(first, rest) * normal).sum(axis=1) / safe
    first_share = (np.cross(rest, second) * normal).sum(axis=1) / safe
    result = np.stack([1 - first_share - second_share, first_share, second_share], axis=1)
    for row in np.flatnonzero(flat):
        start = int(lengths[row].argmax())
        end = (start + 1) % 3
        side = corners[row, end] - corners[row, start]
        share = float(side @ (points[row] - corners[row, start]) / max(float(side @ side), np.finfo(float).tiny))
        result[row] = 0.0
        result[row, [start, end]] = 1 - share, share
    result = np.maximum(result, 0.0)
    return np.asarray(result / result.sum(axis=1, keepdims=True))
