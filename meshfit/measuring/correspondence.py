"""Correspondence of a registered source with its target: the partner of each vertex, and the share without one."""

from collections.abc import Sequence
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
# the nearest face looks the other way, by this cosine. Between points of a cloud,
# it may be so many spacings away, and at its rim one.
_AT_RIM, _FACING, _SPACINGS = 0.005, -0.3, 2.0
_CLOUD_POINTS = 100_000
# Largest coordinate difference, in diagonals, of positions that are the same up to rounding.
_SAME_PLACE = 1e-6
# A nearest point is on a boundary edge if the barycentric coordinate of the opposite corner is below this.
_ON_EDGE = 1e-9

Positions = Float64[np.ndarray, "N 3"]


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
        points: (V, 3) positions of these points.
        distances: (V,) of the vertices from them.
        indices: (V,) the faces of the target with these points; for a target of points, the points; None if the numbers
            of the target are not known.
        barycentric: (V, 3) barycentric coordinates in the faces; None without faces.
    """

    points: Float64[np.ndarray, "V 3"]
    distances: Float64[np.ndarray, " V"]
    indices: Int64[np.ndarray, " V"] | None
    barycentric: Float64[np.ndarray, "V 3"] | None = None

    @classmethod
    def of(cls, result: Mesh, target: Mesh | PointCloud) -> "Correspondence":
        """Return the correspondence of a result with its target, by the target's own faces or points."""
        if isinstance(target, PointCloud):
            rows = nearest_point_query(target.verts)(result.verts)
            points = target.verts[rows]
            return cls(points, np.linalg.norm(result.verts - points, axis=1), rows)
        nearest = nearest_on_surface(target, result.verts)
        barycentric = _barycentric(target.verts[target.faces[nearest.faces]], nearest.points)
        return cls(nearest.points, nearest.distances, nearest.faces, barycentric)

    def restored(self, frame: Frame) -> "Correspondence":
        """Return the same correspondence in the coordinates of the target's file."""
        points = self.points * frame.scale + np.array(frame.centre)
        return replace(self, points=points, distances=self.distances * frame.scale)

    def numbered_as(self, verts: Positions, corners: Int64[np.ndarray, " C"], num_faces: int) -> "Correspondence":
        """Return the same correspondence by the numbers of a file, or without numbers where these are others.

        Cleaning may have dropped some of its faces or points, or cut its polygons; all faces may have been turned.

        Args:
            verts: (N, 3) the vertices of the file.
            corners: vertices of its faces, one after the other.
            num_faces: number of its faces.
        """
        within = _SAME_PLACE * max(bounding_box_diagonal(verts), np.finfo(np.float64).tiny)

        def are_at(places: Positions) -> bool:
            return bool((np.abs(places - self.points) <= within).all())

        if self.indices is None or self.indices.max() >= (len(verts) if self.barycentric is None else num_faces):
            pass
        elif self.barycentric is None:
            if are_at(verts[self.indices]):
                return self
        elif len(corners) == 3 * num_faces:
            places = verts[corners.reshape(-1, 3)[self.indices]]
            for weights in (self.barycentric, self.barycentric[:, ::-1]):
                if are_at(np.einsum("nk,nkd->nd", weights, places)):
                    return replace(self, barycentric=weights)
        return replace(self, indices=None, barycentric=None)

    def to_csv(self) -> str:
        """Return one row per vertex, as in a file of landmarks: its number, the place of its partner, and the distance.

        The place is a face with the weights of its corners, a point, or without numbers a position. Numbers begin at 0.
        """
        places: Sequence[np.ndarray]
        if self.indices is None:
            names, places = ["target_x", "target_y", "target_z"], tuple(self.points.T)
        elif self.barycentric is None:
            names, places = ["target_vertex"], (self.indices,)
        else:
            names, places = ["target_face", "target_u", "target_v", "target_w"], (self.indices, *self.barycentric.T)
        columns = [[f"{number:.17g}" for number in column.tolist()] for column in (*places, self.distances)]
        rows = zip(map(str, range(len(self.points))), *columns, strict=True)
        return "\n".join(map(",".join, [("source_vertex", *names, "distance"), *rows])) + "\n"


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
    target = target.thinned(_CLOUD_POINTS) if isinstance(target, PointCloud) else target
    found = Correspondence.of(result, target)
    indices = found.indices
    assert indices is not None  # noqa: S101  they are the target's own
    diagonal = bounding_box_diagonal(target.verts)
    near, beside_rim = FAR * diagonal, _AT_RIM * diagonal
    if isinstance(target, PointCloud):
        spacing = float(np.sqrt(np.median(local_areas(target.verts))))
        near, beside_rim = max(near, _SPACINGS * spacing), max(beside_rim, spacing)
        partner = found.distances <= near
        rows = np.flatnonzero(partner & (found.distances > beside_rim))
        if len(rows):
            partner[rows] = ~is_at_rim(target.verts, indices[rows])
        return partner
    assert found.barycentric is not None  # noqa: S101  it is a mesh
    cosines = (unit_vectors(vert_area_vectors(result)) * face_normals(target)[indices]).sum(axis=1)
    boundary = (Topology.of(target).twin < 0).reshape(-1, 3)[indices]  # from corner k to the next
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
