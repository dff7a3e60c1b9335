"""The target as a cloud of points with normals, made once, and the nearest of them to any others."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Generator, Tensor

from meshfit.fitting.gauss_newton.boundary import TargetBoundary
from meshfit.fitting.nearest_neighbours import nearest_neighbour_search
from meshfit.mesh.geometry import area_vectors, face_normals, unit_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.sampling import sample_surface

_POINTS = 200_000


@dataclass(frozen=True, eq=False)
class TargetCloud:
    """Points on a target: so many of its faces, evenly by area, then its verts.

    Attributes:
        points: (N, 3).
        normals: (N, 3) unit normals, at verts those of their faces weighted by area.
        num_even: how many of them, the first ones, are spread evenly.
        boundary: its boundary, if it has one.
        nearest: (M, 3) points to the (M,) indices of the nearest of the cloud.
    """

    points: Float[Tensor, "N 3"]
    normals: Float[Tensor, "N 3"]
    num_even: int
    boundary: TargetBoundary | None
    nearest: Callable[[Tensor], Tensor]

    @classmethod
    def of(cls, mesh: Mesh, dtype: torch.dtype, device: torch.device) -> "TargetCloud":
        """The cloud of a mesh, always the same one: one point from each of as many parts of equal area."""
        even = sample_surface(mesh, _POINTS, np.random.default_rng(0))
        normals = np.zeros_like(mesh.verts)
        for k in range(3):
            np.add.at(normals, mesh.faces[:, k], area_vectors(mesh))
        used = normals.any(axis=1)
        points = np.concatenate([even.points, mesh.verts[used]])
        normals = np.concatenate([face_normals(mesh)[even.faces], unit_vectors(normals[used])])
        cloud = torch.tensor(points, dtype=dtype, device=device)
        return cls(
            cloud,
            torch.tensor(normals, dtype=dtype, device=device),
            _POINTS,
            TargetBoundary.of(mesh, dtype, device),
            nearest_neighbour_search(cloud),
        )

    def draw(self, count: int, generator: Generator) -> Int64[Tensor, " C"]:
        """Some of the evenly spread points, in their order, which is the faces' and so makes queries fast."""
        uniform = torch.rand(count, generator=generator, dtype=torch.float64, device=generator.device)
        return (uniform * self.num_even).long().clamp_max(self.num_even - 1).sort().values.to(self.points.device)
