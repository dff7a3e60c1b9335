"""A vert seen from near by: the faces around it, from a side on which it is in sight."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int64

from meshfit.mesh.mesh import Mesh
from meshfit.report.camera import Camera, looking_from

_ZOOM = 7.0
_REACH = 1.6
_LEAST_FACES = 30
_FACING = 0.25
_STEEPEST = 0.95


@dataclass(frozen=True)
class CloseUp:
    """What there is to draw.

    Attributes:
        mesh: the faces near by.
        verts: indices of its verts in the whole mesh.
        camera: where from.
        hidden: whether the vert faces away from the camera that sees the whole mesh.
        view: from where it is seen, in words.
    """

    mesh: Mesh
    verts: Int64[np.ndarray, " N"]
    camera: Camera
    hidden: bool
    view: str


def close_up(mesh: Mesh, vert: int, camera: Camera) -> CloseUp:
    """Look at a vert of a mesh from near by.

    Faces that lie farther off are left out, so that none of them is in the way.

    Args:
        mesh: the whole.
        vert: index of the vert.
        camera: that the whole is seen with; turned only where the vert faces away from it.
    """
    point = mesh.verts[vert]
    scale = _scale(mesh, vert, camera)
    near = (np.linalg.norm(mesh.verts - point, axis=1) <= _REACH * scale)[mesh.faces].any(axis=1)
    verts, faces = np.unique(mesh.faces[near], return_inverse=True)
    away = _normal(mesh, vert)
    hidden = bool(away @ np.asarray(camera.direction) < _FACING)
    turned = looking_from(mesh, _level(away)) if hidden else camera
    focal = (float(point[0]), float(point[1]), float(point[2]))
    return CloseUp(
        mesh=Mesh(mesh.verts[verts], faces.reshape(-1, 3).astype(np.int64)),
        verts=verts.astype(np.int64),
        camera=replace(turned, focal=focal, scale=scale),
        hidden=hidden,
        view="seen from its own side, since it faces away" if hidden else "seen from the same side",
    )


def _scale(mesh: Mesh, vert: int, camera: Camera) -> float:
    """A seventh of the whole, or what it takes to have some faces in the picture."""
    middles = np.sort(np.linalg.norm(mesh.verts[mesh.faces].mean(axis=1) - mesh.verts[vert], axis=1))
    enough = float(middles[min(_LEAST_FACES, len(middles)) - 1])
    return max(camera.scale / _ZOOM, min(enough, camera.scale))


def _normal(mesh: Mesh, vert: int) -> np.ndarray:
    """The mean normal of the faces at a vert; straight at the eye of nobody where they have no area."""
    corners = mesh.verts[mesh.faces[(mesh.faces == vert).any(axis=1)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    length = float(np.linalg.norm(normal))
    return normal / length if length else np.array([0.0, 0.0, 1.0])


def _level(direction: np.ndarray) -> tuple[float, float, float]:
    """A direction made less steep, since a camera has to know what is up."""
    right, up, towards = (float(each) for each in direction)
    if abs(up) < _STEEPEST:
        return right, up, towards
    return right, up, towards + 0.4
