"""The visual hull: the largest shape that all masks allow, carved from a grid of voxels."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float64

from meshfit.errors import ViewError
from meshfit.images.camera import Camera
from meshfit.images.silhouettes import Silhouette
from meshfit.images.tunnels import without_narrow_tunnels
from meshfit.images.views import View, Views
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.pieces import piece_of_face
from meshfit.units import count_text

Box = Float64[np.ndarray, "2 3"]
Planes = tuple[Float64[np.ndarray, "_ 3"], Float64[np.ndarray, " _"]]
"""Normals a and offsets b of half-spaces a · x ≤ b."""

RESOLUTION = 128
"""Voxels along the longest side of the hull's box."""

# Voxels along each side of the grid that tells the box, and free voxels around the hull.
_COARSE, _FREE = 40, 2
# A box that is longer than so many times its shortest side is bounded by no mask in that direction.
_LONGEST = 20.0
# Pieces of fewer faces than this share of the largest are specks of the grid.
_SPECK = 0.005
# Pixels by which a mask may be off.
_HALF_PIXEL = 0.5
# Weight of the origin among the lines of sight, of which there may be one alone.
_ORIGIN = 1e-6


def visual_hull(
    views: Sequence[View], resolution: int = RESOLUTION, *, depth: tuple[float, float] | None = None
) -> Mesh:
    """Return the surface of all points that no mask excludes: closed, manifold, in world coordinates.

    Each voxel gets the least of its signed distances from the contours, in lengths of the world, and the surface of
    level 0 is extracted by marching cubes: it is as smooth as the contours, not as the voxels. What a view does not
    show, because the object is cut off by its image, is left to the others. Narrow tunnels that no mask shows by more
    than half a pixel are filled. Where no mask bounds the hull, as along the lines of sight of a single view, it is as
    deep as its mask is wide, about the point nearest to the world's origin.

    Args:
        views: of one object.
        resolution: number of voxels along the longest side of the hull's box.
        depth: least and greatest depth of the hull in each view; None for no bounds but those above.

    Raises:
        ViewError: a mask that is empty or full; masks that have no point in common; a hull thinner than a voxel.
    """
    for view in views:
        if view.mask.all() or not view.mask.any():
            state = "full, so that it shows no contour" if view.mask.any() else "empty"
            raise ViewError(f"view '{view.name}': its mask is {state}; leave the view out, or check its mask")
    silhouettes = [Silhouette.of(view) for view in views]
    box, planes = _box_of_hull(silhouettes, depth)
    coarse = [np.linspace(low, high, _COARSE) for low, high in box.T]
    diagonal = float(np.linalg.norm(np.ptp(box, axis=0)) / (_COARSE - 1))
    # A voxel next to a part that is thinner than a voxel is outside by less than a voxel's diagonal.
    near = np.argwhere(_carved(coarse, silhouettes, planes, diagonal) > -diagonal)
    if not len(near):
        raise _nothing_in_common(len(views))
    steps = np.ptp(box, axis=0) / (_COARSE - 1)
    box = np.stack([box[0] + (near.min(axis=0) - 1) * steps, box[0] + (near.max(axis=0) + 1) * steps])
    cell = float(np.ptp(box, axis=0).max()) / resolution
    counts = np.ceil(np.ptp(box, axis=0) / cell).astype(int)
    axes = [low + cell * np.arange(-_FREE, count + _FREE + 1) for low, count in zip(box[0], counts, strict=True)]
    values = _carved(axes, silhouettes, planes, 2 * cell)
    if not (values > 0).any():
        if (values > -cell).any():
            raise ViewError(f"the visual hull is thinner than a voxel at a resolution of {resolution}; raise it")
        raise _nothing_in_common(len(views))
    from meshfit.mesh.proximity import zero_surface  # brings libigl, which a plan does not need

    centre = box.mean(axis=0)
    tolerance = min(_HALF_PIXEL * _pixel_width(silhouette.camera, centre) for silhouette in silhouettes)
    return _without_specks(zero_surface(without_narrow_tunnels(values, tolerance, cell), axes))


