"""Nearest points by a k-d tree, on the CPU."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int64
from pykdtree.kdtree import KDTree

Points = Float[np.ndarray, "N 3"]


def nearest_in(points: Points) -> Callable[[Points], Int64[np.ndarray, " M"]]:
    """Build a k-d tree over points; the function returned maps (M, 3) queries to the (M,) index of each one's nearest.

    Args:
        points: (N, 3) float32 or float64; queries must have the same dtype.
    """
    tree: Any = KDTree(np.ascontiguousarray(points), leafsize=16)

    def query(queries: Points) -> Int64[np.ndarray, " M"]:
        return np.asarray(tree.query(np.ascontiguousarray(queries))[1], dtype=np.int64)

    return query
