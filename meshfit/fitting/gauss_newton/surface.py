"""A surface that moves while its connectivity stays: what is the same at every step, and where its faces are now."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from scipy.sparse import coo_array
from torch import Tensor

from meshfit.loss.sparse import Sparse
from meshfit.mesh.mesh import Mesh
from meshfit.remeshing.connectivity import Edges
from meshfit.remeshing.triangle_geometry import area_vectors, length_of, unit


@dataclass(frozen=True, eq=False)
class Connectivity:
    """The faces of a surface and what follows from them.

    Attributes:
        faces: (F, 3) vertex indices, counter-clockwise seen from outside.
        num_verts: V.
        dtype: of what is computed on it.
    """

    faces: Int64[Tensor, "F 3"]
    num_verts: int
    dtype: torch.dtype

    @cached_property
    def edges(self) -> Edges:
        """The edges of the faces."""
        return Edges.of(self.faces, self.num_verts)

    @cached_property
    def pairs(self) -> Int64[Tensor, "2 P"]:
        """The two faces of every inner edge."""
        inner = self.edges.inner.nonzero()[:, 0]
        return torch.stack([self.edges.left[inner], self.edges.right[inner]]) // 3

    @cached_property
    def ends(self) -> Int64[Tensor, "2 E"]:
        """The ends of every edge."""
        return torch.stack([self.edges.tail, self.edges.head])

    @cached_property
    def face_of_vert(self) -> tuple[Int64[Tensor, " V"], Int64[Tensor, " V"]]:
        """For each vertex, one of its faces and which corner of it it is."""
        face = torch.zeros(self.num_verts, dtype=torch.int64, device=self.faces.device)
        corner = torch.zeros_like(face)
        for k in range(3):
            face[self.faces[:, k]] = torch.arange(len(self.faces), device=face.device)
        for k in range(3):
            corner[self.faces[face, k] == torch.arange(self.num_verts, device=face.device)] = k
        return face, corner

    @cached_property
    def umbrella(self) -> Sparse:
        """The uniform Laplacian: takes values to their difference from the mean of the neighbours'."""
        n, (tail, head) = self.num_verts, (ends.cpu().numpy() for ends in self.ends)
        valence = self.edges.valence.cpu().double().numpy()
        share = 1 / valence.clip(min=1)
        rows, columns = np.concatenate([np.arange(n), tail, head]), np.concatenate([np.arange(n), head, tail])
        values = np.concatenate([valence.clip(max=1), -share[tail], -share[head]])
        return Sparse.of(coo_array((values, (rows, columns)), shape=(n, n)), self.dtype, self.faces.device)

    def at_verts(self, per_corner: Float[Tensor, "F N"]) -> Float[Tensor, "V N"]:
        """Sums at each vertex of what its faces have."""
        total = per_corner.new_zeros(self.num_verts, per_corner.shape[1])
        for k in range(3):
            total.index_add_(0, self.faces[:, k], per_corner)
        return total

    def neighbour_mean(self, values: Float[Tensor, "V N"]) -> Float[Tensor, "V N"]:
        """The mean over the neighbours of each vertex."""
        tail, head = self.ends
        total = torch.zeros_like(values).index_add_(0, tail, values[head]).index_add_(0, head, values[tail])
        return total / self.edges.valence.clamp_min(1)[:, None]

    def verts_of(self, faces: Bool[Tensor, " F"]) -> Bool[Tensor, " V"]:
        """The verts of some faces."""
        found = torch.zeros(self.num_verts, dtype=torch.bool, device=faces.device)
        found[self.faces[faces].reshape(-1)] = True
        return found

    def grown(self, verts: Bool[Tensor, " V"]) -> Bool[Tensor, " V"]:
        """Some verts and their neighbours."""
        tail, head = self.ends
        found = verts.clone()
        found[tail[verts[head]]] = True
        found[head[verts[tail]]] = True
        return found

    def mesh(self, verts: Float[Tensor, "V 3"]) -> Mesh:
        """The surface with its verts at these places, in float64."""
        return Mesh(verts.cpu().double().numpy(), self.faces.cpu().numpy())


@dataclass(frozen=True, eq=False)
class Shape:
    """Where the faces are now.

    Attributes:
        connectivity: which they are.
        verts: (V, 3) positions.
    """

    connectivity: Connectivity
    verts: Float[Tensor, "V 3"]

    @cached_property
    def across(self) -> Float[Tensor, "F 3"]:
        """Vectors across the faces, as long as twice their areas."""
        return area_vectors(self.verts, self.connectivity.faces)

    @cached_property
    def double_area(self) -> Float[Tensor, " F"]:
        """Twice the area of each face."""
        return length_of(self.across)

    @cached_property
    def normals(self) -> Float[Tensor, "F 3"]:
        """Unit normals; 0 for faces without area."""
        return unit(self.across)

    @cached_property
    def vert_normals(self) -> Float[Tensor, "V 3"]:
        """Unit normals at the verts, of faces weighted by area."""
        return unit(self.connectivity.at_verts(self.across))

    @cached_property
    def corners(self) -> Float[Tensor, "F 3 3"]:
        """The positions of the corners of each face."""
        return self.verts[self.connectivity.faces]

    @cached_property
    def edge_lengths(self) -> Float[Tensor, " E"]:
        """The length of each edge."""
        tail, head = self.connectivity.ends
        return length_of(self.verts[head] - self.verts[tail])
