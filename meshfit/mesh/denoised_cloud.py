"""Points of very noisy clouds, moved onto a smooth surface that most of them agree on."""

from functools import lru_cache

import numpy as np

from meshfit.mesh.geometry import unit_vectors, vert_area_vectors
from meshfit.mesh.mesh import Mesh, SameContent
from meshfit.mesh.meshlab import screened_poisson
from meshfit.mesh.noise import is_very_noisy, noise_of_points
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.wrapped_normals import cloud_with_normals

# Depth of the octree and weight of the points: cells of 2 % of the box, and hardly more pull than smoothness.
_DEPTH, _POINT_WEIGHT = 6, 1.0
# Points farther from the surface than so many standard deviations of the noise stay in place.
_DEVIATIONS = 4.0


def denoised_cloud(cloud: PointCloud, noise: float | None = None) -> PointCloud:
    """Return a very noisy cloud with its points on a screened Poisson surface through them; others with normals alone.

    A surface that is drawn to the nearest of its points comes to rest anywhere in a slab of noise: a fit to the
    points of the bunny with noise of 2 % ends at twice the distance from its shape.

    Args:
        cloud: N points without outliers.
        noise: standard deviation of its points across the surface; None to estimate it.
    """
    return _denoised(SameContent(Mesh(cloud.verts, [])), noise) if cloud.normals is None else _moved(cloud, noise)


@lru_cache(maxsize=2)  # a control mesh is made from the same points that its fit is drawn to
def _denoised(content: SameContent, noise: float | None) -> PointCloud:
    return _moved(PointCloud(content.mesh.verts), noise)


def _moved(cloud: PointCloud, noise: float | None) -> PointCloud:
    from meshfit.mesh.proximity import nearest_on_surface  # brings libigl

    oriented = cloud_with_normals(cloud)
    noise = noise_of_points(cloud.verts) if noise is None else noise
    if not is_very_noisy(cloud.verts, noise):
        return oriented
    assert oriented.normals is not None  # noqa: S101  oriented
    surface = screened_poisson(oriented.verts, oriented.normals, _DEPTH, _POINT_WEIGHT)
    nearest = nearest_on_surface(surface, cloud.verts)
    near = (nearest.distances < _DEVIATIONS * noise)[:, None]
    at_verts = unit_vectors(vert_area_vectors(surface))
    smooth = unit_vectors(at_verts[surface.faces[nearest.faces]].sum(axis=1))
    return PointCloud(
        np.where(near, nearest.points, cloud.verts), np.where(near, smooth, oriented.normals), cloud.sensor
    )
