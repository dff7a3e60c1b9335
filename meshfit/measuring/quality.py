"""How sound a mesh is: crossing, flipped and degenerate faces, angles, closedness, pieces, genus."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from meshfit.measuring.surface import require_surface
from meshfit.mesh.geometry import bounding_box_diagonal, corner_angles, face_areas, face_normals
from meshfit.mesh.manifold import euler_number, is_watertight, num_components
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import self_intersecting_faces
from meshfit.mesh.topology import Topology

# The smallest area that counts, in squared diagonals of the bounding box.
_DEGENERATE_AREA = 1e-12


@dataclass(frozen=True)
class Quality:
    """The soundness of one mesh.

    Attributes:
        self_intersecting_faces: faces that cross another one, by MeshLab's test, which lets coplanar overlaps pass.
        flipped_faces: see `flipped_faces`.
        degenerate_faces: see `degenerate_faces`.
        smallest_angle: of all corners of all faces, in degrees; at most 60.
        watertight: whether every edge has two faces of like orientation.
        components: pieces that hang together by edges.
        euler_number: V - E + F over the verts that faces use.
        verts: number of verts.
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
    """All figures of soundness of a mesh.

    Args:
        mesh: the mesh.
        role: what to call it in a refusal, such as `result`.

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
        watertight=is_watertight(topology),
        components=num_components(topology),
        euler_number=euler_number(topology),
        verts=mesh.num_verts,
        faces=mesh.num_faces,
    )


def flipped_faces(mesh: Mesh, topology: Topology) -> Bool[np.ndarray, " F"]:
    """(F,) which faces look away from their surroundings: n · (n₁ + n₂ + n₃) < 0, with the normals of edge-neighbours.

    A face that folds over, as when a vertex is pushed across its opposite edge, is flipped; those around it are not.
    Nor is a surface that is inside out as a whole. A sound face is flagged where all around it bends by more than a
    right angle, as on a regular tetrahedron, where the sum is -n: the figure is meant for meshes that are fine
    against their curvature.

    Args:
        mesh: the mesh.
        topology: of the same mesh.
    """
    normals = face_normals(mesh)
    one, other = topology.face_pairs.T // 3
    around = np.zeros_like(normals)
    np.add.at(around, one, normals[other])
    np.add.at(around, other, normals[one])
    return np.asarray((normals * around).sum(axis=1) < 0)


def degenerate_faces(mesh: Mesh) -> Bool[np.ndarray, " F"]:
    """(F,) which faces have an area of at most 1e-12 squared bounding-box diagonals; with a repeated vertex it is 0."""
    return np.asarray(face_areas(mesh) <= _DEGENERATE_AREA * bounding_box_diagonal(mesh.verts) ** 2)


def smallest_angle(mesh: Mesh) -> float:
    """The smallest angle of any corner of any face, in degrees; 0 where a face has an edge without length."""
    return math.degrees(corner_angles(mesh).min())
