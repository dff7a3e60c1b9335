"""Cameras that are spread evenly over a sphere around an object."""

import math
from collections.abc import Sequence
from typing import get_args

import numpy as np
from jaxtyping import Float64

from meshfit.doors import no_type_check
from meshfit.errors import ViewError
from meshfit.images.camera import Camera
from meshfit.images.specs import CameraKind
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.printable import described, option_text, value_text
from meshfit.specs import suggest

Directions = Float64[np.ndarray, "_ 3"]

FIELD_OF_VIEW = 40.0
"""Angle of view of a pinhole camera across the shorter side of the image, in degrees."""

MARGIN = 0.05
"""Free margin on each side of the object, as a share of half the shorter side of the image."""

_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
# Azimuth of the first camera, and elevation of a single one, in degrees: three quarters from the front, from above.
_AZIMUTH, _ELEVATION = 30.0, 20.0
# Directions from which those far from all others are chosen.
_CANDIDATES = 2000


def sphere_directions(count: int) -> Directions:
    """Return unit vectors from the object to cameras, on a Fibonacci lattice around the y axis, no two opposite.

    Args:
        count: number of directions.
    """
    rows = np.arange(count)
    height = 1.0 - (2.0 * rows + 1.0) / count if count > 1 else np.array([math.sin(math.radians(_ELEVATION))])
    azimuth = math.radians(_AZIMUTH) + _GOLDEN * rows
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.sin(azimuth), height, radius * np.cos(azimuth)])


def directions_between(taken: Directions, count: int) -> Directions:
    """Return directions that are far from those taken, and from each other: each time the farthest of many.

    Args:
        taken: (N, 3) unit vectors.
        count: number of directions to choose.
    """
    candidates = sphere_directions(_CANDIDATES)
    nearness = (candidates @ taken.T).max(axis=1)
    chosen = []
    for _ in range(count):
        direction = candidates[int(nearness.argmin())]
        chosen.append(direction)
        nearness = np.maximum(nearness, candidates @ direction)
    return np.array(chosen).reshape(-1, 3)


@no_type_check
def cameras_around(
    shape: "MeshLike | Float64[np.ndarray, 'N 3']",
    count: int | Directions,
    size: int | tuple[int, int] = 256,
    *,
    kind: CameraKind = "pinhole",
    field_of_view: float = FIELD_OF_VIEW,
) -> list[Camera]:
    """Return cameras around an object that look at the centre of its box, as near as all of them see it whole.

    All have the same intrinsics and the same distance from that centre, and the y axis points up in their images.

    Args:
        shape: a mesh in any form that `as_mesh` takes, or (N, 3) points to be seen, such as the corners of a box.
        count: number of cameras, on a Fibonacci lattice, or the (N, 3) unit directions in which they are.
        size: of the images, or (width, height), in pixels.
        kind: of projection.
        field_of_view: angle of view of a pinhole camera across the shorter side, in degrees.

    Example:
        >>> import meshfit
        >>> meshfit.cameras_around("cube", 2, size=64)[1]
        Camera(pinhole, 64 × 64, at (0.5584, -1.49, -2.52))

    Raises:
        ViewError: no camera; points at one place alone; a value that is not allowed.
        MeshError: not a mesh.
    """
    points = _points(shape)
    directions = _directions(count)
    if kind not in get_args(CameraKind):
        raise ViewError(f"kind: got {option_text(kind)}; {suggest(str(kind), get_args(CameraKind))}")
    if not _is_number(field_of_view) or not 0 < field_of_view < 180:
        raise ViewError(f"field_of_view: expected an angle between 0 and 180 degrees, got {value_text(field_of_view)}")
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    if not 0 < radius < math.inf:
        raise ViewError("the object has no extent: all its points are at one place, so no camera can see it whole")
    width, height = _size(size)
    half = min(width, height) / 2
    tangent = math.tan(math.radians(field_of_view) / 2)
    rotations = [_looking(direction) for direction in directions]
    reach = (1.0 - MARGIN) * np.array([width / 2, height / 2])
    if kind == "orthographic":
        farthest = np.max([np.abs((points - centre) @ rotation[:, :2]).max(axis=0) for rotation in rotations], axis=0)
        focal = float((reach / np.maximum(farthest, 1e-9 * radius)).min())
        distance = 2.0 * radius
    else:
        focal = half / tangent
        distance = max(_least_distance((points - centre) @ rotation, focal, reach) for rotation in rotations)
    return [
        _camera(kind, (width, height), focal, rotation, centre + distance * rotation[:, 2]) for rotation in rotations
    ]


@no_type_check
def _points(shape: "MeshLike | Float64[np.ndarray, 'N 3']") -> Float64[np.ndarray, "N 3"]:
    if not isinstance(shape, np.ndarray):
        return shape.verts if isinstance(shape, Mesh) else as_mesh(shape).verts
    if shape.ndim != 2 or shape.shape[1] != 3 or not len(shape) or shape.dtype.kind not in "fiu":
        raise ViewError(f"shape: expected a mesh, or rows of three coordinates, got an array of shape {shape.shape}")
    return np.asarray(shape, dtype=np.float64)


@no_type_check
def _directions(count: int | Directions) -> Directions:
    if isinstance(count, int | np.integer) and not isinstance(count, bool) and count >= 1:
        return sphere_directions(int(count))
    if isinstance(count, np.ndarray) and count.ndim == 2 and count.shape[1] == 3 and count.dtype.kind == "f":
        lengths = np.linalg.norm(count, axis=1)
        if len(count) and np.isfinite(lengths).all() and lengths.all():
            return np.asarray(count / lengths[:, None])
    raise ViewError(f"count: expected a number of cameras, 1 or more, or rows of directions, got {described(count)}")


@no_type_check
def _size(size: int | tuple[int, int]) -> tuple[int, int]:
    pair = (size, size) if isinstance(size, int | np.integer) else size
    numbers = pair if isinstance(pair, tuple | list) and len(pair) == 2 else ()
    if numbers and all(isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1 for n in numbers):
        return int(numbers[0]), int(numbers[1])
    raise ViewError(f"size: expected pixels, such as 256 or (640, 480), got {described(size)}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _camera(
    kind: CameraKind,
    size: tuple[int, int],
    focal: float,
    rotation: Float64[np.ndarray, "3 3"],
    position: Float64[np.ndarray, "3"],
) -> Camera:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return Camera(kind, *size, (focal, focal), (size[0] / 2, size[1] / 2), pose)


def _looking(direction: Sequence[float] | Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Return the axes, as columns, of a camera in a direction from the object that looks back at it."""
    back = np.asarray(direction, dtype=np.float64)
    back = back / np.linalg.norm(back)
    up = np.array([0.0, 1.0, 0.0]) if abs(back[1]) < 1 - 1e-9 else np.array([0.0, 0.0, -1.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(back, right), back])


def _least_distance(local: Float64[np.ndarray, "N 3"], focal: float, reach: Float64[np.ndarray, "2"]) -> float:
    """Return from how far a camera sees points within its image, given in axes of the camera about its target."""
    return float((local[:, 2:] + np.abs(local[:, :2]) * focal / reach).max())
