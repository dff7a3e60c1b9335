"""Area-uniform sampling of a surface in numpy."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points on the faces of a mesh.

    Attributes:
        points: (N, 3) positions.
        faces: (N,) the face of each.
    """

    points: Float64[np.ndarray, "N 3"]
    faces: Int64[np.ndarray, " N"]


def sample_surface(mesh: Mesh, count: int, generator: np.random.Generator) -> SurfacePoints:
    """Draw points uniformly by area, stratified: one in each of `count` equal parts of the total area.

    No face larger than two parts is missed. Within a triangle, points come from the square-root map (Osada et al.
    2002, Shape Distributions, eq. 1).

    Args:
        mesh: the surface.
        count: N, the number of points.
        generator: of the random numbers.
    """
    cumulative = np.cumsum(face_areas(mesh))
    at = (np.arange(count) + generator.random(count)) * (cumulative[-1] / count)
    faces = np.searchsorted(cumulative, at, side="right").clip(max=mesh.num_faces - 1)
    root, second = np.sqrt(generator.random(count)), generator.random(count)
    weights = np.stack([1 - root, root * (1 - second), root * second], axis=1)
    points = np.einsum("nk,nkd->nd", weights, mesh.verts[mesh.faces[faces]])
    return SurfacePoints(points, faces)
