"""Outlines of a surface in images: where it turns away from the camera, in front of the background."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.ndimage import distance_transform_edt, maximum_filter

from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.images.camera import Camera
from meshfit.images.rasteriser import Raster, rasterise
from meshfit.images.silhouettes import Silhouette, mask_contour
from meshfit.images.views import Mask, View
from meshfit.mesh.geometry import face_areas, face_normals, unit_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import nearest_point_query

Vectors = Float64[np.ndarray, "_ 3"]
Pixels = Float64[np.ndarray, "_ 2"]
Values = Float64[np.ndarray, " _"]
Indices = Int64[np.ndarray, " _"]

# Pixels along the longest side of the raster that tells what a view sees.
_RASTER = 192
# Distance in pixels that a difference of normals by 1 counts for, where contours are matched.
_TURNED = 6.0
# Pixels of the raster beside the nearest point of its contour within which a point is on the outline.
_ALONG = 0.6
# Depth of a point of the outline behind that of so many pixels around it, in diagonals.
_BEHIND, _AROUND = 0.05, 5


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points of the surface, by their faces and barycentric coordinates, with their positions and pixels."""

    face: Indices
    corners: Vectors
    positions: Vectors
    pixels: Pixels

    def __getitem__(self, rows: Indices | Bool[np.ndarray, " _"]) -> "SurfacePoints":
        """Return some of the points."""
        return SurfacePoints(self.face[rows], self.corners[rows], self.positions[rows], self.pixels[rows])


@dataclass(frozen=True, eq=False)
class ImagedSurface:
    """A surface in double precision, with what all views need of it."""

    mesh: Mesh
    normals: Vectors
    face_normals: Vectors
    middles: Vectors
    edges: tuple[Indices, Indices, Indices]
    face_of_vert: tuple[Indices, Indices]
    shares: Values
    size: float

    @classmethod
    def of(cls, shape: Shape) -> "ImagedSurface":
        """Return a surface of a fit."""
        connectivity = shape.connectivity
        mesh, edges = connectivity.mesh(shape.verts), connectivity.edges
        areas = face_areas(mesh)
        shares = np.bincount(mesh.faces.reshape(-1), np.repeat(areas / 3, 3), minlength=mesh.num_verts) / areas.sum()
        return cls(
            mesh,
            shape.smooth_normals.cpu().double().numpy(),
            face_normals(mesh),
            mesh.verts[mesh.faces].mean(axis=1),
            (edges.tail.cpu().numpy(), edges.head.cpu().numpy(), edges.left.cpu().numpy()),
            (connectivity.face_of_vert[0].cpu().numpy(), connectivity.face_of_vert[1].cpu().numpy()),
            shares,
            float(np.linalg.norm(np.ptp(mesh.verts, axis=0))),
        )

    def verts(self, rows: Indices, camera: Camera) -> SurfacePoints:
        """Return some vertices as points."""
        face, corner = (values[rows] for values in self.face_of_vert)
        positions = self.mesh.verts[rows]
        return SurfacePoints(face, np.eye(3)[corner], positions, camera.project(positions)[0])


@dataclass(frozen=True, eq=False)
class ContourImage:
    """A view, with what is computed of it once.

    Attributes:
        view: the view.
        silhouette: of its mask.
        contour: maps rows of pixel and weighted normal to the nearest points of the contour.
        nearest: maps pixels to the nearest points of the contour.
        camera: the same camera with fewer pixels, for visibility.
        scale: number of its pixels per pixel.
    """

    view: View
    silhouette: Silhouette
    contour: Callable[[Float64[np.ndarray, "_ 4"]], Indices]
    nearest: Callable[[Pixels], Indices]
    camera: Camera
    scale: float

    @classmethod
    def of(cls, view: View) -> "ContourImage | None":
        """Return the image; None if its mask has no contour."""
        silhouette, full = Silhouette.of(view), view.camera
        if not len(silhouette.points):
            return None
        scale = min(1.0, _RASTER / max(full.width, full.height))
        sizes = (int(np.ceil(scale * full.width)), int(np.ceil(scale * full.height)))
        focal, centre = ((scale * pair[0], scale * pair[1]) for pair in (full.focal, full.centre))
        camera = Camera(full.kind, *sizes, focal, centre, full.pose)
        contour = nearest_point_query(oriented(silhouette.points, silhouette.normals))
        return cls(view, silhouette, contour, nearest_point_query(silhouette.points), camera, scale)

    def towards(self, points: Vectors) -> Vectors:
        """Return the unit directions from points to the camera."""
        camera = self.view.camera
        if camera.kind == "orthographic":
            return np.broadcast_to(-camera.forward, points.shape)
        return unit_vectors(camera.position - points)

    def uncovered(self, mesh: Mesh) -> float:
        """Return the greatest distance, in pixels of the raster, of a place in the mask from the mask of a mesh."""
        own = rasterise(mesh, self.camera).face >= 0
        depth = self.silhouette.distance_at(self.camera.pixel_centres() / self.scale).reshape(own.shape)
        inside = np.isfinite(depth) & (depth > 0)  # it is infinite beyond an image that cuts the object off
        return float(distance_transform_edt(~own)[inside].max(initial=0.0))

    def cell(self, pixels: Pixels) -> tuple[Indices, Indices]:
        """Return the row and column in the raster of places in pixels; at its border for those beyond."""
        cells = np.floor(pixels * self.scale).astype(np.int64)
        return np.clip(cells[:, 1], 0, self.camera.height - 1), np.clip(cells[:, 0], 0, self.camera.width - 1)


