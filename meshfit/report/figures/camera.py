"""Where a shape is best looked at from: the three-quarter view that shows most of it."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError
from meshfit.mesh.geometry import area_vectors, unit_vectors
from meshfit.mesh.mesh import Mesh, Verts

Vector = tuple[float, float, float]

_AZIMUTHS = range(-165, 181, 15)
_ELEVATIONS = (15, 30)
_POINTS = 30_000
_CELLS = 56
_BINS = 4
# How much more a shape has to show from its back than from its front, straight on than from three quarters, and from
# high above than from a little above.
_FRONT, _THREE_QUARTER, _LOW = 0.2, 0.2, 0.1


def three_quarter(mesh: Mesh) -> Vector:
    """The unit vector from a mesh, y up, towards the eye that sees most of it.

    Of two rings of directions the one is taken from which the outline is largest and the normals in sight are most
    various, with some preference for the front (towards +z), for three-quarter views, and for the lower ring.

    Args:
        mesh: with at least one face.
    """
    points, normals = _sights(mesh)
    views = [(elevation, azimuth) for elevation in _ELEVATIONS for azimuth in sorted(_AZIMUTHS, key=abs)]
    best = max(views, key=lambda view: round(_shown(points, normals, *view) * _preference(*view), 9))
    return _direction(*best)


def _sights(mesh: Mesh) -> tuple[Float64[np.ndarray, "N 3"], Float64[np.ndarray, "N 3"]]:
    """Points that cover the surface evenly, in a frame of their own, and its normals there."""
    vectors = area_vectors(mesh)
    areas = np.linalg.norm(vectors, axis=1)
    if not areas.sum() > 0:
        return np.zeros((1, 3)), np.zeros((1, 3))
    generator = np.random.default_rng(0)
    chosen = np.searchsorted(np.cumsum(areas) / areas.sum(), (np.arange(_POINTS) + 0.5) / _POINTS)
    chosen = np.minimum(chosen, mesh.num_faces - 1)
    weights = generator.dirichlet((1.0, 1.0, 1.0), size=_POINTS)
    points = np.einsum("nk,nkc->nc", weights, mesh.verts[mesh.faces[chosen]])
    points = points - (points.min(axis=0) + points.max(axis=0)) / 2
    return points / (float(np.linalg.norm(points, axis=1).max()) or 1.0), unit_vectors(vectors[chosen])


def _direction(elevation: int, azimuth: int) -> Vector:
    """Straight from the front is azimuth 0; from the mesh's left side, +x, is 90."""
    up, round_ = np.deg2rad(elevation), np.deg2rad(azimuth)
    return float(np.cos(up) * np.sin(round_)), float(np.sin(up)), float(np.cos(up) * np.cos(round_))


def _preference(elevation: int, azimuth: int) -> float:
    radians = np.deg2rad(azimuth)
    low = 1 + _LOW * (elevation == _ELEVATIONS[0])
    return float((1 + _FRONT * np.cos(radians)) * (1 + _THREE_QUARTER * abs(np.sin(2 * radians))) * low)


def _shown(
    points: Float64[np.ndarray, "N 3"], normals: Float64[np.ndarray, "N 3"], elevation: int, azimuth: int
) -> float:
    """The area of the outline, times one plus the entropy of the normals in sight."""
    away = np.asarray(_direction(elevation, azimuth))
    right = np.array([away[2], 0.0, -away[0]]) / np.hypot(away[0], away[2])
    axes = np.array([right, np.cross(away, right), away])
    seen = points @ axes.T
    cells = np.minimum(((seen[:, :2] + 1) / 2 * _CELLS).astype(np.int64), _CELLS - 1)
    nearest = np.full(_CELLS * _CELLS, -1, dtype=np.int64)
    order = np.argsort(seen[:, 2], kind="stable")
    nearest[(cells[:, 0] * _CELLS + cells[:, 1])[order]] = order
    front = nearest[nearest >= 0]
    turned = np.minimum(((normals[front] @ axes[:2].T + 1) / 2 * _BINS).astype(np.int64), _BINS - 1)
    share = np.bincount(turned[:, 0] * _BINS + turned[:, 1], minlength=_BINS**2) / len(front)
    entropy = -float((share[share > 0] * np.log(share[share > 0])).sum()) / np.log(_BINS**2)
    return float(len(front) * (1 + entropy))


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
