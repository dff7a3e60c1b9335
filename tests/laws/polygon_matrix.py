"""The subdivision matrix of a scheme on polygons around one vertex in quads."""

import numpy as np

from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.polygons.scheme import LINEAR_SCHEMES, PolygonSplit
from meshfit.subdivision.refine import refine
from meshfit.subdivision.registry import resolve
from tests.quads import quad_wheel

STEPS = {PolygonSplit.QUADS: 1, PolygonSplit.SQRT2: 2, PolygonSplit.TERNARY: 1}


def quad_matrix(valence: int, spec: str, rings: int = 1) -> np.ndarray:
    """1 + n r (r + 1) square: vertex 0, then the verts (i, j) of each sector, 1 ≤ i ≤ r, 0 ≤ j ≤ r."""
    scheme = resolve(spec)
    mesh, levels = quad_wheel(valence, rings + 3), STEPS[scheme.split]
    topology = PolygonTopology.of(mesh)
    refinement = refine(topology, scheme, levels)
    flat = refine(topology, LINEAR_SCHEMES[scheme.split], levels)(mesh.verts)
    coarse, fine = (sector_verts(t, rings, places) for t, places in ((topology, mesh.verts), (refinement.finest, flat)))
    rows = refinement.matrix.toarray()[fine]
    assert not np.delete(rows, coarse, axis=1).any(), "the rings do not suffice"
    return rows[:, coarse]


def sector_verts(topology: PolygonTopology, rings: int, places: np.ndarray) -> list[int]:
    """Vertex 0, then sector by sector the verts reached by i steps along its spoke and j more to the left."""
    out = np.flatnonzero(topology.tail == 0)
    reach = places[topology.head[out]] - places[0]
    angle = np.arctan2(reach[:, 1], reach[:, 0])
    spokes = out[np.argsort(np.where(angle < -1e-6, angle + 2 * np.pi, angle))]
    verts = [0]
    for spoke in spokes:
        along = int(spoke)
        for i in range(rings):
            along = straight_on(topology, along) if i else along
            verts.append(int(topology.head[along]))
            across = int(topology.following(np.array([along]))[0])
            for j in range(rings):
                across = straight_on(topology, across) if j else across
                verts.append(int(topology.head[across]))
    return verts


def straight_on(topology: PolygonTopology, halfedge: int) -> int:
    """At a vertex of valence 4, of the half-edges out of the head the one opposite to the way back."""
    left = topology.following(np.array([halfedge]))
    return int(topology.following(topology.twin[left])[0])


def moduli(matrix: np.ndarray) -> np.ndarray:
    """The absolute eigenvalues, largest first."""
    return np.sort(np.abs(np.linalg.eigvals(matrix)))[::-1]


def mode_block(matrix: np.ndarray, valence: int, mode: int) -> np.ndarray:
    """The part of a matrix that acts on what turns `mode` times around the vertex."""
    size = (len(matrix) - 1) // valence
    turns = np.exp(2j * np.pi * mode * np.arange(valence) / valence)
    parts = matrix[1:, 1:].reshape(valence, size, valence, size)
    block = np.einsum("aibj,b->ij", parts[:1], turns)
    if mode:
        return block
    whole = np.zeros((size + 1, size + 1), dtype=complex)
    whole[0, 0], whole[1:, 1:] = matrix[0, 0], block
    whole[0, 1:] = matrix[0, 1:].reshape(valence, size).sum(axis=0)
    whole[1:, 0] = matrix[1 : 1 + size, 0]
    return whole
