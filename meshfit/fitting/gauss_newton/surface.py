"""A moving surface: its connectivity, which is the same at every step, and its current shape."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from scipy.sparse import coo_array
from torch import Tensor

from meshfit.loss.sparse import Sparse
from meshfit.mesh.manifold import graph_components
from meshfit.mesh.mesh import Mesh
from meshfit.remeshing.connectivity import Edges
from meshfit.remeshing.triangle_geometry import double_area_vectors, length_of, unit


@dataclass(frozen=True, eq=False)
class Connectivity:
    """The faces of a surface, and the quantities that depend on them alone.

    Attributes:
        faces: (F, 3) vertex indices, counter-clockwise seen from outside.
        num_verts: V.
        dtype: precision of its operators.
        crossing: whether its pieces may cross each other, as those of the target do.
    """

    faces: Int64[Tensor, "F 3"]
    num_verts: int
    dtype: torch.dtype
    crossing: bool = False

    @cached_property
    def pieces(self) -> tuple[int, Int64[np.ndarray, " V"]]:
        """The number of pieces, and the piece of each vertex."""
        faces = self.faces.cpu().numpy()
        ends = np.concatenate([faces[:, 0], faces[:, 1]]), np.concatenate([faces[:, 1], faces[:, 2]])
        return graph_components(*ends, self.num_verts)

    @cached_property
    def cells(self) -> Float[Tensor, "V 3"]:
        """The cell of a cubic grid for each vertex, one for each piece."""
        count, piece = self.pieces
        side = math.ceil(count ** (1 / 3))
        cell = np.stack([piece % side, piece // side % side, piece // side**2], axis=1) - (side - 1) / 2
        return torch.tensor(cell, dtype=self.dtype, device=self.faces.device)

    def apart(self, verts: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """Return positions at which no piece crosses another, if they may cross; each piece keeps its shape."""
        if not self.crossing:
            return verts
        size = 1.1 * (verts.amax(0) - verts.amin(0)).max()
        return verts + size * self.cells

    @cached_property
    def edges(self) -> Edges:
        """Edges of the faces."""
        return Edges.of(self.faces, self.num_verts)

    @cached_property
    def ends(self) -> Int64[Tensor, "2 E"]:
        """The two ends of each edge."""
        return torch.stack([self.edges.tail, self.edges.head])

    @cached_property
    def face_of_vert(self) -> tuple[Int64[Tensor, " V"], Int64[Tensor, " V"]]:
        """One face of each vertex, and the corner of the face that the vertex is."""
        face = torch.zeros(self.num_verts, dtype=torch.int64, device=self.faces.device)
        corner = torch.zeros_like(face)
        for k in range(3):
            face[self.faces[:, k]] = torch.arange(len(self.faces), device=face.device)
        for k in range(3):
            corner[self.faces[face, k] == torch.arange(self.num_verts, device=face.device)] = k
        return face, corner

    @cached_property
    def umbrella(self) -> Sparse:
        """Uniform Laplacian: maps values to their difference from the mean of the neighbours."""
        n, (tail, head) = self.num_verts, (ends.cpu().numpy() for ends in self.ends)
        valence = self.edges.valence.cpu().double().numpy()
        share = 1 / valence.clip(min=1)
        rows, columns = np.concatenate([np.arange(n), tail, head]), np.concatenate([np.arange(n), head, tail])
        values = np.concatenate([valence.clip(max=1), -share[tail], -share[head]])
        return Sparse.of(coo_array((values, (rows, columns)), shape=(n, n)), self.dtype, self.faces.device)

    def at_verts(self, per_face: Float[Tensor, "F N"]) -> Float[Tensor, "V N"]:
        """Sum values of faces at each of their vertices."""
        total = per_face.new_zeros(self.num_verts, per_face.shape[1])
        for k in range(3):
            total.index_add_(0, self.faces[:, k], per_face)
        return total

    def neighbour_mean(self, values: Float[Tensor, "V N"]) -> Float[Tensor, "V N"]:
        """Return the mean over the neighbours of each vertex."""
        tail, head = self.ends
        total = torch.zeros_like(values).index_add_(0, tail, values[head]).index_add_(0, head, values[tail])
        return total / self.edges.valence.clamp_min(1)[:, None]

    def verts_of(self, faces: Bool[Tensor, " F"]) -> Bool[Tensor, " V"]:
        """Return the vertices of some faces."""
        mask = torch.zeros(self.num_verts, dtype=torch.bool, device=faces.device)
        mask[self.faces[faces].reshape(-1)] = True
        return mask

    def grown(self, verts: Bool[Tensor, " V"]) -> Bool[Tensor, " V"]:
        """Return some vertices and their neighbours."""
        tail, head = self.ends
        mask = verts.clone()
        mask[tail[verts[head]]] = True
        mask[head[verts[tail]]] = True
        return mask

    def mesh(self, verts: Float[Tensor, "V 3"]) -> Mesh:
        """Return the surface at these positions, in float64."""
        return Mesh(verts.cpu().double().numpy(), self.faces.cpu().numpy())


@dataclass(frozen=True, eq=False)
class Shape:
    """A surface at its current positions, with its areas, normals and lengths.

    Attributes:
        connectivity: its faces.
        verts: (V, 3) its positions.
        limit_normals: (V, 3) unit normals of the limit surface that the vertices are on, 0 where it has none; or None.
    """

    connectivity: Connectivity
    verts: Float[Tensor, "V 3"]
    limit_normals: Float[Tensor, "V 3"] | None = None

    @cached_property
    def double_area_vectors(self) -> Float[Tensor, "F 3"]:
        """Normal vectors of the faces, of twice their area as length."""
        return double_area_vectors(self.verts, self.connectivity.faces)

    @cached_property
    def double_area(self) -> Float[Tensor, " F"]:
        """Twice the area of each face."""
        return length_of(self.double_area_vectors)

    @cached_property
    def normals(self) -> Float[Tensor, "F 3"]:
        """Unit normals of the faces; 0 without area."""
        return unit(self.double_area_vectors)

    @cached_property
    def vert_normals(self) -> Float[Tensor, "V 3"]:
        """Unit normals at the vertices: area-weighted means of the face normals."""
        return unit(self.connectivity.at_verts(self.double_area_vectors))

    @cached_property
    def smooth_normals(self) -> Float[Tensor, "V 3"]:
        """Unit normals at the vertices of the smooth surface that they are on, or that the faces stand for."""
        if self.limit_normals is None:
            return self.vert_normals
        return torch.where(self.limit_normals.any(1, keepdim=True), self.limit_normals, self.vert_normals)

    @cached_property
    def corners(self) -> Float[Tensor, "F 3 3"]:
        """Positions of the corners of each face."""
        return self.verts[self.connectivity.faces]

    def points(self, face: Int64[Tensor, " M"], weights: Float[Tensor, "M 3"]) -> Float[Tensor, "M 3"]:
        """Return the points of some faces at barycentric coordinates."""
        corners = self.corners.reshape(-1, 9).index_select(0, face)
        first, second, third = (corners[:, 3 * k : 3 * k + 3] * weights[:, k, None] for k in range(3))
        return first + second + third

    @cached_property
    def edge_lengths(self) -> Float[Tensor, " E"]:
        """Length of each edge."""
        tail, head = self.connectivity.ends
        return length_of(self.verts[head] - self.verts[tail])
