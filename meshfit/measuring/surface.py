"""What a surface needs before distances to it can be trusted: real coordinates, an area, and no obtuse corners."""

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
        role: what to call it in the message, such as `result`.

    Raises:
        MeasureError: no faces, no area, a face that indexes outside, or a coordinate that is not finite or beyond 1e15.
    """
    if not mesh.num_faces:
        raise MeasureError(f"the {role} has {mesh.num_verts} verts and no faces: there is no surface to measure")
    outside = ((mesh.faces < 0) | (mesh.faces >= mesh.num_verts)).any(axis=1)
    if outside.any():
        bad = int(np.flatnonzero(outside)[0])
        allowed = f"verts are numbered 0 to {mesh.num_verts - 1}"
        raise MeasureError(f"the {role}'s face {bad} is {mesh.faces[bad].tolist()}, but {allowed}")
    # MeshLab aborts the whole process when it meets a NaN, so none may reach it.
    usable = (np.abs(mesh.verts) <= _LARGEST_COORDINATE).all(axis=1)
    if not usable.all():
        bad = int(np.flatnonzero(~usable)[0])
        allowed = f"a finite number of at most {_LARGEST_COORDINATE:g} is needed"
        raise MeasureError(f"the {role}'s vertex {bad} is {mesh.verts[bad].tolist()}: {allowed}")
    if not face_areas(mesh).sum() > 0:
        raise MeasureError(f"the {role} has no area: all its faces ({mesh.num_faces}) are degenerate")


def split_obtuse_faces(mesh: Mesh) -> Mesh:
    """The same surface with every obtuse face cut in two along the altitude from its obtuse corner.

    MeshLab takes the corner between two edges for the nearest point of a face to whatever lies beyond both. At an
    obtuse corner that need not be so, and the distance found is too large unless a neighbouring face puts it right,
    which it does on most closed surfaces and not on open ones. Acute and right-angled faces are measured exactly.
    The cuts leave T-junctions, which distances do not notice.

    Args:
        mesh: V verts, F faces of which K are obtuse.

    Returns:
        V + K verts and F + K faces.
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
