"""Pairs of points on two boundaries, for open surfaces: boundary goes to boundary, free to slide along it."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Generator, Tensor

from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.nearest_neighbours import nearest_neighbour_search
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.remeshing.triangle_geometry import unit

_POINTS = 5000
# How much the boundary weighs: as a strip of the surface that is so many edges wide.
_STRIP = 4.0


@dataclass(frozen=True, eq=False)
class TargetBoundary:
    """The boundary of a target.

    Attributes:
        points: (N, 3) spread evenly along it.
        tangents: (N, 3) unit vectors along it.
    """

    points: Float[Tensor, "N 3"]
    tangents: Float[Tensor, "N 3"]

    @classmethod
    def of(cls, mesh: Mesh, dtype: torch.dtype, device: torch.device) -> "TargetBoundary | None":
        """The boundary of a mesh; None if it has none."""
        topology = Topology.of(mesh)
        edges = topology.edges[topology.faces_per_edge == 1]
        if not len(edges):
            return None
        start, side = mesh.verts[edges[:, 0]], mesh.verts[edges[:, 1]] - mesh.verts[edges[:, 0]]
        length = np.linalg.norm(side, axis=1)
        total = length.cumsum()
        at = (np.arange(_POINTS) + 0.5) * (total[-1] / _POINTS)
        which = np.searchsorted(total, at).clip(max=len(edges) - 1)
        along = 1 - (total[which] - at) / np.maximum(length[which], np.finfo(float).tiny)
        points = torch.tensor(start[which] + along[:, None] * side[which], dtype=dtype, device=device)
        return cls(points, unit(torch.tensor(side[which], dtype=dtype, device=device)))


@dataclass(frozen=True, eq=False)
class BoundaryPairs:
    """Points on the boundary of the surface and where they are to go, as in `Correspondences`.

    Each is there twice, once for each of two directions across the target's boundary.
    """

    face: Tensor
    corners: Tensor
    normals: Tensor
    residuals: Tensor
    weights: Tensor


def boundary_correspondences(shape: Shape, boundary: TargetBoundary, generator: Generator) -> BoundaryPairs:
    """Pair verts and middles of boundary edges with the nearest of the rim, and points of the rim with these.

    Args:
        shape: a surface with boundary.
        boundary: of the target.
        generator: of the target points, on the CPU.
    """
    face, corners = _places(shape)
    points = (corners[:, :, None] * shape.corners[face]).sum(1)
    drawn = torch.randint(len(boundary.points), (len(points),), generator=generator).to(points.device)
    there = torch.cat([nearest_neighbour_search(boundary.points)(points), drawn])
    here = torch.cat(
        [torch.arange(len(points), device=points.device), nearest_neighbour_search(points)(boundary.points[drawn])]
    )
    outer = shape.edge_lengths[shape.connectivity.edges.outer]
    weight = _STRIP * float(outer.sum() * outer.mean() / (shape.double_area.sum() / 2)) / len(points)
    return BoundaryPairs(
        face=face[here].repeat(2),
        corners=corners[here].repeat(2, 1),
        normals=torch.cat(_across(boundary.tangents[there])),
        residuals=(boundary.points[there] - points[here]).repeat(2, 1),
        weights=points.new_full((2 * len(here),), weight),
    )


def _places(shape: Shape) -> tuple[Tensor, Tensor]:
    """Of each boundary edge its first end and its middle: faces, and weights of their corners."""
    side = shape.connectivity.edges.left[shape.connectivity.edges.outer]
    one = torch.nn.functional.one_hot(side % 3, 3).to(shape.verts)
    other = torch.nn.functional.one_hot((side + 1) % 3, 3).to(shape.verts)
    return (side // 3).repeat(2), torch.cat([one, (one + other) / 2])


def _across(tangents: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"]]:
    """Two unit vectors across each, and across each other."""
    least = torch.nn.functional.one_hot(tangents.abs().argmin(1), 3).to(tangents)
    one = unit(torch.linalg.cross(tangents, least))
    return one, torch.linalg.cross(tangents, one)
