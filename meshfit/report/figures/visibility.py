"""What is in sight: whether a point of a mesh is hidden by the mesh itself."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from meshfit.mesh.mesh import Mesh
from meshfit.report.figures.camera import Camera, looking_from

_NEARER = 0.01


def in_sight(mesh: Mesh, vert: int, camera: Camera) -> bool:
    """Whether no face lies before a vert, as seen from a camera.

    Args:
        mesh: the mesh.
        vert: index of the vert.
        camera: where from.
    """
    seen = camera.project(mesh.verts)
    point = seen[vert]
    corners = seen[mesh.faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    to = point - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    some = area != 0
    area = np.where(some, area, 1.0)
    u = (to[:, 0] * second[:, 1] - to[:, 1] * second[:, 0]) / area
    v = (first[:, 0] * to[:, 1] - first[:, 1] * to[:, 0]) / area
    covers = some & (u >= 0) & (v >= 0) & (u + v <= 1)
    depth = corners[:, 0, 2] + u * first[:, 2] + v * second[:, 2]
    return not bool((covers & (depth > point[2] + _NEARER)).any())


_ZOOM = 7.0
_LEAST_FACES = 30
_AROUND = 12
_HEIGHTS = (0.0, 0.6, -0.6, 2.0, -2.0)


@dataclass(frozen=True)
class CloseUp:
    """How to look at a vert from near by.

    Attributes:
        camera: where from.
        hidden: whether the vert is behind something as the whole is seen.
        view: from where it is seen, in words.
    """

    camera: Camera
    hidden: bool
    view: str


def close_up(mesh: Mesh, vert: int, camera: Camera) -> CloseUp:
    """Look at a vert of a mesh from near by.

    Args:
        mesh: the mesh.
        vert: index of the vert.
        camera: that the whole is seen with; turned only where the vert is hidden from it.
    """
    point = mesh.verts[vert]
    focal = (float(point[0]), float(point[1]), float(point[2]))
    near = replace(camera, focal=focal, scale=_scale(mesh, vert, camera))
    if in_sight(mesh, vert, camera):
        return CloseUp(near, hidden=False, view="seen from the same side")
    turned = next((each for each in _turned(mesh, vert, near) if in_sight(mesh, vert, each)), None)
    if turned is None:
        return CloseUp(near, hidden=True, view="behind the faces that are seen here, from every side")
    return CloseUp(turned, hidden=True, view="seen from another side, since it is hidden from this one")


def _scale(mesh: Mesh, vert: int, camera: Camera) -> float:
    """A seventh of the whole, or what it takes to have some faces in the picture."""
    middles = np.sort(np.linalg.norm(mesh.verts[mesh.faces].mean(axis=1) - mesh.verts[vert], axis=1))
    enough = float(middles[min(_LEAST_FACES, len(middles)) - 1])
    return max(camera.scale / _ZOOM, min(enough, camera.scale))


def _turned(mesh: Mesh, vert: int, near: Camera) -> Iterator[Camera]:
    """Cameras on rings around a vert, those first that see it from straight before it."""
    normal = _normal(mesh, vert)
    angles = [2 * math.pi * step / _AROUND for step in range(_AROUND)]
    sides = [np.array([math.cos(a), height, math.sin(a)]) for height in _HEIGHTS for a in angles]
    for side in sorted(sides, key=lambda side: -float(normal @ side) / float(np.linalg.norm(side))):
        right, up, towards = map(float, side)
        yield replace(looking_from(mesh, (right, up, towards)), focal=near.focal, scale=near.scale)


def _normal(mesh: Mesh, vert: int) -> Float64[np.ndarray, "3"]:
    """The sum of the normals of the faces at a vert, the larger ones counting more."""
    corners = mesh.verts[mesh.faces[(mesh.faces == vert).any(axis=1)]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals.sum(axis=0))
