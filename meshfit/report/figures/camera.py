"""Cameras in parallel projection: the best view of a mesh, framing, visibility of vertices, and close-ups."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float64

from meshfit.errors import ConfigError, MeshError
from meshfit.experiment.storage.plan_file import UpChoice
from meshfit.mesh.geometry import area_vectors, unit_vectors
from meshfit.mesh.mesh import Mesh, Verts

Vector = tuple[float, float, float]

Up = Literal["x", "y", "z"]
"""The axis that points up in a picture."""

_AXES: tuple[Up, ...] = ("x", "y", "z")
UP = (0.0, 1.0, 0.0)
MARGIN = 0.04
"""Free margin on each side of the framed meshes, as a share of half the picture."""

_LARGEST_ASPECT = 2.5
_SMALLEST = 1e-9

# Best view: candidate directions in degrees, points sampled on the surface, cells of the outline, bins of the normals.
_AZIMUTHS = range(-165, 181, 15)
_ELEVATIONS = (15, 30)
_POINTS = 30_000
_CELLS = 56
_BINS = 4
# Preference for the front over the back, three quarters over straight on, and the lower ring over the upper.
_FRONT, _THREE_QUARTER, _LOW = 0.2, 0.2, 0.1

# Guess of the axis that points up: a mesh stands on its base, the flat part of its lower end that faces down.
_BASE_SLAB, _FACING, _LEAST_BASE, _CLEARLY, _THIN = 0.02, 0.95, 0.02, 4.0, 0.05

# Named views: elevation and azimuth in degrees.
VIEWS = {
    "front": (0.0, 0.0),
    "back": (0.0, 180.0),
    "left": (0.0, 90.0),
    "right": (0.0, -90.0),
    "top": (89.9, 0.0),
    "bottom": (-89.9, 0.0),
}

# Visibility and close-ups.
_DEPTH_TOLERANCE = 0.01
_ZOOM = 7.0
_FEWEST_FACES = 30
_AROUND = 12
_HEIGHTS = (0.0, 0.6, -0.6, 2.0, -2.0)


@dataclass(frozen=True)
class Camera:
    """A view in parallel projection.

    Attributes:
        focal: point in the middle of the picture.
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
        """The unit vector that points right in the picture."""
        return _vector(np.cross(self.up, self.direction))

    def project(self, verts: Verts) -> Float64[np.ndarray, "V 3"]:
        """(V, 3) projected vertices: right, up and towards the eye from the middle, in units of `scale`."""
        return np.asarray((verts - self.focal) @ np.array([self.right, self.up, self.direction]).T / self.scale)

    def pixel(self, point: Float64[np.ndarray, "3"], size: tuple[int, int]) -> tuple[float, float]:
        """The place of a point in a picture of `size` (width, height): pixels from the left and from the top."""
        right, up, _ = self.project(point[None])[0] * min(size) / 2
        return size[0] / 2 + float(right), size[1] / 2 - float(up)

    def containing(self, *meshes: Mesh) -> "Camera":
        """The same view, zoomed out until these meshes fit within the margin too."""
        reach = max((float(np.abs(self.project(mesh.verts)[:, :2]).max(initial=0.0)) for mesh in meshes), default=0.0)
        return replace(self, scale=self.scale * max(1.0, reach / (1 - MARGIN)))

    def framing(self, *meshes: Mesh, aspect: float | None = None) -> tuple["Camera", float]:
        """The same view, framed tightly on these meshes.

        Args:
            meshes: at least one, with at least one vertex.
            aspect: width by height of the picture; by default that of the meshes, within limits.

        Returns:
            The camera, and width by height of its picture.
        """
        seen = np.concatenate([self.project(mesh.verts) for mesh in meshes])
        low, high = seen.min(axis=0), seen.max(axis=0)
        focal = np.asarray(self.focal) + self.scale * (low + high) / 2 @ np.array([self.right, self.up, self.direction])
        across, down = np.maximum((high - low)[:2] * self.scale / 2, _SMALLEST * self.scale)
        pad = MARGIN * max(across, down)
        if aspect is None:
            aspect = float(np.clip((across + pad) / (down + pad), 1 / _LARGEST_ASPECT, _LARGEST_ASPECT))
        height = max(down + pad, (across + pad) / aspect)
        return replace(self, focal=_vector(focal), scale=float(height * min(1.0, aspect))), aspect

    def centred_on(self, mesh: Mesh, aspect: float) -> "Camera":
        """The same view with a mesh in the middle, at the same scale unless the mesh is too large for it."""
        camera, _ = self.framing(mesh, aspect=aspect)
        return replace(camera, scale=max(camera.scale, self.scale))


