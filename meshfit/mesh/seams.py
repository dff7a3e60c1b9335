"""Seams: edges at which corner data, such as texture coordinates, differ between both sides."""

import numpy as np

from meshfit.mesh.attributes import Values
from meshfit.mesh.topology import NONE, HalfEdges, Mask


def joined_edges(topology: HalfEdges, values: Values) -> Mask:
    """Return the (C,) half-edges at whose ends both sides have equal values; none at the boundary.

    Args:
        topology: with C corners.
        values: C rows.
    """
    rows = values.reshape(len(values), -1)
    inner = np.flatnonzero(topology.twin != NONE)
    twin = topology.twin[inner]
    joined = np.zeros(len(topology.tail), dtype=bool)
    joined[inner] = _equal(rows[inner], rows[topology.following(twin)])
    joined[inner] &= _equal(rows[topology.following(inner)], rows[twin])
    return joined


def at_verts(topology: HalfEdges, values: Values) -> Values:
    """Return one row for each vertex, of corner data without seams; 0 where a vertex has no face."""
    rows = np.zeros((topology.num_verts, *values.shape[1:]), dtype=values.dtype)
    rows[topology.tail] = values
    return rows


def _equal(first: Values, second: Values) -> Mask:
    both_nan = (np.isnan(first) & np.isnan(second)) if np.issubdtype(first.dtype, np.floating) else False
    return np.asarray(((first == second) | both_nan).all(axis=1))
