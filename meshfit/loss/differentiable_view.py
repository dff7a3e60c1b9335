"""Silhouette, depth and normals of a mesh in the view of a camera, differentiable in its vertices.

An exact rasteriser says which face is seen at each pixel. Depth and normals are those of that face, on the ray through
the pixel's centre. The silhouette is softened as in Liu, Li, Chen and Li 2019, Soft Rasterizer: the coverage of a pixel
is sigmoid(d/σ), with d its signed distance from the outline. There, each face has an outline, and a product over faces
joins them, so that the image of a mesh of small faces swells. Here, the outline is that of the whole mesh: the edges
between faces that look towards the camera and away from it, as far as nothing lies behind them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from meshfit.images.camera import Camera
from meshfit.images.rasteriser import Raster, rasterise
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology

REACH = 6.0
"""Distance from the outline, in units of the blur, beyond which a pixel is wholly covered, or not at all."""
# Longest piece of an edge that is wholly part of the outline or not, and how far beyond it is looked for the mesh.
_PIECE, _BESIDE = 2.0, 0.75
_MOST_PIECES = 256
# Faces seen at a flatter angle, whose depth changes by more than this many times for a move, tell no depth.
_LEAST_COSINE = 0.1
_NEAR = 1e-6


@dataclass(frozen=True, eq=False)
class ViewCamera:
    """A camera with its tensors.

    Attributes:
        camera: the camera.
        rotation: (3, 3) from world to camera axes, as rows.
        position: (3,) of the camera.
        focal: (2,) focal lengths in pixels; the second is negative, as rows count downwards.
        centre: (2,) principal point in pixels.
    """

    camera: Camera
    rotation: Float[Tensor, "3 3"]
    position: Float[Tensor, "3"]
    focal: Float[Tensor, "2"]
    centre: Float[Tensor, "2"]

    @classmethod
    def of(cls, camera: Camera, dtype: torch.dtype, device: torch.device) -> "ViewCamera":
        """Return a camera with its tensors."""
        options: dict[str, Any] = {"dtype": dtype, "device": device}
        fx, fy = camera.focal
        return cls(
            camera=camera,
            rotation=torch.tensor(camera.pose[:3, :3].T.copy(), **options),
            position=torch.tensor(camera.position.copy(), **options),
            focal=torch.tensor([fx, -fy], **options),
            centre=torch.tensor(camera.centre, **options),
        )

    def project(self, verts: Float[Tensor, "N 3"]) -> Float[Tensor, "N 2"]:
        """Return pixels; those of points behind a pinhole camera mean nothing."""
        local = (verts - self.position) @ self.rotation.T
        plane = local[:, :2]
        if self.camera.kind == "pinhole":
            plane = plane / (-local[:, 2:]).clamp_min(_NEAR)
        return plane * self.focal + self.centre

    def rays(self, pixels: Float[Tensor, "N 2"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"]]:
        """Return origins and directions of the lines of sight through pixels, with depth 1 per direction."""
        plane = (pixels - self.centre) / self.focal
        forward = (-self.rotation[2]).expand(len(pixels), 3)
        aside = plane @ self.rotation[:2]
        if self.camera.kind == "pinhole":
            return self.position.expand(len(pixels), 3), aside + forward
        return self.position + aside, forward


@dataclass(frozen=True, eq=False)
class SeenMesh:
    """A mesh as a camera sees it at one moment.

    Attributes:
        camera: the camera.
        verts: (V, 3) positions.
        faces: (F, 3) vertices of the faces.
        raster: the face at each pixel.
        topology: of the mesh.
    """

    camera: ViewCamera
    verts: Float[Tensor, "V 3"]
    faces: Int64[Tensor, "F 3"]
    raster: Raster
    topology: Topology

    @classmethod
    def of(cls, verts: Float[Tensor, "V 3"], mesh: Mesh, camera: ViewCamera) -> "SeenMesh":
        """Return a mesh as it is seen with other positions of its vertices.

        Args:
            verts: (V, 3) positions, in world coordinates.
            mesh: its faces; the positions do not matter.
            camera: the camera.
        """
        positions = verts.detach().cpu().double().numpy()
        raster = rasterise(Mesh(positions, mesh.faces), camera.camera)
        faces = torch.tensor(mesh.faces, device=verts.device)
        return cls(camera, verts, faces, raster, Topology.of(mesh))

    @property
    def covered(self) -> Bool[np.ndarray, "H W"]:
        """The pixels whose centres are covered."""
        return np.asarray(self.raster.face >= 0)

    def silhouette(self, blur: float) -> Float[Tensor, "H W"]:
        """Return the coverage of each pixel, 0 to 1: sigmoid(d/σ) near the outline, 0 or 1 elsewhere.

        Args:
            blur: σ, in pixels, above 0.
        """
        plane = self.camera.project(self.verts)
        pixel, tail, head, along = self._nearest_on_outline(plane.detach().cpu().double().numpy(), REACH * blur)
        covered = torch.from_numpy(self.covered.astype(np.float64)).to(plane)
        if not len(pixel):
            return covered
        at, device = self.covered.ravel()[pixel], plane.device
        rows, centres = torch.from_numpy(pixel).to(device), self._centres(pixel, plane)
        a, b = (plane.index_select(0, torch.from_numpy(verts).to(device)) for verts in (tail, head))
        nearest = a + torch.from_numpy(along).to(plane)[:, None] * (b - a)
        sign = torch.from_numpy(np.where(at, 1.0, -1.0)).to(plane)
        # That the nearest point also slides along its edge changes no distance.
        offset = centres - nearest
        direction = (offset / offset.norm(dim=1, keepdim=True).clamp_min(_NEAR)).detach()
        coverage = torch.sigmoid(sign * (offset * direction).sum(1) / blur)
        return covered.view(-1).index_copy(0, rows, coverage).view(covered.shape)

    def depth(self, pixels: Int64[np.ndarray, " N"]) -> Float[Tensor, " N"]:
        """Return the depth at some covered pixels, counted row by row."""
        corners, normals = self._seen_faces(pixels)
        origins, directions = self.camera.rays(self._centres(pixels, self.verts))
        across = (normals * directions).sum(1)
        least = _LEAST_COSINE * directions.norm(dim=1)
        across = torch.where(across.abs() < least, least, across)
        depth: Tensor = ((corners - origins) * normals).sum(1) / across
        return depth

    def is_frontal(self, pixels: Int64[np.ndarray, " N"]) -> Bool[Tensor, " N"]:
        """Return whether the faces at some covered pixels are seen steeply enough to tell a depth."""
        with torch.no_grad():
            _, normals = self._seen_faces(pixels)
            _, directions = self.camera.rays(self._centres(pixels, self.verts))
            steep: Tensor = (normals * directions).sum(1).abs() >= _LEAST_COSINE * directions.norm(dim=1)
        return steep

    def normals(self, pixels: Int64[np.ndarray, " N"]) -> Float[Tensor, "N 3"]:
        """Return the unit normals, in world axes, of the faces at some covered pixels."""
        return self._seen_faces(pixels)[1]

    def _seen_faces(self, pixels: Int64[np.ndarray, " N"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"]]:
        """Return a corner and the unit normal of the face at each pixel."""
        face = torch.from_numpy(self.raster.face.ravel()[pixels]).to(self.faces.device)
        a, b, c = (self.verts.index_select(0, corner) for corner in self.faces[face].unbind(1))
        cross = torch.linalg.cross(b - a, c - a)
        return a, cross / cross.norm(dim=1, keepdim=True).clamp_min(torch.finfo(cross.dtype).tiny)

    def _centres(self, pixels: Int64[np.ndarray, " N"], like: Tensor) -> Float[Tensor, "N 2"]:
        width = self.camera.camera.width
        return torch.from_numpy(np.column_stack([pixels % width, pixels // width]) + 0.5).to(like)

    def _nearest_on_outline(
        self, plane: Float64[np.ndarray, "V 2"], reach: float
    ) -> tuple[Int64[np.ndarray, " N"], Int64[np.ndarray, " N"], Int64[np.ndarray, " N"], Float64[np.ndarray, " N"]]:
        """Return pixels near the outline, and for each the ends of the nearest edge and the place on it, 0 to 1."""
        edges, start, stop = self._outline(plane)
        a, side = plane[edges[:, 0]], plane[edges[:, 1]] - plane[edges[:, 0]]
        ends = np.stack([a + start[:, None] * side, a + stop[:, None] * side])
        size = np.array([self.camera.camera.width, self.camera.camera.height])
        low = np.ceil(np.clip(ends.min(0) - reach - 0.5, 0, size)).astype(np.int64)
        high = np.floor(np.clip(ends.max(0) + reach - 0.5, -1, size - 1)).astype(np.int64)
        extent = np.maximum(high - low + 1, 0)
        counts = extent.prod(1)
        piece = np.repeat(np.arange(len(edges)), counts)
        within = np.arange(len(piece)) - np.repeat(counts.cumsum() - counts, counts)
        x, y = low[piece, 0] + within % extent[piece, 0], low[piece, 1] + within // extent[piece, 0]
        away = np.column_stack([x, y]) + 0.5 - a[piece]
        length = np.maximum((side**2).sum(1), np.finfo(float).tiny)[piece]
        along = np.clip((away * side[piece]).sum(1) / length, start[piece], stop[piece])
        squared = ((away - along[:, None] * side[piece]) ** 2).sum(1)
        near = squared <= reach**2
        pixel, piece, along, squared = (y * size[0] + x)[near], piece[near], along[near], squared[near]
        order = np.lexsort((piece, squared, pixel))
        first = order[np.flatnonzero(np.diff(pixel[order], prepend=-1))]
        return pixel[first], edges[piece[first], 0], edges[piece[first], 1], along[first]

    def _outline(
        self, plane: Float64[np.ndarray, "V 2"]
    ) -> tuple[Int64[np.ndarray, "N 2"], Float64[np.ndarray, " N"], Float64[np.ndarray, " N"]]:
        """Return pieces of edges beside which nothing is seen: the ends of the edge, and the part of it, 0 to 1."""
        edges, beside = self._contour(plane)
        tail, side = plane[edges[:, 0]], plane[edges[:, 1]] - plane[edges[:, 0]]
        length = np.linalg.norm(side, axis=1)
        counts = np.clip(np.ceil(length / _PIECE), 1, _MOST_PIECES).astype(np.int64)
        edge = np.repeat(np.arange(len(edges)), counts)
        place = np.arange(len(edge)) - np.repeat(counts.cumsum() - counts, counts)
        start, stop = place / counts[edge], (place + 1) / counts[edge]
        across = np.column_stack([-side[:, 1], side[:, 0]]) / np.maximum(length, _NEAR)[:, None]
        inwards = ((plane[beside] - tail) * across).sum(1)
        across = np.where(inwards[:, None] > 0, -across, across)
        middle = (tail[edge] + ((start + stop) / 2)[:, None] * side[edge]) + _BESIDE * across[edge]
        column, row = np.floor(middle).astype(np.int64).T
        height, width = self.raster.face.shape
        outside = (column < 0) | (column >= width) | (row < 0) | (row >= height)
        free = outside | ~self.covered[row.clip(0, height - 1), column.clip(0, width - 1)]
        return edges[edge[free]], start[free], stop[free]

    def _contour(self, plane: Float64[np.ndarray, "V 2"]) -> tuple[Int64[np.ndarray, "E 2"], Int64[np.ndarray, " E"]]:
        """Return the edges with all their faces on one side of them in the image, and a vertex on that side."""
        topology = self.topology
        count, edge, apex = topology.faces_per_edge, topology.edge_of, topology.apex
        tail, head = topology.edges[edge].T
        side, away = plane[head] - plane[tail], plane[apex] - plane[tail]
        is_left = side[:, 0] * away[:, 1] - side[:, 1] * away[:, 0] > 0
        left = np.bincount(edge, weights=is_left, minlength=len(count))
        beside = np.zeros(len(count), dtype=np.int64)
        beside[edge] = apex
        kept = np.flatnonzero(((left == 0) | (left == count)) & self._in_front(topology.edges))
        return topology.edges[kept], beside[kept]

    def _in_front(self, edges: Int64[np.ndarray, "E 2"]) -> Bool[np.ndarray, " E"]:
        camera = self.camera.camera
        if camera.kind != "pinhole":
            return np.ones(len(edges), dtype=bool)
        depth = -camera.to_camera(self.verts.detach().cpu().double().numpy())[:, 2]
        return np.asarray((depth[edges] > _NEAR).all(axis=1))