@lru_cache(maxsize=2)  # a trial builds its source, describes it, and samples the hull
def hull_of(views: Views) -> Mesh:
    """Return the visual hull of views, carved once as long as they are the same object."""
    return visual_hull(views)


def _nothing_in_common(count: int) -> ViewError:
    return ViewError(
        f"the masks of the {count_text(count, 'view')} have no point in common, so there is no visual hull; "
        "check the cameras, or leave out views that are wrong"
    )


def _box_of_hull(silhouettes: Sequence[Silhouette], depth: tuple[float, float] | None) -> tuple[Box, Planes]:
    """Return the box of all points that project into the boxes of all masks, and the planes that bound depth."""
    sides = _joined([_sides(silhouette) for silhouette in silhouettes])
    slabs = _joined([])
    if depth is not None:
        slabs = _joined([_slab(silhouette.camera, *depth) for silhouette in silhouettes])
    box = _box_of(_joined([sides, slabs]), len(silhouettes))
    extent = np.ptp(box, axis=0)
    if np.isfinite(extent).all() and extent.max() <= _LONGEST * extent.min():
        return box, slabs
    centre = _nearest_to_lines(silhouettes)
    bounds = [_usual_slab(silhouette, centre) for silhouette in silhouettes]
    slabs = _joined([slabs, *bounds])
    return _box_of(_joined([sides, slabs]), len(silhouettes)), slabs


def _box_of(planes: Planes, count: int) -> Box:
    """Return the bounding box of an intersection of half-spaces, infinite where it has no bound."""
    from scipy.optimize import linprog

    box = np.empty((2, 3))
    for axis, (row, sign) in ((axis, side) for axis in range(3) for side in ((0, 1.0), (1, -1.0))):
        goal = np.zeros(3)
        goal[axis] = sign
        found: Any = linprog(goal, A_ub=planes[0], b_ub=planes[1], bounds=[(None, None)] * 3)
        if found.status == 2:
            raise _nothing_in_common(count)
        box[row, axis] = sign * found.fun if found.status == 0 else -sign * np.inf
    return box


def _sides(silhouette: Silhouette) -> Planes:
    """Return the planes through the sides of a mask's box, without those at which the image cuts it off."""
    camera, rows, columns = silhouette.camera, *np.nonzero(silhouette.distance > 0)
    left, right, top, bottom = columns.min(), columns.max() + 1, rows.min(), rows.max() + 1
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]], dtype=np.float64)
    origins, directions = camera.rays(corners)
    following = np.roll(directions if camera.kind == "pinhole" else origins, -1, axis=0)
    along = following if camera.kind == "pinhole" else following - origins
    # Counter-clockwise as the y axis of pixels points down, these point inwards.
    normals = np.cross(along, directions)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    middle = origins.mean(axis=0) + directions.sum(axis=0)
    offsets = np.einsum("nk,nk->n", normals, origins)
    flipped = np.sign(normals @ middle - offsets)
    normals, offsets = normals * flipped[:, None], offsets * flipped
    shown = np.array([top > 0, right < camera.width, bottom < camera.height, left > 0])
    normals, offsets = -normals[shown], -offsets[shown]
    if camera.kind == "pinhole":
        normals = np.vstack([normals, -camera.forward])
        offsets = np.append(offsets, -camera.forward @ camera.position)
    return normals, offsets


def _slab(camera: Camera, least: float, greatest: float) -> Planes:
    """Return the planes of least and greatest depth."""
    at = float(camera.forward @ camera.position)
    return np.stack([-camera.forward, camera.forward]), np.array([-least - at, greatest + at])


