"""An exact z-buffer rasteriser in double precision, on the CPU."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.doors import no_type_check
from meshfit.errors import ViewError
from meshfit.images.camera import Camera
from meshfit.images.views import View
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.geometry import face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.printable import described

_Corners = Float64[np.ndarray, "N 3"]
# Rounding of projected corners, in pixels, and pairs of a face and a pixel that are looked at together.
_SLACK = 1e-6
_AT_ONCE = 1 << 19
_AMBIENT = 0.15


@dataclass(frozen=True)
class Raster:
    """The nearest face at the centre of each pixel.

    Attributes:
        face: (H, W) int64, index of the face; −1 where there is none.
        depth: (H, W) float64, distance along the axis of view; NaN where there is no face.
        corners: (H, W, 3) float64, barycentric coordinates in the face in space; NaN where there is no face.
    """

    face: Int64[np.ndarray, "H W"]
    depth: Float64[np.ndarray, "H W"]
    corners: Float64[np.ndarray, "H W 3"]


def rasterise(mesh: Mesh, camera: Camera) -> Raster:
    """Return what a camera sees of a mesh at each pixel centre.

    Both sides of a face are seen. Of faces at the same depth, as along an edge, the one of the lowest index is taken.
    A pixel centre on an edge belongs to both its faces, so that no gap opens between them. A pinhole camera sees what
    lies in front of it, also of faces that pass it; an orthographic one sees the whole line of sight.

    Args:
        mesh: in the camera's world coordinates.
        camera: pinhole or orthographic.
    """
    num_pixels = camera.width * camera.height
    # Corners as points of the image plane in homogeneous coordinates, with −1 or −depth as the third.
    local = camera.to_camera(mesh.verts)
    plane = local if camera.kind == "pinhole" else np.column_stack([local[:, :2], np.full(len(local), -1.0)])
    depths = -local[:, 2]
    faces, left, top, wide, high = _boxes(mesh, camera)
    starts = np.concatenate([[0], np.cumsum(wide * high)])
    edges = _edge_forms(mesh.faces[faces], plane)
    nearest = np.full(num_pixels, np.inf)
    pixels, found_depths, rows = [], [], []
    first = 0
    while first < len(faces):
        last = max(first + 1, int(np.searchsorted(starts, starts[first] + _AT_ONCE, side="right")) - 1)
        part = np.repeat(np.arange(first, last), (wide * high)[first:last])
        down, across = np.divmod(np.arange(starts[first], starts[last]) - starts[part], wide[part])
        x, y = left[part] + across, top[part] + down
        weights = _weights(edges, part, (x + 0.5, y + 0.5), camera)
        inside, weights = _normalised(weights)
        part, pixel = part[inside], (y * camera.width + x)[inside]
        depth = np.einsum("nk,nk->n", weights, depths[mesh.faces[faces[part]]])
        seen = depth > 0 if camera.kind == "pinhole" else np.ones(len(depth), dtype=bool)
        np.minimum.at(nearest, pixel[seen], depth[seen])
        near = seen & (depth == nearest[pixel])
        pixels.append(pixel[near])
        found_depths.append(depth[near])
        rows.append(np.column_stack([faces[part[near]], weights[near]]))
        first = last
    return _resolved(camera, nearest, pixels, found_depths, rows)


@no_type_check
def render_view(
    mesh: "MeshLike", camera: Camera, name: str = "view", *, depth: bool = True, normals: bool = True
) -> View:
    """Return the view of a mesh, with depth and the normals of its faces, which keep the orientation of the mesh.

    Args:
        mesh: in the camera's world coordinates, in any form that `as_mesh` takes.
        camera: pinhole or orthographic.
        name: of the view.
        depth: give depth too.
        normals: give normals too.

    Example:
        >>> import meshfit
        >>> (camera,) = meshfit.cameras_around("bone", 1, size=64)
        >>> meshfit.render_view("bone", camera)
        View('view', pinhole, 64 × 64, mask, depth, normals)

    Raises:
        MeshError: not a mesh or a camera.
    """
    if not isinstance(mesh, Mesh):
        mesh = as_mesh(mesh, triangles=True)
    if not isinstance(camera, Camera):
        raise ViewError(f"camera: expected a Camera, such as one of cameras_around, got {described(camera)}")
    if not isinstance(name, str) or not name:
        raise ViewError(f"name: expected a text, got {described(name)}")
    for key, value in (("depth", depth), ("normals", normals)):
        if not isinstance(value, bool):
            raise ViewError(f"{key}: expected True or False, got {described(value)}")
    raster = rasterise(mesh, camera)
    mask = raster.face >= 0
    normal_map = None
    if normals:
        normal_map = np.full((*mask.shape, 3), np.nan)
        normal_map[mask] = face_normals(mesh)[raster.face[mask]]
    return View(name, camera, mask, raster.depth if depth else None, normal_map)


def shading(view: View) -> Float64[np.ndarray, "H W"]:
    """Return the brightness of a view with normals, from 0 to 1, under a light at the camera; 0 outside its mask."""
    assert view.normals is not None  # noqa: S101  as it was rendered
    facing = np.abs(np.nan_to_num(view.normals) @ view.camera.forward)
    return np.asarray(np.where(view.mask, _AMBIENT + (1 - _AMBIENT) * facing, 0.0))


def _boxes(mesh: Mesh, camera: Camera) -> tuple[Int64[np.ndarray, " F"], ...]:
    """Return the faces whose box may hold pixel centres, and its first column and row, width and height."""
    pixels, depth = camera.project(mesh.verts)
    in_front = depth > 0 if camera.kind == "pinhole" else np.ones(len(depth), dtype=bool)
    size = np.array([camera.width, camera.height])
    corners = mesh.faces.T
    low = np.minimum(np.minimum(pixels[corners[0]], pixels[corners[1]]), pixels[corners[2]])
    high = np.maximum(np.maximum(pixels[corners[0]], pixels[corners[1]]), pixels[corners[2]])
    num_in_front = in_front[mesh.faces].sum(axis=1)
    # The image of a face that passes the camera's plane is not the triangle of its corners' images.
    passes = (num_in_front > 0) & (num_in_front < 3)
    low[passes], high[passes] = 0.0, size
    shown = num_in_front > 0
    low, high = np.where(shown[:, None], low, 1.0), np.where(shown[:, None], high, 0.0)
    first = np.ceil(np.clip(low - 0.5 - _SLACK, 0, size)).astype(np.int64)
    last = np.floor(np.clip(high - 0.5 + _SLACK, -1, size - 1)).astype(np.int64)
    extent = last - first + 1
    faces = np.flatnonzero((extent > 0).all(axis=1))
    return faces, first[faces, 0], first[faces, 1], extent[faces, 0], extent[faces, 1]


def _edge_forms(faces: Int64[np.ndarray, "F 3"], plane: _Corners) -> Float64[np.ndarray, "F 3 3"]:
    """Return for each corner the linear form of a line of sight that is 0 on the opposite edge.

    That of an edge in the other direction is its exact negative, so that two faces agree on their common edge.
    """
    forms = np.empty((len(faces), 3, 3))
    for k in range(3):
        tail, head = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        start = plane[np.minimum(tail, head)]
        offset = plane[np.maximum(tail, head)] - start
        forms[:, k] = np.cross(start, offset) * np.where(tail < head, 1.0, -1.0)[:, None]
    return forms


def _weights(
    edges: Float64[np.ndarray, "F 3 3"],
    part: Int64[np.ndarray, " N"],
    pixel: tuple[Float64[np.ndarray, " N"], Float64[np.ndarray, " N"]],
    camera: Camera,
) -> _Corners:
    """Return the value of each face's forms on the line of sight through a pixel."""
    x = (pixel[0] - camera.centre[0]) / camera.focal[0]
    y = (camera.centre[1] - pixel[1]) / camera.focal[1]
    forms = edges[part]
    return np.asarray(forms[:, :, 0] * x[:, None] + forms[:, :, 1] * y[:, None] - forms[:, :, 2])


