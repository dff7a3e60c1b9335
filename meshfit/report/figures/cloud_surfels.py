"""Points drawn as surfels: small discs in the planes of their neighbours, so that a cloud is drawn as a mesh is."""

from typing import TypeVar

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud, oriented_cloud, sampled_areas, tangent_vectors
from meshfit.mesh.polygons import PolygonMesh

_AnyMesh = TypeVar("_AnyMesh", Mesh, Mesh | PolygonMesh)

_MOST_DRAWN, _MOST_MEASURED = 60_000, 100_000
# Radius of a disc in mean distances of points: apart from each other to be seen, over each other to be measured to.
_DRAWN, _MEASURED = 0.42, 1.0
_HEXAGON = 6


def drawn(target: _AnyMesh | PointCloud) -> _AnyMesh | Mesh:
    """Return a mesh as it is, and points as discs that are apart from each other."""
    return surfels(target, _MOST_DRAWN, _DRAWN) if isinstance(target, PointCloud) else target


def measurable(target: Mesh | PointCloud) -> Mesh:
    """Return a mesh as it is, and points as discs that overlap, so that distances to them are about those to a surface.

    Distances to the points themselves would show, above all, how far these are apart.
    """
    return surfels(target, _MOST_MEASURED, _MEASURED) if isinstance(target, PointCloud) else target


def surfels(cloud: PointCloud, most: int, radius: float = _DRAWN, corners: int = _HEXAGON) -> Mesh:
    """Return the discs of some points, in the order of the points, as regular polygons that are cut into triangles.

    Args:
        cloud: the points.
        most: largest number of discs; of more points, as many are drawn at random, always the same.
        radius: of a hexagon, in mean distances of these points; discs with fewer corners have its area.
        corners: of a disc.
    """
    cloud = oriented_cloud(cloud.thinned(most))
    assert cloud.normals is not None  # noqa: S101  oriented
    first, second = tangent_vectors(cloud.normals)
    radius *= float(np.sqrt(_area(_HEXAGON) / _area(corners)))
    size = radius * float(np.sqrt(np.median(sampled_areas(cloud.verts))))
    angles = 2 * np.pi * np.arange(corners) / corners
    around = np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * second[:, None]
    verts = (cloud.verts[:, None] + size * around).reshape(-1, 3)
    fan = np.stack([np.zeros(corners - 2, np.int64), np.arange(1, corners - 1), np.arange(2, corners)], axis=1)
    faces = corners * np.arange(cloud.num_verts)[:, None, None] + fan
    return Mesh(verts, faces.reshape(-1, 3))


def _area(corners: int) -> float:
    """Return the area of a regular polygon of radius 1."""
    return corners * float(np.sin(2 * np.pi / corners)) / 2
