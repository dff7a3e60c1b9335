"""Where verts of a control mesh end up when Loop subdivision goes on for ever."""

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.topology import Topology


def loop_limit(topology: Topology) -> csr_array:
    """(V, V) the operator that takes verts to their limit positions under Loop subdivision.

    Of an inner vertex v with n neighbours, that is (1 - n χ) v + χ Σ, χ = 1 / (n + 3 / (8 β)), with Loop's
    β = (5/8 - (3/8 + cos(2π/n)/4)²) / n (Loop 1987); of one on the boundary, (l + 4 v + r) / 6, the cubic B-spline's.

    Raises:
        MeshError: the mesh is not an oriented manifold.
    """
    require_manifold(topology, "the limit surface")
    n, valence = topology.num_verts, topology.valence.clip(min=1)
    beta = (5 / 8 - (3 / 8 + np.cos(2 * np.pi / valence) / 4) ** 2) / valence
    outer = topology.faces_per_edge == 1
    on_boundary = np.zeros(n, dtype=bool)
    on_boundary[topology.edges[outer].reshape(-1)] = True
    share = np.where(on_boundary, 1 / 6, 1 / (valence + 3 / (8 * beta)))
    kept = np.where(on_boundary, 4 / 6, 1 - valence * share)
    rows, columns = np.concatenate([topology.edges, topology.edges[:, ::-1]]).T
    along = np.tile(outer, 2)
    counts = ~on_boundary[rows] | along
    neighbours = coo_array((share[rows[counts]], (rows[counts], columns[counts])), shape=(n, n))
    return csr_array(diags_array(kept) + neighbours)
