"""Normals of clouds from the closed surface that is wrapped around them, which keeps both sides of thin parts apart."""

import numpy as np
from scipy.spatial import cKDTree

from meshfit.mesh.control_mesh import wrap_around
from meshfit.mesh.geometry import unit_vectors, vert_area_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import Normals, PointCloud, Points, num_plane_neighbours, oriented_cloud

# Share of the points at which a wrap must agree with normals that neighbours orient, so that it is closed around them
# and not on both sides of an open scan; and most points, beyond which it takes too long.
_AGREEING, _MOST_POINTS = 0.85, 100_000
# Neighbours share a side if the cosine of the angle between their normals is above this, and a plane needs so many of
# them; a plane is no better than the wrap where the cosine between their normals is below the last number.
_SAME_SIDE, _FEWEST, _LIKE_WRAP = 0.3, 6, 0.5
_ROUNDS, _BLOCK = 2, 1 << 14


def cloud_with_normals(cloud: PointCloud) -> PointCloud:
    """Return a cloud with normals: its own, those of planes of neighbours on the same side of a wrap, or of any.

    Planes of nearest neighbours mix the two sides of parts that are hardly thicker than the noise, such as the ears of
    an animal, and a spanning tree turns these parts inside out. A wrap of a closed surface has neither fault. Open
    scans, which it would enclose from both sides, are left to the spanning tree.

    Args:
        cloud: N points without outliers.
    """
    oriented = oriented_cloud(cloud)
    if cloud.normals is not None or cloud.num_verts > _MOST_POINTS:
        return oriented
    assert oriented.normals is not None  # noqa: S101  oriented
    outwards = _normals_of_wrap(cloud.verts)
    agreeing = float((np.einsum("nk,nk->n", outwards, oriented.normals) > 0).mean())
    if agreeing < _AGREEING:
        return oriented
    return PointCloud(cloud.verts, _planes_of_sides(cloud.verts, outwards))


def _normals_of_wrap(points: Points) -> Normals:
    """Return (N, 3) the interpolated normals of the wrap where it is nearest to the points."""
    from meshfit.mesh.proximity import nearest_on_surface  # brings libigl

    wrap = wrap_around(Mesh(points, []))
    at_verts = unit_vectors(vert_area_vectors(wrap))
    faces = nearest_on_surface(wrap, points).faces
    return unit_vectors(at_verts[wrap.faces[faces]].sum(axis=1))


def _planes_of_sides(points: Points, outwards: Normals) -> Normals:
    """Return (N, 3) normals of planes through those neighbours whose normals are similar, in some rounds."""
    tree = cKDTree(points)
    count, normals = num_plane_neighbours(points, tree), outwards
    for _ in range(_ROUNDS):
        before, normals = normals, np.empty_like(normals)
        for start in range(0, len(points), _BLOCK):
            block = slice(start, start + _BLOCK)
            around = np.asarray(tree.query(points[block], count)[1])
            same = np.einsum("nki,ni->nk", before[around], before[block]) > _SAME_SIDE
            weights = same / np.maximum(same.sum(axis=1, keepdims=True), 1)
            middle = np.einsum("nk,nki->ni", weights, points[around])
            offsets = points[around] - middle[:, None]
            planes = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weights, offsets, offsets))[1][:, :, 0]
            along = np.einsum("nk,nk->n", planes, outwards[block])
            planes = np.where(along[:, None] < 0, -planes, planes)
            good = (same.sum(axis=1) >= _FEWEST) & (np.abs(along) > _LIKE_WRAP)
            normals[block] = np.where(good[:, None], planes, before[block])
    return normals
