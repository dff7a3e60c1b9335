"""Nearest points by a k-d tree on the CPU, and orders of points, faces and vertices that keep neighbours together."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int64
from pykdtree.kdtree import KDTree
from scipy.spatial import cKDTree

from meshfit.mesh.mesh import Mesh

Points = Float[np.ndarray, "N 3"]
PointsOfAnySpace = Float[np.ndarray, "_ _"]
Indices = Int64[np.ndarray, " M"]

# Largest coordinate in a Morton code, and each coordinate with two zeros between its bits.
_CELLS = 1023
_SPREAD = np.array([int(f"{cell:b}", 8) for cell in range(_CELLS + 1)], dtype=np.uint32)


def nearest_point_query(points: PointsOfAnySpace, *, scattered: bool = False) -> Callable[[PointsOfAnySpace], Indices]:
    """Build a k-d tree over points; return a function from (M, D) queries to (M,) the index of the nearest point.

    It is fastest where consecutive points are close to each other.

    Args:
        points: (N, D) float32 or float64, at least one; queries must have the same dtype.
        scattered: whether consecutive queries may be far apart, so that sorting them first takes half the time;
            in space only.
    """
    tree: Any = KDTree(np.ascontiguousarray(points), leafsize=16)

    def query(queries: PointsOfAnySpace) -> Indices:
        if scattered:
            order = spatial_order(queries)
            nearest = np.empty(len(queries), dtype=np.int64)
            nearest[order] = tree.query(queries[order])[1]
        else:
            nearest = np.asarray(tree.query(np.ascontiguousarray(queries))[1], dtype=np.int64)
        # Where squared distances overflow, the tree returns an index that is out of range.
        return np.minimum(nearest, len(points) - 1)

    return query


def spatial_order(points: Points) -> Indices:
    """Return an order of points along a Morton curve, in which consecutive ones are close to each other."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    columns = np.ascontiguousarray(points.T)
    code = np.zeros(len(points), dtype=np.uint32)
    with np.errstate(all="ignore"):  # any order will do for points that are not finite
        scale = _CELLS / np.ptp(columns, axis=1).max()
        for axis, column in enumerate(columns):
            cell = ((column - column.min()) * scale).astype(np.int32) & _CELLS
            code |= _SPREAD[cell] << np.uint32(axis)
    return code.argsort()


def sort_faces_spatially(mesh: Mesh) -> Mesh:
    """Order the faces by the leaves of a k-d tree, so that neighbours are close in memory."""
    return Mesh(mesh.verts, mesh.faces[cKDTree(mesh.verts[mesh.faces].mean(axis=1)).indices])


def renumber_verts_by_faces(mesh: Mesh) -> Mesh:
    """Order the vertices by their first use in the faces, and drop unused ones."""
    used, first, inverse = np.unique(mesh.faces, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return Mesh(mesh.verts[used[order]], np.argsort(order)[inverse].reshape(-1, 3))
