"""Support of a result: which of its vertices and faces the target shows, and which fill its holes."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.mesh.attributes import SUPPORTED, Attributes
from meshfit.mesh.geometry import unit_vectors, vert_area_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.noise import NEIGHBOURHOOD
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import Topology
from meshfit.remeshing.triangle_geometry import dot, length_of

# A point is shown by the target if the nearest point of it is within so many spacings, standard deviations of its
# noise, or mean edge lengths of the result, and faces the same way up to this cosine.
_SPACINGS, _EDGES, _FACING = 4.0, 1.0, -0.3


def with_support(attributes: Attributes, surface: Mesh | PolygonMesh, target: TargetCloud) -> Attributes:
    """Return attributes with those of vertices and faces that the target shows, 1 or 0, named `supported`.

    Without a rim, the target shows all there is: the attributes have none of that name then.

    Args:
        attributes: of the surface.
        surface: a result.
        target: the target.
    """
    others = attributes.without(SUPPORTED)
    if target.rim is None:
        return others
    of_verts, of_faces = (shown.astype(np.uint8) for shown in _shown(surface, target))
    vertex, face = {**others.vertex, SUPPORTED: of_verts}, {**others.face, SUPPORTED: of_faces}
    return replace(others, vertex=vertex, face=face)


def _shown(surface: Mesh | PolygonMesh, target: TargetCloud) -> tuple[Bool[np.ndarray, " V"], Bool[np.ndarray, " F"]]:
    """Return (V,) which vertices, and (F,) which middles of faces the target shows."""
    triangles = surface.triangulated() if isinstance(surface, PolygonMesh) else surface
    normals = vert_area_vectors(triangles)
    edges = Topology.of(triangles).edges
    edge = float(np.linalg.norm(triangles.verts[edges[:, 0]] - triangles.verts[edges[:, 1]], axis=1).mean())
    if isinstance(surface, PolygonMesh):
        corners, sizes = surface.corners, surface.sizes
    else:
        corners, sizes = surface.faces.reshape(-1), np.full(surface.num_faces, 3)
    starts = np.cumsum(sizes) - sizes
    middles = np.add.reduceat(surface.verts[corners], starts) / sizes[:, None]
    of_faces = np.add.reduceat(unit_vectors(normals)[corners], starts)
    points = np.concatenate([surface.verts, middles])
    directions = unit_vectors(np.concatenate([normals, of_faces]))
    reach = max(_SPACINGS * target.spacing, NEIGHBOURHOOD * target.noise, _EDGES * edge)
    shown = _are_shown(points, directions, target, reach)
    return shown[: surface.num_verts], shown[surface.num_verts :]


def _are_shown(
    points: Float64[np.ndarray, "N 3"], normals: Float64[np.ndarray, "N 3"], target: TargetCloud, reach: float
) -> Bool[np.ndarray, " N"]:
    at, facing = _like(points, target.points), _like(normals, target.points)
    nearest = target.nearest(at)
    near = length_of(at - target.points[nearest]) <= reach
    same_side = dot(facing, target.normals[nearest]) > _FACING
    shown = near & same_side & ~target.is_beyond(at, nearest)
    return np.asarray(shown.cpu().numpy())


def _like(values: Float64[np.ndarray, "N 3"], other: Tensor) -> Tensor:
    return torch.tensor(values, dtype=other.dtype, device=other.device)
