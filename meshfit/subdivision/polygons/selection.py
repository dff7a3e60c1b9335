"""Small sparse matrices from which operators are assembled: selection, scatter and face means."""

from collections.abc import Mapping

import numpy as np
from scipy.sparse import coo_array, csr_array

from meshfit.mesh.topology import Indices, PolygonTopology
from meshfit.subdivision.masks import CurveWeights


def select(columns: Indices, num_columns: int) -> csr_array:
    """Return the (N, num_columns) selection matrix, with a one in each row."""
    count = len(columns)
    return csr_array((np.ones(count), columns, np.arange(count + 1)), shape=(count, num_columns))


def scatter(rows: Indices, operator: csr_array, num_rows: int, weights: "np.ndarray | None" = None) -> csr_array:
    """Scatter the rows of an operator, times weights, to (num_rows, V); rows at the same place add up."""
    values = np.ones(len(rows)) if weights is None else weights
    placement = coo_array((values, (rows, np.arange(len(rows)))), shape=(num_rows, len(rows)))
    return csr_array(csr_array(placement) @ operator)


def face_means(topology: PolygonTopology) -> csr_array:
    """Return the (F, V) operator to the mean of the corners of each face."""
    pointers = np.append(topology.starts, len(topology.corners))
    shares = np.repeat(1 / topology.sizes, topology.sizes)
    return csr_array((shares, topology.corners, pointers), shape=(topology.num_faces, topology.num_verts))


def boundary_rows(topology: PolygonTopology, halfedge: Indices, weights: CurveWeights) -> csr_array:
    """Return (N, V) rows of weights by offset along the boundary, from the tails of half-edges on it."""
    tail, head = topology.tail[halfedge], topology.head[halfedge]
    neighbours = topology.boundary_neighbours
    along = {-1: neighbours[tail, 0], 0: tail, 1: head, 2: neighbours[head, 1]}
    return weighted_sum({offset: select(verts, topology.num_verts) for offset, verts in along.items()}, weights)


def weighted_sum(points: Mapping[int, csr_array], weights: CurveWeights) -> csr_array:
    """Return the weighted sum of the points at some offsets."""
    total = csr_array(points[0].shape)
    for offset, weight in weights.items():
        total = total + float(weight) * points[offset]
    return csr_array(total)