@dataclass(frozen=True, eq=False)
class Outline:
    """Points of the surface at the outline of its image.

    Attributes:
        points: where the normal, linear along edges, is perpendicular to the line of sight.
        directions: (N, 2) unit normals of the outline in the image, outwards.
    """

    points: SurfacePoints
    directions: Pixels

    @classmethod
    def of(cls, surface: ImagedSurface, image: ContourImage, raster: Raster, most: float) -> "Outline":
        """Return those on the contour of the surface's own mask, which are not hidden.

        Rims in front of other parts are farther inside it, and the contour of the mask is not theirs.

        Args:
            surface: the surface.
            image: the view.
            raster: the surface in the camera of the image.
            most: pixels of the raster from its contour within which a point is on it, apart from chords.
        """
        tail, head, left = surface.edges
        verts, camera = surface.mesh.verts, image.view.camera
        facing = np.einsum("nk,nk->n", surface.normals, image.towards(verts))
        crossed = np.flatnonzero((facing[tail] > 0) != (facing[head] > 0))
        tail, head, left = tail[crossed], head[crossed], left[crossed]
        share = (facing[tail] / (facing[tail] - facing[head]))[:, None]
        positions = verts[tail] * (1 - share) + verts[head] * share
        pixels, depth = camera.project(positions)
        deepest = maximum_filter(np.where(raster.face < 0, -np.inf, raster.depth), size=_AROUND)
        shown = depth <= deepest[image.cell(pixels)] + _BEHIND * surface.size
        ends = surface.normals[tail], surface.normals[head]
        # A chord of a smooth surface is as far below it as an eighth of its length times its turn.
        below = np.linalg.norm(verts[tail] - verts[head], axis=1) * np.linalg.norm(ends[0] - ends[1], axis=1) / 8
        slack = most + below / _pixel_width(image.camera, depth)
        shown &= _from_contour(raster.face >= 0, pixels * image.scale) < slack
        normals = ends[0] * (1 - share) + ends[1] * share
        across = (normals @ camera.pose[:3, :2]) * (1.0, -1.0)
        length = np.linalg.norm(across, axis=1)
        shown &= length > 0
        corners = np.zeros((len(crossed), 3))
        np.put_along_axis(corners, left[:, None] % 3, 1 - share, axis=1)
        np.put_along_axis(corners, (left[:, None] + 1) % 3, share, axis=1)
        points = SurfacePoints(left // 3, corners, positions, pixels)
        return cls(points[shown], across[shown] / length[shown, None])


def _pixel_width(camera: Camera, depth: Values) -> Values:
    """Return the width of a pixel at some depths."""
    return (depth if camera.kind == "pinhole" else np.ones_like(depth)) / min(camera.focal)


def _from_contour(mask: Mask, pixels: Pixels) -> Values:
    """Return the distances of places in pixels of a mask from the line through the nearest point of its contour."""
    points, normals = mask_contour(mask)
    if not len(points):
        return np.full(len(pixels), np.inf)
    nearest = nearest_point_query(points)(pixels)
    offset = pixels - points[nearest]
    across = np.abs(np.einsum("nk,nk->n", offset, normals[nearest]))
    return np.asarray(np.maximum(across, np.linalg.norm(offset, axis=1) - _ALONG))


def oriented(pixels: Pixels, normals: Pixels) -> Float64[np.ndarray, "_ 4"]:
    """Return places in the image and their normals as points, whose nearest ones face about the same way."""
    return np.column_stack([pixels, _TURNED * normals])