def camera_of(mesh: Mesh, up: UpChoice = "auto", view: str = "best") -> Camera:
    """Return a view of a mesh upright, all of it in the picture.

    Args:
        mesh: usually the target, whose camera also serves for its sources and results.
        up: the axis that points up; `auto` guesses it.
        view: `best` for a three-quarter view, one of `VIEWS`, or `AZIMUTH,ELEVATION` in degrees.

    Raises:
        MeshError: the mesh has no faces.
        ConfigError: no such view.
    """
    if not mesh.num_faces:
        raise MeshError("a mesh without faces cannot be drawn")
    axis = guess_up(mesh) if up == "auto" else up
    standing = mesh if axis == "y" else Mesh(_stood_up(mesh.verts, axis), mesh.faces)
    direction = best_direction(standing) if view == "best" else _direction(*_angles(view))
    camera = camera_from(standing, direction)
    if axis == "y":
        return camera
    focal, direction, upright = (_laid_down(vector, axis) for vector in (camera.focal, camera.direction, camera.up))
    return replace(camera, focal=focal, direction=direction, up=upright)


def is_turned(mesh: Mesh, up: UpChoice) -> bool:
    """Return whether a mesh is drawn with z up because it seems to stand that way."""
    return up == "auto" and mesh.num_faces > 0 and guess_up(mesh) == "z"


def guess_up(mesh: Mesh) -> Up:
    """Guess the axis that points up: z where the mesh clearly stands on a flat base along z, and not along y; else y.

    Args:
        mesh: with at least one face.
    """
    extents = np.ptp(mesh.verts, axis=0)
    if not extents[2] > _THIN * extents.max():
        return "y"
    along_y, along_z = (_base(mesh, axis) for axis in (1, 2))
    return "z" if along_z > max(_LEAST_BASE, _CLEARLY * along_y) else "y"


def _base(mesh: Mesh, axis: int) -> float:
    """The share of the surface that faces down along an axis at its lower end."""
    vectors = area_vectors(mesh)
    areas = np.linalg.norm(vectors, axis=1)
    heights = mesh.verts[mesh.faces][:, :, axis].max(axis=1)
    low, high = float(mesh.verts[:, axis].min()), float(mesh.verts[:, axis].max())
    down = (vectors[:, axis] < -_FACING * areas) & (heights <= low + _BASE_SLAB * (high - low))
    return float(areas[down].sum() / (areas.sum() or 1.0))


def _angles(view: str) -> tuple[float, float]:
    """Elevation and azimuth of a view in degrees."""
    if view in VIEWS:
        return VIEWS[view]
    try:
        azimuth, elevation = map(float, view.split(","))
    except ValueError:
        azimuth, elevation = math.nan, math.nan
    if not (math.isfinite(azimuth) and abs(elevation) <= 90):
        known = ", ".join(("best", *VIEWS))
        raise ConfigError(f"view '{view}': expected {known}, or AZIMUTH,ELEVATION in degrees, such as 30,15")
    return max(-89.9, min(89.9, elevation)), azimuth


def _stood_up(verts: Verts, axis: Up) -> Verts:
    """Turn an axis to y."""
    x, y, z = verts.T
    return np.stack({"x": (-y, x, z), "y": (x, y, z), "z": (x, z, -y)}[axis], axis=1)


def _laid_down(vector: Vector, axis: Up) -> Vector:
    """Turn y back to an axis."""
    x, y, z = vector
    return {"x": (y, -x, z), "y": (x, y, z), "z": (x, -z, y)}[axis]


def camera_from(mesh: Mesh, direction: Vector, upright: Vector = UP) -> Camera:
    """Return the view of a whole mesh from a direction, which must not be straight up or down."""
    away = np.asarray(direction) / np.linalg.norm(direction)
    up = np.asarray(upright) - np.dot(upright, away) * away
    camera = Camera((0.0, 0.0, 0.0), _vector(away), _vector(up / np.linalg.norm(up)), 1.0)
    seen = camera.project(mesh.verts)
    low, high = seen.min(axis=0), seen.max(axis=0)
    focal = (low + high) / 2 @ np.array([camera.right, camera.up, camera.direction])
    smallest = _SMALLEST * max(1.0, float(np.abs(mesh.verts).max()))  # a mesh that is one point has no size of its own
    half = max(float((high - low)[:2].max()) / 2, smallest)
    return replace(camera, focal=_vector(focal), scale=half / (1 - MARGIN))


def _vector(array: Float64[np.ndarray, "3"]) -> Vector:
    return float(array[0]), float(array[1]), float(array[2])


def best_direction(mesh: Mesh) -> Vector:
    """Return the unit vector from a mesh, y up, towards the eye that sees most of it.

    Candidates lie on two rings. The best one has the largest outline and the most varied visible normals, with some
    preference for the front (towards +z), for three-quarter views, and for the lower ring.

    Args:
        mesh: with at least one face.
    """
    points, normals = _surface_samples(mesh)
    views = [(elevation, azimuth) for elevation in _ELEVATIONS for azimuth in sorted(_AZIMUTHS, key=abs)]
    best = max(views, key=lambda view: round(_visible_detail(points, normals, *view) * _preference(*view), 9))
    return _direction(*best)


