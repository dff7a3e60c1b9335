"""Preparation of surfaces for distances by MeshLab: checks, and the split of obtuse faces."""

import numpy as np

from meshfit.errors import MeasureError
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh

# MeshLab holds distances in single precision, and squares them.
_LARGEST_COORDINATE = 1e15


def require_surface(mesh: Mesh, role: str) -> None:
    """Refuse a mesh that has no surface to measure.

    Args:
        mesh: the mesh.
        role: its name in the message, such as `result`.

    Raises:
        MeasureError: no faces, no area, a face with an index out of range, or a coordinate that is not finite or beyond
            1e15.
    """
    if not mesh.num_faces:
        raise MeasureError(f"the {role} has {mesh.num_verts} vertices and no faces: there is no surface to measure")
    outside = ((mesh.faces < 0) | (mesh.faces >= mesh.num_verts)).any(axis=1)
    if outside.any():
        bad = int(np.flatnonzero(outside)[0])
        allowed = f"vertices are numbered 0 to {mesh.num_verts - 1}"
        raise MeasureError(f"the {role}'s face {bad} is {mesh.faces[bad].tolist()}, but {allowed}")
    # A NaN makes MeshLab abort the whole process.
    usable = (np.abs(mesh.verts) <= _LARGEST_COORDINATE).all(axis=1)
    if not usable.all():
        bad = int(np.flatnonzero(~usable)[0])
        expected = f"expected finite coordinates up to {_LARGEST_COORDINATE:g}"
        raise MeasureError(f"the {role}: {expected}, got {mesh.verts[bad].tolist()} at vertex {bad}")
    if not face_areas(mesh).sum() > 0:
        raise MeasureError(f"the {role} has no area: all its faces ({mesh.num_faces}) are degenerate")


def split_obtuse_faces(mesh: Mesh) -> Mesh:
    """Split every obtuse face in two along the altitude from its obtuse corner.

    MeshLab takes the corner between two edges as the nearest point of a face to any point beyond both. At an obtuse
    corner this can be wrong, and the distance too large unless a neighbouring face gives the right one, as it does on
    most closed surfaces but not on open ones. Acute and right-angled faces are measured exactly. The T-junctions of the
    splits do not affect distances.

    Args:
        mesh: V vertices, F faces of which K are obtuse.

    Returns:
        V + K vertices and F + K faces.
    """
    corners = mesh.verts[mesh.faces]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (ahead * behind).sum(axis=2)
    obtuse = np.flatnonzero((cosine < 0).any(axis=1))
    turn = (cosine[obtuse].argmin(axis=1)[:, None] + np.arange(3)) % 3
    top, left, right = np.take_along_axis(mesh.faces[obtuse], turn, axis=1).T
    base = mesh.verts[right] - mesh.verts[left]
    along = ((mesh.verts[top] - mesh.verts[left]) * base).sum(axis=1) / (base**2).sum(axis=1)
    foot = mesh.num_verts + np.arange(len(obtuse))
    halves = (np.stack([top, left, foot], axis=1), np.stack([top, foot, right], axis=1))
    verts = np.concatenate([mesh.verts, mesh.verts[left] + along[:, None] * base])
    return Mesh(verts, np.concatenate([np.delete(mesh.faces, obtuse, axis=0), *halves]))
