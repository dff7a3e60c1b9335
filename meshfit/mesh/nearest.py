"""Nearest points by a k-d tree, on the CPU, and the order of faces that makes its answers fast."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int64
from pykdtree.kdtree import KDTree
from scipy.spatial import cKDTree

from meshfit.mesh.mesh import Mesh

Points = Float[np.ndarray, "N 3"]
Indices = Int64[np.ndarray, " M"]


def nearest_point_query(points: Points) -> Callable[[Points], Indices]:
    """Build a k-d tree over points; the function returned maps (M, 3) queries to the (M,) index of each one's nearest.

    It is fastest where points that follow each other are near each other.

    Args:
        points: (N, 3) float32 or float64; queries must have the same dtype.
    """
    tree: Any = KDTree(np.ascontiguousarray(points), leafsize=16)

    def query(queries: Points) -> Indices:
        return np.asarray(tree.query(np.ascontiguousarray(queries))[1], dtype=np.int64)

    return query


def sort_faces_spatially(mesh: Mesh) -> Mesh:
    """The same mesh with its faces in the order of the leaves of a k-d tree, so that neighbours are near in memory."""
    return Mesh(mesh.verts, mesh.faces[cKDTree(mesh.verts[mesh.faces].mean(axis=1)).indices])


def renumber_verts_by_faces(mesh: Mesh) -> Mesh:
    """The same surface with its verts in the order in which its faces mention them; verts of no face are dropped."""
    used, first, inverse = np.unique(mesh.faces, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return Mesh(mesh.verts[used[order]], np.argsort(order)[inverse].reshape(-1, 3))
