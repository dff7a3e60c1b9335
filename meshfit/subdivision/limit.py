"""Where verts of a control mesh end up when Loop subdivision goes on for ever."""

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from meshfit.errors import SchemeError
from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.topology import Topology
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.triangle_scheme import TriangleScheme
from meshfit.subdivision.triangle_table import LOOP


def has_loop_limit(scheme: Scheme) -> bool:
    """Whether `loop_limit` knows the limit of a scheme: Loop's masks, with any weights of old inner verts."""
    if not isinstance(scheme, TriangleScheme) or scheme.vert is None or scheme.push_back or scheme.spokes:
        return False
    return (scheme.split, scheme.inserted, scheme.boundary) == (LOOP.split, LOOP.inserted, LOOP.boundary)


def loop_limit(topology: Topology, scheme: Scheme = LOOP) -> csr_array:
    """(V, V) the operator that takes verts to their limit positions under Loop subdivision.

    Of an inner vertex v with n neighbours, that is (1 - n χ) v + χ Σ, χ = 1 / (n + 3 / (8 β)), where n β is what the
    scheme gives to the ring (Loop 1987); of one on the boundary, (l + 4 v + r) / 6, the cubic B-spline's.

    Args:
        topology: of the mesh.
        scheme: one that `has_loop_limit`.

    Raises:
        MeshError: the mesh is not an oriented manifold.
        SchemeError: the scheme has another limit.
    """
    if not isinstance(scheme, TriangleScheme) or scheme.vert is None or not has_loop_limit(scheme):
        raise SchemeError("limit positions are known for loop only")
    require_manifold(topology, "the limit surface")
    n, valence = topology.num_verts, topology.valence.clip(min=1)
    ring_of = np.array([1.0, *(scheme.vert.ring(k) for k in range(1, int(valence.max(initial=0)) + 1))])
    beta = ring_of[valence] / valence
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
