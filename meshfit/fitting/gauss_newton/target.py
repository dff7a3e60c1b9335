"""The target as a cloud of points with normals, and its boundary as points with tangents."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Generator, Tensor

from meshfit.fitting.nearest_neighbours import nearest_neighbour_search
from meshfit.mesh.geometry import area_vectors, face_normals, unit_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import Topology
from meshfit.remeshing.triangle_geometry import unit

_POINTS = 200_000
_BOUNDARY_POINTS = 5000


@dataclass(frozen=True, eq=False)
class TargetBoundary:
    """The boundary of a target.

    Attributes:
        points: (N, 3) evenly spaced points along it.
        tangents: (N, 3) unit tangents.
    """

    points: Float[Tensor, "N 3"]
    tangents: Float[Tensor, "N 3"]

    @classmethod
    def of(cls, mesh: Mesh, dtype: torch.dtype, device: torch.device) -> "TargetBoundary | None":
        """Return the boundary of a mesh; None if it has none."""
        topology = Topology.of(mesh)
        edges = topology.edges[topology.faces_per_edge == 1]
        if not len(edges):
            return None
        start, side = mesh.verts[edges[:, 0]], mesh.verts[edges[:, 1]] - mesh.verts[edges[:, 0]]
        length = np.linalg.norm(side, axis=1)
        total = length.cumsum()
        arc = (np.arange(_BOUNDARY_POINTS) + 0.5) * (total[-1] / _BOUNDARY_POINTS)
        edge = np.searchsorted(total, arc).clip(max=len(edges) - 1)
        along = 1 - (total[edge] - arc) / np.maximum(length[edge], np.finfo(float).tiny)
        points = torch.tensor(start[edge] + along[:, None] * side[edge], dtype=dtype, device=device)
        return cls(points, unit(torch.tensor(side[edge], dtype=dtype, device=device)))


@dataclass(frozen=True, eq=False)
class TargetCloud:
    """Points on a target: samples of its faces, uniform by area, then its vertices.

    Attributes:
        points: (N, 3).
        normals: (N, 3) unit normals; at vertices, the area-weighted mean of the face normals.
        num_uniform: number of uniform samples, which come first.
        boundary: the target's boundary, if it has one.
        nearest: maps (M, 3) points to the (M,) indices of the nearest points of the cloud.
    """

    points: Float[Tensor, "N 3"]
    normals: Float[Tensor, "N 3"]
    num_uniform: int
    boundary: TargetBoundary | None
    nearest: Callable[[Tensor], Tensor]

    @classmethod
    def of(cls, mesh: Mesh, dtype: torch.dtype, device: torch.device) -> "TargetCloud":
        """Return the cloud of a mesh, always the same: one random point per stratum of equal area."""
        samples = sample_surface(mesh, _POINTS, np.random.default_rng(0))
        normals = np.zeros_like(mesh.verts)
        for k in range(3):
            np.add.at(normals, mesh.faces[:, k], area_vectors(mesh))
        used = normals.any(axis=1)
        points = np.concatenate([samples.points, mesh.verts[used]])
        normals = np.concatenate([face_normals(mesh)[samples.faces], unit_vectors(normals[used])])
        cloud = torch.tensor(points, dtype=dtype, device=device)
        return cls(
            cloud,
            torch.tensor(normals, dtype=dtype, device=device),
            _POINTS,
            TargetBoundary.of(mesh, dtype, device),
            nearest_neighbour_search(cloud),
        )

    def draw(self, count: int, generator: Generator) -> Int64[Tensor, " C"]:
        """Draw some of the uniform samples, in the order of their faces, which makes queries fast."""
        uniform = torch.rand(count, generator=generator, dtype=torch.float64, device=generator.device)
        return (uniform * self.num_uniform).long().clamp_max(self.num_uniform - 1).sort().values.to(self.points.device)
