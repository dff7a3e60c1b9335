"""Surfaces at a distance from others, along their normals."""

import numpy as np

from meshfit.mesh.geometry import unit_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud, oriented_cloud


def lifted(target: Mesh | PointCloud, offset: float) -> Mesh | PointCloud:
    """Return a mesh, or points, whose vertices are moved along their normals, outwards if the offset is above 0."""
    if isinstance(target, PointCloud):
        oriented = oriented_cloud(target)
        assert oriented.normals is not None  # noqa: S101  oriented
        return oriented.with_verts(oriented.verts + offset * oriented.normals)
    a, b, c = (target.verts[target.faces[:, corner]] for corner in range(3))
    normals = np.zeros_like(target.verts)
    for corner in range(3):
        np.add.at(normals, target.faces[:, corner], np.cross(b - a, c - a))
    return target.with_verts(target.verts + offset * unit_vectors(normals))
