"""Areas, normals, angles and sizes of a triangle mesh, in numpy float64."""

from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float64

from meshfit.mesh.mesh import Mesh, Verts

_SAME_SIZE = 1.5
_BLOCK = 1 << 20


def area_vectors(mesh: Mesh) -> Float64[np.ndarray, "F 3"]:
    """Return half the cross product of two edges of each face: its direction is the normal, its length the area."""
    a, b, c = (mesh.verts.take(mesh.faces[:, k], axis=0) for k in range(3))
    return np.asarray(0.5 * np.cross(b - a, c - a))


def vert_area_vectors(mesh: Mesh) -> Float64[np.ndarray, "V 3"]:
    """Return the sum of the area vectors of the faces at each vertex: its direction is the vertex normal."""
    vectors, total = area_vectors(mesh), np.zeros_like(mesh.verts)
    for k in range(3):
        np.add.at(total, mesh.faces[:, k], vectors)
    return total


def face_areas(mesh: Mesh) -> Float64[np.ndarray, " F"]:
    """Return the area of each face, read-only: it is kept as long as the mesh."""
    areas = _areas.get(mesh)
    if areas is None:
        areas = np.asarray(np.linalg.norm(area_vectors(mesh), axis=1))
        areas.setflags(write=False)
        _areas[mesh] = areas
    return areas


_areas = WeakKeyDictionary[Mesh, Float64[np.ndarray, " F"]]()


def unit_vectors(vectors: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 3"]:
    """Divide each row by its length; rows of length 0 stay 0."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0))


def signed_volume(mesh: Mesh) -> float:
    """Return the enclosed volume of a closed mesh; it is negative where normals point inwards."""
    # By the divergence theorem, the flux of the field (0, 0, z).
    x, y, z = (mesh.verts - mesh.verts.mean(axis=0)).T.copy()
    flux = np.empty(mesh.num_faces)
    for start in range(0, mesh.num_faces, _BLOCK):  # in blocks, as there may be many millions
        a, b, c = mesh.faces[start : start + _BLOCK].T
        area = (x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a])
        flux[start : start + _BLOCK] = area * (z[a] + z[b] + z[c])
    return float(flux.sum() / 6.0)


def face_normals(mesh: Mesh) -> Float64[np.ndarray, "F 3"]:
    """Return the unit normal of each face; 0 for a face without area."""
    return unit_vectors(area_vectors(mesh))


def corner_angles(mesh: Mesh) -> Float64[np.ndarray, "F 3"]:
    """Return the angle at each corner of each face, in radians; 0 where an adjacent edge has no length."""
    corners = mesh.verts[mesh.faces]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(ahead, behind), axis=2)
    return np.asarray(np.arctan2(sine, (ahead * behind).sum(axis=2)))


def bounding_box(verts: Verts) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Return the smallest and the largest coordinates."""
    return verts.min(axis=0), verts.max(axis=0)


def bounding_box_diagonal(verts: Verts) -> float:
    """Return the length of the diagonal of the axis-aligned bounding box."""
    low, high = bounding_box(verts)
    return float(np.linalg.norm(high - low))


def nearest_rotations(moments: Float64[np.ndarray, "N 3 3"]) -> Float64[np.ndarray, "N 3 3"]:
    """Return the rotations R that maximise Σ (R a) · b, given Σ a bᵀ (Kabsch 1976)."""
    left, _, right = np.linalg.svd(moments + 1e-14 * np.eye(3))
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(np.swapaxes(left @ right, 1, 2))


def is_size_kept(ratio: float) -> bool:
    """Return whether a ratio of two sizes is within 1.5 either way, as in the same unit."""
    return 1 / _SAME_SIZE <= ratio <= _SAME_SIZE