def _surface_samples(mesh: Mesh) -> tuple[Float64[np.ndarray, "N 3"], Float64[np.ndarray, "N 3"]]:
    """Points spread evenly over the surface, scaled into the unit ball, and the normals there."""
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


def _direction(elevation: float, azimuth: float) -> Vector:
    """Azimuth 0 is straight from the front, +z; 90 is from the mesh's left side, +x."""
    up, round_ = np.deg2rad(elevation), np.deg2rad(azimuth)
    return float(np.cos(up) * np.sin(round_)), float(np.sin(up)), float(np.cos(up) * np.cos(round_))


def _preference(elevation: int, azimuth: int) -> float:
    radians = np.deg2rad(azimuth)
    low = 1 + _LOW * (elevation == _ELEVATIONS[0])
    return float((1 + _FRONT * np.cos(radians)) * (1 + _THREE_QUARTER * abs(np.sin(2 * radians))) * low)


def _visible_detail(
    points: Float64[np.ndarray, "N 3"], normals: Float64[np.ndarray, "N 3"], elevation: int, azimuth: int
) -> float:
    """The area of the outline, times one plus the entropy of the visible normals."""
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


def is_visible(mesh: Mesh, vert: int, camera: Camera) -> bool:
    """Return whether a vertex, given by its index, is not hidden by a face of its own mesh."""
    seen = camera.project(mesh.verts)
    point = seen[vert]
    corners = seen[mesh.faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    to = point - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    proper = area != 0
    area = np.where(proper, area, 1.0)
    u = (to[:, 0] * second[:, 1] - to[:, 1] * second[:, 0]) / area
    v = (first[:, 0] * to[:, 1] - first[:, 1] * to[:, 0]) / area
    covers = proper & (u >= 0) & (v >= 0) & (u + v <= 1)
    depth = corners[:, 0, 2] + u * first[:, 2] + v * second[:, 2]
    return not bool((covers & (depth > point[2] + _DEPTH_TOLERANCE)).any())


@dataclass(frozen=True)
class CloseUp:
    """A close view of a vertex.

    Attributes:
        camera: the camera.
        hidden: whether the vertex is hidden in the view of the whole mesh.
        view: the side it is seen from, in words.
    """

    camera: Camera
    hidden: bool
    view: str


def close_up(mesh: Mesh, vert: int, camera: Camera) -> CloseUp:
    """Zoom in on a vertex, given by its index, turning the camera only where the vertex would be hidden."""
    near = replace(camera, focal=_vector(mesh.verts[vert]), scale=_close_scale(mesh, vert, camera))
    if is_visible(mesh, vert, camera):
        return CloseUp(near, hidden=False, view="seen from the same side")
    turned = next((other for other in _turned(mesh, vert, near) if is_visible(mesh, vert, other)), None)
    if turned is None:
        return CloseUp(near, hidden=True, view="behind the faces shown here, from every side")
    return CloseUp(turned, hidden=True, view="seen from another side, since it is hidden from this one")


def _close_scale(mesh: Mesh, vert: int, camera: Camera) -> float:
    """A seventh of the whole, or more if that shows too few faces."""
    distances = np.sort(np.linalg.norm(mesh.verts[mesh.faces].mean(axis=1) - mesh.verts[vert], axis=1))
    enough = float(distances[min(_FEWEST_FACES, len(distances)) - 1])
    return max(camera.scale / _ZOOM, min(enough, camera.scale))


def _turned(mesh: Mesh, vert: int, near: Camera) -> Iterator[Camera]:
    """Cameras on rings around a vertex, those closest to its normal first."""
    normal = _vertex_normal(mesh, vert)
    angles = [2 * math.pi * step / _AROUND for step in range(_AROUND)]
    axis = _AXES[int(np.argmax(np.abs(near.up)))]
    upright = _laid_down(UP, axis)
    around = [(math.cos(a), height, math.sin(a)) for height in _HEIGHTS for a in angles]
    sides = [np.array(_laid_down(side, axis)) for side in around]
    for side in sorted(sides, key=lambda side: -float(normal @ side) / float(np.linalg.norm(side))):
        yield replace(camera_from(mesh, _vector(side), upright), focal=near.focal, scale=near.scale)


def _vertex_normal(mesh: Mesh, vert: int) -> Float64[np.ndarray, "3"]:
    """The area-weighted sum of the normals of the faces at a vertex."""
    corners = mesh.verts[mesh.faces[(mesh.faces == vert).any(axis=1)]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals.sum(axis=0))
