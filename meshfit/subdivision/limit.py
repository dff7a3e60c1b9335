"""Where verts of a control mesh end up when Loop subdivision goes on for ever."""

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from meshfit.errors import SchemeError
from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.topology import Mask, Topology
from meshfit.subdivision.creases import Creases, require_creases
from meshfit.subdivision.limit_masks import dart_masks
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.sheets import Sheets, sheets_of
from meshfit.subdivision.triangle_scheme import TriangleScheme
from meshfit.subdivision.triangle_table import LOOP


def has_loop_limit(scheme: Scheme) -> bool:
    """Whether `loop_limit` knows the limit of a scheme: Loop's masks, with any weights of old inner verts."""
    if not isinstance(scheme, TriangleScheme) or scheme.vert is None or scheme.push_back or scheme.spokes:
        return False
    return (scheme.split, scheme.inserted, scheme.boundary) == (LOOP.split, LOOP.inserted, LOOP.boundary)


def loop_limit(topology: Topology, scheme: Scheme = LOOP, creases: Creases | None = None) -> csr_array:
    """(V, V) the operator that takes verts to their limit positions under Loop subdivision.

    Of an inner vertex v with n neighbours, that is (1 - n χ) v + χ Σ, χ = 1 / (n + 3 / (8 β)), where n β is what the
    scheme gives to the ring (Loop 1987); of one on the boundary or a crease, (l + 4 v + r) / 6, the cubic B-spline's.
    Corners stay; where a single crease ends, see `dart_masks`.

    Args:
        topology: of the mesh.
        scheme: one that `has_loop_limit`.
        creases: of the mesh, if it has any; all of them smooth or sharp for ever.

    Raises:
        MeshError: the mesh is not an oriented manifold.
        SchemeError: the scheme has another limit, or a crease is still to wear off.
    """
    ring, sharp = ring_of_limit(scheme), sharp_for_ever(topology, creases)
    rules = (Creases.of(topology) if creases is None else creases).rules(topology)
    n, valence = topology.num_verts, topology.valence.clip(min=1)
    ring_of = np.array([1.0, *(ring(k) for k in range(1, int(valence.max(initial=0)) + 1))])
    beta = ring_of[valence] / valence
    on_curve, stays = rules.crease == 1, rules.corner == 1
    share = np.where(on_curve, 1 / 6, 1 / (valence + 3 / (8 * beta)))
    kept = np.where(stays, 1.0, np.where(on_curve, 4 / 6, 1 - valence * share))
    rows, columns = np.concatenate([topology.edges, topology.edges[:, ::-1]]).T
    counts = ~stays[rows] & (~on_curve[rows] | np.tile(sharp, 2))
    neighbours = coo_array((share[rows[counts]], (rows[counts], columns[counts])), shape=(n, n))
    limit = csr_array(diags_array(kept) + neighbours)
    darts = [sheets for sheets in sheets_of(topology, sharp) if sheets.is_dart]
    return _with_darts(limit, darts, ring, stays) if darts else limit


def ring_of_limit(scheme: Scheme) -> Callable[[int], float]:
    """What a scheme gives to the ring of an old vertex, if `loop_limit` knows its limit.

    Raises:
        SchemeError: it does not.
    """
    if not isinstance(scheme, TriangleScheme) or scheme.vert is None or not has_loop_limit(scheme):
        raise SchemeError("limit positions and normals are known for loop only")
    return scheme.vert.ring


def sharp_for_ever(topology: Topology, creases: Creases | None) -> Mask:
    """(E,) which edges stay sharp, those of the boundary among them.

    Raises:
        MeshError: the mesh is not an oriented manifold, or the creases are of another one.
        SchemeError: no limit is known, since a crease is still to wear off.
    """
    require_manifold(topology, "the limit surface")
    if creases is None:
        return topology.boundary_edges
    require_creases(creases, topology)
    sharpness = creases.sharpness_on(topology)
    left = sharpness[(sharpness > 0) & ~np.isinf(sharpness)]
    if len(left):
        more = int(np.ceil(left.max()))
        raise SchemeError(
            f"limits are known where creases are smooth or sharp for ever: a sharpness of {left.max():g} is left; "
            f"refine {more} {'level' if more == 1 else 'levels'} more"
        )
    return np.asarray(np.isinf(sharpness))


def _with_darts(limit: csr_array, darts: list[Sheets], ring: Callable[[int], float], stays: Mask) -> csr_array:
    """The limit positions with those rows replaced at which a crease ends."""
    rows, columns, weights = [], [], []
    for sheets in darts:
        moved = ~stays[sheets.vert]
        at = np.concatenate([sheets.vert[moved, None], sheets.ring[moved]], axis=1)
        size = sheets.ring.shape[1]
        rows.append(np.repeat(sheets.vert[moved], size + 1))
        columns.append(at.reshape(-1))
        weights.append(np.tile(dart_masks(size, ring(size))[0], len(at)))
    row = np.concatenate(rows)
    others = np.ones(limit.shape[0])
    others[row] = 0.0
    own = coo_array((np.concatenate(weights), (row, np.concatenate(columns))), shape=limit.shape)
    replaced = csr_array(diags_array(others) @ limit + own)
    replaced.eliminate_zeros()
    return replaced