def _usual_slab(silhouette: Silhouette, centre: Float64[np.ndarray, "3"]) -> Planes:
    """Return planes about a centre, as far from each other as the mask is wide there."""
    camera = silhouette.camera
    depth = float(camera.project(centre[None])[1][0])
    if camera.kind == "pinhole" and not depth > 0:
        raise ViewError(
            "no mask bounds the depth of the visual hull, and the origin is behind a camera; bound it by depth"
        )
    rows, columns = np.nonzero(silhouette.distance > 0)
    extent = np.sqrt(np.ptp(rows) * np.ptp(columns) + 1.0)
    half = extent / 2 / float(np.mean(camera.focal)) * (depth if camera.kind == "pinhole" else 1.0)
    return _slab(camera, depth - half, depth + half)


def _nearest_to_lines(silhouettes: Sequence[Silhouette]) -> Float64[np.ndarray, "3"]:
    """Return the point nearest to the lines of sight through the middles of all masks, and in doubt to the origin."""
    total, right = _ORIGIN * np.eye(3), np.zeros(3)
    for silhouette in silhouettes:
        rows, columns = np.nonzero(silhouette.distance > 0)
        origin, direction = (
            array[0] for array in silhouette.camera.rays(np.array([[columns.mean() + 0.5, rows.mean() + 0.5]]))
        )
        across = np.eye(3) - np.outer(direction, direction)
        total, right = total + across, right + across @ origin
    return np.linalg.solve(total, right)


def _joined(planes: Sequence[Planes]) -> Planes:
    if not planes:
        return np.empty((0, 3)), np.empty(0)
    return np.concatenate([normals for normals, _ in planes]), np.concatenate([offsets for _, offsets in planes])


def _carved(
    axes: Sequence[Float64[np.ndarray, " _"]], silhouettes: Sequence[Silhouette], planes: Planes, band: float
) -> Float64[np.ndarray, "X Y Z"]:
    """Return the least signed distance at each voxel, positive inside, exact above minus the band."""
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    values = np.full(len(points), np.inf)
    for normal, offset in zip(*planes, strict=True):
        values = np.minimum(values, offset - points @ normal)
    # What one view has carved away needs no other.
    left = np.flatnonzero(values > -band)
    for silhouette in silhouettes:
        values[left] = np.minimum(values[left], _world_distance(silhouette, points[left]))
        left = left[values[left] > -band]
    values = np.minimum(values, np.finfo(np.float64).max)
    return np.asarray(values.reshape([len(axis) for axis in axes]))


def _world_distance(silhouette: Silhouette, points: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, " N"]:
    """Return the signed distance of points from the contour, in lengths of the world at their depth."""
    camera = silhouette.camera
    pixels, depth = camera.project(points)
    scale = np.mean(camera.focal)
    if camera.kind == "orthographic":
        return np.asarray(silhouette.distance_at(pixels) / scale)
    in_front = depth > 0
    distance = silhouette.distance_at(np.where(in_front[:, None], pixels, 0.0)) * (depth / scale)
    return np.asarray(np.where(in_front, distance, depth - np.linalg.norm(points - camera.position, axis=1)))


def _pixel_width(camera: Camera, point: Float64[np.ndarray, "3"]) -> float:
    """Return the width of a pixel of a camera at a point."""
    depth = float(camera.project(point[None])[1][0])
    return (abs(depth) if camera.kind == "pinhole" else 1.0) / float(np.mean(camera.focal))


def _without_specks(mesh: Mesh) -> Mesh:
    """Return the pieces that are more than specks, without the vertices of the others."""
    count, piece = piece_of_face(mesh)
    sizes = np.bincount(piece, minlength=count)
    kept = sizes[piece] >= _SPECK * sizes.max()
    if kept.all():
        return mesh
    used = np.unique(mesh.faces[kept])
    number = np.full(mesh.num_verts, -1)
    number[used] = np.arange(len(used))
    return Mesh(mesh.verts[used], number[mesh.faces[kept]])
