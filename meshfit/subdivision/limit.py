"""Limit masks of Loop subdivision at one vertex: weights of itself, then of its neighbours counter-clockwise.

All are left eigenvectors of the matrix that refines a vertex and its ring: of eigenvalue 1 for the limit position, of
the two that follow for a pair of tangents.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi

import numpy as np
from jaxtyping import Float64
from scipy.sparse import coo_array, csr_array, diags_array

from meshfit.errors import SchemeError
from meshfit.mesh.geometry import corner_angles, face_normals, unit_vectors
from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Indices, Mask, Topology
from meshfit.subdivision.creases import Creases, Sectors, require_matching_creases, sectors_of
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.triangles.scheme import TriangleScheme
from meshfit.subdivision.triangles.table import LOOP

Tangents = Float64[np.ndarray, "2 K"]


def smooth_tangents(n: int) -> Tangents:
    """At an inner vertex of valence n: cosines and sines of its spokes (Hoppe et al. 1994)."""
    angles = 2 * pi * np.arange(n) / n
    return np.stack([np.append(0.0, np.cos(angles)), np.append(0.0, np.sin(angles))])


def open_tangents(k: int) -> Tangents:
    """Along and across a boundary or crease, on the side of k neighbours of which the first and last lie on it.

    With θ = π / (k - 1) and the eigenvalue λ = 3/8 + cos(θ) / 4, the neighbours between have sin(iθ) across, their sum
    being s; the two on the curve have w = ((3/4 - λ) sin θ - 3/8 s) / (8 (λ - 1/2) (3/4 - λ) + 1), and the vertex
    8 (λ - 1/2) w - sin θ.
    """
    along, across = np.zeros(k + 1), np.zeros(k + 1)
    along[[1, -1]] = 1.0, -1.0
    if k == 2:
        across[:] = -2.0, 1.0, 1.0
        return np.stack([along, across])
    turn = pi / (k - 1)
    eigenvalue = 3 / 8 + cos(turn) / 4
    between = np.sin(turn * np.arange(1, k - 1))
    end = ((3 / 4 - eigenvalue) * between[0] - 3 / 8 * between.sum()) / (
        8 * (eigenvalue - 1 / 2) * (3 / 4 - eigenvalue) + 1
    )
    across[:] = 8 * (eigenvalue - 1 / 2) * end - between[0], end, *between, end
    return np.stack([along, across])


def dart_masks(n: int, ring: float) -> Float64[np.ndarray, "3 K"]:
    """Of an inner vertex at which one crease ends, along its first spoke: limit position, and two tangents.

    The midpoint on the sharp edge moves the limit from where it would be if all spokes were smooth. The tangent across
    stays that of sines; the position and the tangent along are even in the spokes, and found among the eigenvectors
    that are.

    Args:
        n: its valence.
        ring: what the vertex rule gives to the ring's mean.
    """
    even = np.zeros((n + 1, n // 2 + 2))
    even[0, 0] = 1.0
    for spoke in range(n):
        even[1 + spoke, 1 + min(spoke, n - spoke)] = 1.0
    even /= np.linalg.norm(even, axis=0)
    values, vectors = np.linalg.eig(even.T @ _dart_matrix(n, ring).T @ even)
    position, along = (even @ vectors.T[np.argsort(-values.real)[:2]].real.T).T
    _, across = smooth_tangents(n)
    return np.stack([position / position.sum(), along * np.sign(along[1]), across])


def _dart_matrix(n: int, ring: float) -> Float64[np.ndarray, "K K"]:
    """What one level makes of the vertex and its ring."""
    matrix = np.zeros((n + 1, n + 1))
    matrix[0] = 1 - ring, *[ring / n] * n
    for spoke in range(1, n):
        matrix[1 + spoke, [0, 1 + spoke]] = 3 / 8
        for wing in (spoke - 1, (spoke + 1) % n):
            matrix[1 + spoke, 1 + wing] += 1 / 8
    matrix[1, :2] = 1 / 2
    return matrix


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
    ring, sharp = ring_of_limit(scheme), permanently_sharp(topology, creases)
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
    darts = [sheets for sheets in sectors_of(topology, sharp) if sheets.is_dart]
    return _with_darts(limit, darts, ring, stays) if darts else limit


def ring_of_limit(scheme: Scheme) -> Callable[[int], float]:
    """What a scheme gives to the ring of an old vertex, if `loop_limit` knows its limit.

    Raises:
        SchemeError: it does not.
    """
    if not isinstance(scheme, TriangleScheme) or scheme.vert is None or not has_loop_limit(scheme):
        raise SchemeError("limit positions and normals are known for loop only")
    return scheme.vert.ring


def permanently_sharp(topology: Topology, creases: Creases | None) -> Mask:
    """(E,) which edges stay sharp, those of the boundary among them.

    Raises:
        MeshError: the mesh is not an oriented manifold, or the creases are of another one.
        SchemeError: no limit is known, since a crease is still to wear off.
    """
    require_manifold(topology, "the limit surface")
    if creases is None:
        return topology.boundary_edges
    require_matching_creases(creases, topology)
    sharpness = creases.sharpness_on(topology)
    left = sharpness[(sharpness > 0) & ~np.isinf(sharpness)]
    if len(left):
        more = int(np.ceil(left.max()))
        raise SchemeError(
            f"limits are known where creases are smooth or sharp for ever: a sharpness of {left.max():g} is left; "
            f"refine {more} {'level' if more == 1 else 'levels'} more"
        )
    return np.asarray(np.isinf(sharpness))


def _with_darts(limit: csr_array, darts: list[Sectors], ring: Callable[[int], float], stays: Mask) -> csr_array:
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


# Of unit tangents; what is nearer to one line spans no plane.
_FLAT = 1e-12


@dataclass(frozen=True, eq=False)
class LimitTangents:
    """Two tangents of the limit surface for each sheet that comes to a vertex, of no particular length.

    Attributes:
        vert: (S,) the vertex of each sheet: twice for those on a crease, once for all others but corners.
        along: (S, V) operator from verts to one tangent, which follows the boundary or crease if there is one.
        across: (S, V) to the other; along × across points outwards.
    """

    vert: Indices
    along: csr_array
    across: csr_array


def loop_limit_tangents(topology: Topology, scheme: Scheme = LOOP, creases: Creases | None = None) -> LimitTangents:
    """The tangents of Loop's limit surface. Corners have none; there the surface ends in a point like a cone's.

    Args:
        topology: of the mesh.
        scheme: one that `has_loop_limit`.
        creases: as for `loop_limit`.

    Raises:
        MeshError, SchemeError: as `loop_limit`.
    """
    ring_weight, sharp = ring_of_limit(scheme), permanently_sharp(topology, creases)
    stays = (Creases.of(topology) if creases is None else creases).rules(topology).corner == 1
    nothing = np.empty(0, dtype=np.int64)
    verts, entries, count = [nothing], [[nothing] * 4], 0
    for sheets in sectors_of(topology, sharp):
        ring, vert = sheets.ring[~stays[sheets.vert]], sheets.vert[~stays[sheets.vert]]
        if not len(vert):
            continue
        masks = _tangent_masks(sheets, ring_weight)
        columns = np.concatenate([vert[:, None], ring], axis=1)
        rows = np.broadcast_to(count + np.arange(len(vert))[:, None], columns.shape)
        weights = (np.broadcast_to(mask, columns.shape) for mask in masks)
        entries.append([part.reshape(-1) for part in (rows, columns, *weights)])
        verts.append(vert)
        count += len(vert)
    row, column, *both = (np.concatenate(part) for part in zip(*entries, strict=True))
    shape = (count, topology.num_verts)
    along, across = (csr_array(coo_array((weights, (row, column)), shape=shape)) for weights in both)
    return LimitTangents(np.concatenate(verts), along, across)


def loop_limit_normals(mesh: Mesh, scheme: Scheme = LOOP, creases: Creases | None = None) -> Float64[np.ndarray, "V 3"]:
    """Unit normals of Loop's limit surface at the limit of each vertex, outwards where the faces are oriented so.

    Where a crease parts the surface, it has a normal on either side; the direction of their mean is returned. At a
    corner there may be no tangent plane at all; there it is the mean of the normals of the faces around, each weighted
    by its angle. Loop's surface is not smooth where a boundary or crease has 7 neighbours or more on one side; what is
    returned there is the normal to the two tangents. Rows are 0 at verts without faces, and where the tangents lie on
    one line.

    Args:
        mesh: the control mesh.
        scheme: one that `has_loop_limit`.
        creases: as for `loop_limit`.

    Raises:
        MeshError, SchemeError: as `loop_limit`.
    """
    topology = Topology.of(mesh)
    tangents = loop_limit_tangents(topology, scheme, creases)
    size = float(np.abs(mesh.verts).max(initial=0.0))
    mesh = Mesh(mesh.verts / (size or 1.0), mesh.faces)  # so that squares neither overflow nor vanish
    along, across = (unit_vectors(np.asarray(each @ mesh.verts)) for each in (tangents.along, tangents.across))
    normal = np.cross(along, across)
    normal[np.linalg.norm(normal, axis=1) < _FLAT] = 0.0
    total = np.zeros_like(mesh.verts)
    np.add.at(total, tangents.vert, unit_vectors(normal))
    corners = np.ones(mesh.num_verts, dtype=bool)
    corners[tangents.vert] = False
    around = corner_angles(mesh)[:, :, None] * face_normals(mesh)[:, None, :]
    at_corner = corners[mesh.faces]
    np.add.at(total, mesh.faces[at_corner], around[at_corner])
    return unit_vectors(total)


def _tangent_masks(sheets: Sectors, ring: Callable[[int], float]) -> Tangents:
    size = sheets.ring.shape[1]
    if sheets.is_open:
        return open_tangents(size)
    return dart_masks(size, ring(size))[1:] if sheets.is_dart else smooth_tangents(size)
