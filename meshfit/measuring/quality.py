"""Mesh quality: self-intersecting, flipped and degenerate faces, angles, watertightness, components, Euler number."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from meshfit.measuring.surface import require_surface
from meshfit.mesh.geometry import bounding_box_diagonal, corner_angles, face_areas, face_normals
from meshfit.mesh.manifold import euler_number, num_components
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import self_intersecting_faces
from meshfit.mesh.topology import Topology

# In squared diagonals of the bounding box.
_DEGENERATE_AREA = 1e-12


@dataclass(frozen=True)
class Quality:
    """The quality of one mesh.

    Attributes:
        self_intersecting_faces: faces that cross another one, by MeshLab's test, which ignores coplanar overlaps.
        flipped_faces: see `flipped_faces`.
        degenerate_faces: see `degenerate_faces`.
        smallest_angle: of all corners of all faces, in degrees; at most 60.
        watertight: whether every edge has two faces of the same orientation.
        components: number of components connected by edges.
        euler_number: V - E + F over the vertices that faces use.
        verts: number of vertices.
        faces: number of faces.
    """

    self_intersecting_faces: int
    flipped_faces: int
    degenerate_faces: int
    smallest_angle: float
    watertight: bool
    components: int
    euler_number: int
    verts: int
    faces: int


def mesh_quality(mesh: Mesh, role: str = "mesh") -> Quality:
    """Measure the quality of a mesh.

    Args:
        mesh: the mesh.
        role: its name in errors, such as `result`.

    Raises:
        MeasureError: a mesh without a surface.
    """
    require_surface(mesh, role)
    topology = Topology.of(mesh)
    return Quality(
        self_intersecting_faces=int(self_intersecting_faces(mesh).sum()),
        flipped_faces=int(flipped_faces(mesh, topology).sum()),
        degenerate_faces=int(degenerate_faces(mesh).sum()),
        smallest_angle=smallest_angle(mesh),
        watertight=topology.is_watertight,
        components=num_components(topology),
        euler_number=euler_number(topology),
        verts=mesh.num_verts,
        faces=mesh.num_faces,
    )


def flipped_faces(mesh: Mesh, topology: Topology) -> Bool[np.ndarray, " F"]:
    """Return (F,) which faces point away from their neighbours: n · (n₁ + n₂ + n₃) < 0, with their normals.

    A face that folds over, as when a vertex is pushed across the opposite edge, is flipped; the faces around it are
    not, and neither are those of a surface that is inside out as a whole. On coarse meshes a good face may be flagged:
    on a regular tetrahedron the sum is -n. The count is meant for meshes that are fine relative to their curvature.

    Args:
        mesh: the mesh.
        topology: of the same mesh.
    """
    normals = face_normals(mesh)
    first, second = topology.face_pairs.T // 3
    neighbours = np.zeros_like(normals)
    np.add.at(neighbours, first, normals[second])
    np.add.at(neighbours, second, normals[first])
    return np.asarray((normals * neighbours).sum(axis=1) < 0)


def degenerate_faces(mesh: Mesh) -> Bool[np.ndarray, " F"]:
    """Return (F,) which faces have an area of at most 1e-12 squared bounding-box diagonals."""
    return np.asarray(face_areas(mesh) <= _DEGENERATE_AREA * bounding_box_diagonal(mesh.verts) ** 2)


def smallest_angle(mesh: Mesh) -> float:
    """Return the smallest angle of all corners, in degrees; 0 where an edge has no length."""
    return math.degrees(corner_angles(mesh).min())
