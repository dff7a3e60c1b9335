"""Seams: edges at which corner data, such as texture coordinates, differ between both sides."""

import numpy as np

from meshfit.mesh.attributes import Values
from meshfit.mesh.topology import NONE, HalfEdges, Mask


def joined_edges(topology: HalfEdges, values: Values, *, at_one_end: bool = False) -> Mask:
    """Return the (C,) half-edges at whose ends both sides have equal values; none at the boundary.

    Args:
        topology: with C corners.
        values: C rows.
        at_one_end: take those too that are joined at one end only, where a seam ends, or at a pole with one value for
            each face.
    """
    rows = values.reshape(len(values), -1)
    inner = np.flatnonzero(topology.twin != NONE)
    twin = topology.twin[inner]
    joined = np.zeros(len(topology.tail), dtype=bool)
    at_tail = _equal(rows[inner], rows[topology.following(twin)])
    at_head = _equal(rows[topology.following(inner)], rows[twin])
    joined[inner] = at_tail | at_head if at_one_end else at_tail & at_head
    return joined


def at_verts(topology: HalfEdges, values: Values) -> Values:
    """Return one row for each vertex, of corner data without seams; 0 where a vertex has no face."""
    rows = np.zeros((topology.num_verts, *values.shape[1:]), dtype=values.dtype)
    rows[topology.tail] = values
    return rows


def _equal(first: Values, second: Values) -> Mask:
    both_nan = (np.isnan(first) & np.isnan(second)) if np.issubdtype(first.dtype, np.floating) else False
    return np.asarray(((first == second) | both_nan).all(axis=1))