def _normalised(weights: _Corners) -> tuple[Int64[np.ndarray, " M"], Float64[np.ndarray, "M 3"]]:
    """Return which weights are those of a point inside the face, and these with a sum of 1."""
    signs_agree = (weights >= 0).all(axis=1) | (weights <= 0).all(axis=1)
    total = weights.sum(axis=1)
    inside = np.flatnonzero(signs_agree & (total != 0))
    return inside, weights[inside] / total[inside, None]


def _resolved(
    camera: Camera,
    nearest: Float64[np.ndarray, " P"],
    pixels: list[Int64[np.ndarray, " _"]],
    depths: list[Float64[np.ndarray, " _"]],
    rows: list[Float64[np.ndarray, "_ 4"]],
) -> Raster:
    """Return the raster: at each pixel the face of the lowest index among those at the least depth."""
    size = (camera.height, camera.width)
    face, corners = np.full(len(nearest), -1, dtype=np.int64), np.full((len(nearest), 3), np.nan)
    if pixels:
        pixel, depth, row = np.concatenate(pixels), np.concatenate(depths), np.concatenate(rows)
        best = depth == nearest[pixel]
        pixel, row = pixel[best][::-1], row[best][::-1]
        # Faces come in the order of their indices, and of several values for one pixel the last one is kept.
        face[pixel], corners[pixel] = row[:, 0].astype(np.int64), row[:, 1:]
    depth_map = np.where(face >= 0, nearest, np.nan)
    return Raster(face.reshape(size), depth_map.reshape(size), corners.reshape(*size, 3))
