"""Cameras: where a mesh is looked at from. A target's camera serves for every mesh that belongs to it."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.report.viewpoint import Vector, three_quarter

UP = (0.0, 1.0, 0.0)
MARGIN = 0.04
"""The share of half a picture that stays free on each side of what it frames."""

_LONGEST = 2.5
_SMALLEST = 1e-9


@dataclass(frozen=True)
class Camera:
    """A view in parallel projection.

    Attributes:
        focal: the point in the middle of the picture.
        direction: unit vector from there to the eye.
        up: unit vector, perpendicular to `direction`, that points up in the picture.
        scale: half the shorter side of the picture, in the unit of the mesh.
    """

    focal: Vector
    direction: Vector
    up: Vector
    scale: float

    @property
    def right(self) -> Vector:
        """The unit vector that points to the right in the picture."""
        return _vector(np.cross(self.up, self.direction))

    def project(self, verts: Verts) -> Float64[np.ndarray, "V 3"]:
        """(V, 3) where verts are seen: to the right, up, and towards the eye, from the middle, in units of `scale`."""
        return np.asarray((verts - self.focal) @ np.array([self.right, self.up, self.direction]).T / self.scale)

    def holding(self, *meshes: Mesh) -> "Camera":
        """The same view, drawn back so far that these meshes too are whole within the margin."""
        reach = max((float(np.abs(self.project(mesh.verts)[:, :2]).max(initial=0.0)) for mesh in meshes), default=0.0)
        return replace(self, scale=self.scale * max(1.0, reach / (1 - MARGIN)))

    def framing(self, *meshes: Mesh, aspect: float | None = None) -> tuple["Camera", float]:
        """The same view, of just these meshes.

        Args:
            meshes: at least one, with a vert.
            aspect: width by height of the picture; by default what the meshes fill, within reason.

        Returns:
            The camera, and width by height of its picture.
        """
        seen = np.concatenate([self.project(mesh.verts) for mesh in meshes])
        low, high = seen.min(axis=0), seen.max(axis=0)
        focal = np.asarray(self.focal) + self.scale * (low + high) / 2 @ np.array([self.right, self.up, self.direction])
        across, down = np.maximum((high - low)[:2] * self.scale / 2, _SMALLEST * self.scale)
        pad = MARGIN * max(across, down)
        if aspect is None:
            aspect = float(np.clip((across + pad) / (down + pad), 1 / _LONGEST, _LONGEST))
        height = max(down + pad, (across + pad) / aspect)
        return replace(self, focal=_vector(focal), scale=float(height * min(1.0, aspect))), aspect


def camera_of(mesh: Mesh) -> Camera:
    """A three-quarter view of a mesh, y up, a little from above, all of it in the picture.

    Args:
        mesh: the target, whose camera serves for its source and its results too.

    Raises:
        MeshError: there is nothing to see: no faces.
    """
    if not mesh.num_faces:
        raise MeshError("a mesh without faces cannot be drawn")
    return looking_from(mesh, three_quarter(mesh))


def looking_from(mesh: Mesh, direction: Vector) -> Camera:
    """The view of a mesh from a direction that is neither straight up nor straight down, all of it in the picture."""
    away = np.asarray(direction) / np.linalg.norm(direction)
    up = np.asarray(UP) - np.dot(UP, away) * away
    camera = Camera((0.0, 0.0, 0.0), _vector(away), _vector(up / np.linalg.norm(up)), 1.0)
    seen = camera.project(mesh.verts)
    low, high = seen.min(axis=0), seen.max(axis=0)
    focal = (low + high) / 2 @ np.array([camera.right, camera.up, camera.direction])
    smallest = _SMALLEST * max(1.0, float(np.abs(mesh.verts).max()))  # a mesh that is one point has no size of its own
    half = max(float((high - low)[:2].max()) / 2, smallest)
    return replace(camera, focal=_vector(focal), scale=half / (1 - MARGIN))


def _vector(array: Float64[np.ndarray, "3"]) -> Vector:
    return float(array[0]), float(array[1]), float(array[2])
