"""Limit positions, tangents and normals of Loop subdivision.

A limit mask holds the weights of a vertex, then of its neighbours counter-clockwise. It is a left eigenvector of the
matrix that refines a vertex and its ring: of eigenvalue 1 for the limit position, of the next two for a pair of
tangents. Creases part the surface around a vertex into sectors, each with tangents of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import cos, pi

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import coo_array, csr_array, diags_array

from meshfit.doors import no_type_check
from meshfit.errors import SchemeError
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.attributes import Values
from meshfit.mesh.geometry import corner_angles, face_normals, unit_vectors
from meshfit.mesh.interpolation import interpolated, interpolated_rows
from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.seams import at_verts
from meshfit.mesh.topology import NONE, Indices, Mask, Topology
from meshfit.subdivision.attributes import Chart
from meshfit.subdivision.creases import Creases, require_matching_creases
from meshfit.subdivision.registry import Scheme, resolve
from meshfit.subdivision.triangles.assemble import ring_weights
from meshfit.subdivision.triangles.scheme import TriangleScheme, VertMask
from meshfit.subdivision.triangles.table import LOOP

Tangents = Float64[np.ndarray, "2 K"]
_COLLINEAR = 1e-12  # sine of the angle between unit tangents below which they span no plane


@no_type_check
def _topology(thing: "Topology | MeshLike") -> Topology:
    return thing if isinstance(thing, Topology) else Topology.of(as_mesh(thing, triangles=True))


def smooth_tangents(n: int) -> Tangents:
    """Tangent masks at an inner vertex of valence n: cosines and sines of its spokes (Hoppe et al. 1994)."""
    angles = 2 * pi * np.arange(n) / n
    return np.stack([np.append(0.0, np.cos(angles)), np.append(0.0, np.sin(angles))])


def open_tangents(k: int) -> Tangents:
    """Tangent masks along and across a boundary or crease, of a sector of k neighbours, first and last on the curve.

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
    """Masks of an inner vertex at which a single crease ends, along its first spoke: limit position and two tangents.

    The midpoint on the sharp edge moves the limit. The tangent across keeps the sines of the smooth rule; the position
    and the tangent along are even in the spokes, so only even eigenvectors are searched.

    Args:
        n: its valence.
        ring: the weight of the ring's mean in the vertex rule.
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
    """Matrix that refines a dart vertex and its ring."""
    matrix = np.zeros((n + 1, n + 1))
    matrix[0] = 1 - ring, *[ring / n] * n
    for spoke in range(1, n):
        matrix[1 + spoke, [0, 1 + spoke]] = 3 / 8
        for wing in (spoke - 1, (spoke + 1) % n):
            matrix[1 + spoke, 1 + wing] += 1 / 8
    matrix[1, :2] = 1 / 2
    return matrix


@dataclass(frozen=True, eq=False)
class Sectors:
    """Sectors of the surface around S vertices, all of one size and kind.

    Attributes:
        vert: (S,) the vertex of each sector.
        ring: (S, K) its neighbours counter-clockwise. The first of a dart is on its crease; the first and last of an
            open sector are on the sharp or boundary edges that bound it.
        is_open: whether two edges bound the sector; if not, it goes once around its vertex.
        is_dart: whether it begins and ends at the same sharp edge.
    """

    vert: Indices
    ring: Int64[np.ndarray, "S K"]
    is_open: bool
    is_dart: bool


def sectors_of(topology: Topology, sharp: Mask) -> Iterator[Sectors]:
    """Group all sectors by size and kind.

    Args:
        topology: an oriented manifold.
        sharp: (E,) edges that separate sectors, boundary edges included.
    """
    starts = _starts(topology, sharp)
    rings, size = _walk(topology, sharp, starts)
    back = rings[np.arange(len(starts)), size - 1] == rings[:, 0]
    dart = back & sharp[topology.edge_of[starts]]
    length = size - back
    for closed, of_dart, k in sorted(set(zip(back.tolist(), dart.tolist(), length.tolist(), strict=True))):
        chosen = (back == closed) & (dart == of_dart) & (length == k)
        yield Sectors(topology.tail[starts[chosen]], rings[chosen, :k], is_open=not closed, is_dart=of_dart)


def _starts(topology: Topology, sharp: Mask) -> Indices:
    """Return the first half-edge of each sector: all on sharp edges, and one out of each vertex that has none."""
    at_sharp = np.zeros(topology.num_verts, dtype=bool)
    at_sharp[topology.edges[sharp].reshape(-1)] = True
    verts, first = np.unique(topology.tail, return_index=True)
    return np.concatenate([np.flatnonzero(sharp[topology.edge_of]), first[~at_sharp[verts]]])


def _walk(topology: Topology, sharp: Mask, starts: Indices) -> tuple[Int64[np.ndarray, "S M"], Indices]:
    """Return the neighbours from each start until a sharp edge or the start is reached, and their number."""
    columns, size = [topology.head[starts]], np.ones(len(starts), dtype=np.int64)
    halfedge, active = starts.copy(), np.arange(len(starts))
    while len(active):
        column = np.full(len(starts), NONE, dtype=np.int64)
        column[active] = topology.apex[halfedge]
        columns.append(column)
        size[active] += 1
        following = topology.next_around_tail(halfedge)
        continues = (following != NONE) & (following != starts[active]) & ~sharp[topology.edge_of[following]]
        halfedge, active = following[continues], active[continues]
    return np.stack(columns, axis=1), size


def has_loop_limit(scheme: Scheme) -> bool:
    """Return whether `loop_limit` knows the limit of a scheme: Loop's masks, with any weights of old inner vertices."""
    if not isinstance(scheme, TriangleScheme) or scheme.vert is None or scheme.alpha is not None or scheme.spokes:
        return False
    return (scheme.split, scheme.inserted, scheme.boundary) == (LOOP.split, LOOP.inserted, LOOP.boundary)


@no_type_check
def loop_limit(
    topology: "Topology | MeshLike", scheme: str | Scheme = LOOP, creases: Creases | None = None
) -> csr_array:
    """Return the (V, V) operator that takes vertices to their limit positions under Loop subdivision.

    An inner vertex v with n neighbours of sum Σ goes to (1 - n χ) v + χ Σ, χ = 1 / (n + 3 / (8 β)), where n β is the
    weight of the ring in the scheme (Loop 1987). A vertex on the boundary or a crease goes to (l + 4 v + r) / 6, as
    for the cubic B-spline. Corners and vertices without faces stay. For the end of a single crease see `dart_masks`.

    Args:
        topology: of the mesh, or the mesh in any form that `as_mesh` takes.
        scheme: one that `has_loop_limit`, or its spec.
        creases: of the mesh, if it has any; all edges smooth or permanently sharp.

    Example:
        >>> import meshfit
        >>> mesh = meshfit.as_mesh("icosahedron")
        >>> mesh.with_verts(meshfit.loop_limit(mesh) @ mesh.verts)
        Mesh(12 verts, 20 faces, box 1.204 × 1.204 × 1.204)

    Raises:
        MeshError: the mesh is not an oriented manifold.
        SchemeError: the scheme has another limit, or a crease has finite sharpness left.
    """
    topology, scheme = _topology(topology), resolve(scheme)
    mask, sharp = _vert_mask(scheme), _permanently_sharp(topology, creases)
    rules = (Creases.of(topology) if creases is None else creases).rules(topology)
    n, valence = topology.num_verts, topology.valence.clip(min=1)
    beta = ring_weights(topology, mask) / valence
    on_curve, stays = rules.crease == 1, rules.corner == 1
    with np.errstate(divide="ignore"):  # where β is 0, so is χ, and the vertex stays
        share = np.where(on_curve, 1 / 6, 1 / (valence + 3 / (8 * beta)))
    kept = np.where(stays, 1.0, np.where(on_curve, 4 / 6, 1 - valence * share))
    rows, columns = np.concatenate([topology.edges, topology.edges[:, ::-1]]).T
    counts = ~stays[rows] & (~on_curve[rows] | np.tile(sharp, 2))
    neighbours = coo_array((share[rows[counts]], (rows[counts], columns[counts])), shape=(n, n))
    limit = csr_array(diags_array(kept) + neighbours)
    darts = [sectors for sectors in sectors_of(topology, sharp) if sectors.is_dart]
    return _with_darts(limit, darts, mask, stays) if darts else limit


def on_loop_limit(mesh: Mesh, scheme: str | Scheme = LOOP, creases: Creases | None = None) -> Mesh:
    """Return a mesh with its vertices, and their attributes, on the limit surface of `loop_limit`.

    Corner data take the limit of their charts; at seams they stay.

    Raises:
        MeshError, SchemeError: as `loop_limit`.
    """
    topology, declared = Topology.of(mesh), resolve(scheme)
    operator = loop_limit(topology, declared, creases)
    attributes, corner = mesh.attributes, dict[str, Values]()
    for name, values in attributes.corner.items():
        chart = Chart.of(topology, values)
        if chart is None:
            corner[name] = interpolated(name, at_verts(topology, values), [operator])[topology.tail]
            continue
        assert isinstance(chart.topology, Topology)  # noqa: S101  as the mesh's
        seam = np.zeros(chart.topology.num_verts, dtype=bool)
        on_seam = chart.on_seams(topology)
        seam[chart.topology.tail[on_seam]] = seam[chart.topology.head[on_seam]] = True
        limit = loop_limit(chart.topology, declared, chart.creases(topology, creases))
        limit = csr_array(diags_array(~seam * 1.0) @ limit + diags_array(seam * 1.0))
        corner[name] = interpolated(name, values[chart.first], [limit])[chart.topology.tail]
    vertex = interpolated_rows(attributes.vertex, [operator])
    return Mesh(operator @ mesh.verts, mesh.faces, replace(attributes, vertex=vertex, corner=corner))


def _vert_mask(scheme: Scheme) -> VertMask:
    """Return the mask of old vertices of a scheme that `has_loop_limit`."""
    if not isinstance(scheme, TriangleScheme) or scheme.vert is None or not has_loop_limit(scheme):
        raise SchemeError("limit positions and normals are known for loop only")
    return scheme.vert


@no_type_check
def _permanently_sharp(topology: Topology, creases: Creases | None) -> Mask:
    """Return the (E,) mask of edges that stay sharp, boundary edges included."""
    require_manifold(topology, "the limit surface")
    if creases is None:
        return topology.boundary_edges
    require_matching_creases(creases, topology)
    sharpness = creases.sharpness_on(topology)
    left = sharpness[(sharpness > 0) & ~np.isinf(sharpness)]
    if len(left):
        more = int(np.ceil(left.max()))
        raise SchemeError(
            f"limits are known where creases are smooth or permanently sharp: a sharpness of {left.max():g} is left; "
            f"refine {more} {'level' if more == 1 else 'levels'} more"
        )
    return np.asarray(np.isinf(sharpness))


def _with_darts(limit: csr_array, darts: list[Sectors], mask: VertMask, stays: Mask) -> csr_array:
    """Replace the rows of limit positions of vertices at which a single crease ends."""
    rows, columns, weights = [], [], []
    for sectors in darts:
        moved = ~stays[sectors.vert]
        at = np.concatenate([sectors.vert[moved, None], sectors.ring[moved]], axis=1)
        size = sectors.ring.shape[1]
        rows.append(np.repeat(sectors.vert[moved], size + 1))
        columns.append(at.reshape(-1))
        weights.append(np.tile(dart_masks(size, mask.ring(size))[0], len(at)))
    row = np.concatenate(rows)
    others = np.ones(limit.shape[0])
    others[row] = 0.0
    own = coo_array((np.concatenate(weights), (row, np.concatenate(columns))), shape=limit.shape)
    replaced = csr_array(diags_array(others) @ limit + own)
    replaced.eliminate_zeros()
    return replaced


@dataclass(frozen=True, eq=False)
class LimitTangents:
    """Two tangents of the limit surface for each sector, of no particular length.

    Attributes:
        vert: (S,) the vertex of each sector: two sectors on a crease, none at corners, one elsewhere.
        along: (S, V) operator from vertices to one tangent, which follows the boundary or crease if there is one.
        across: (S, V) operator to the other tangent; along × across points outwards.
    """

    vert: Indices
    along: csr_array
    across: csr_array


@no_type_check
def loop_limit_tangents(topology: Topology, scheme: Scheme = LOOP, creases: Creases | None = None) -> LimitTangents:
    """Return the tangents of Loop's limit surface. Corners have none, since the surface is pointed there.

    Args:
        topology: of the mesh.
        scheme: one that `has_loop_limit`.
        creases: as for `loop_limit`.

    Raises:
        MeshError, SchemeError: as `loop_limit`.
    """
    vert_mask, sharp = _vert_mask(scheme), _permanently_sharp(topology, creases)
    stays = (Creases.of(topology) if creases is None else creases).rules(topology).corner == 1
    nothing = np.empty(0, dtype=np.int64)
    verts, entries, count = [nothing], [[nothing] * 4], 0
    for sectors in sectors_of(topology, sharp):
        ring, vert = sectors.ring[~stays[sectors.vert]], sectors.vert[~stays[sectors.vert]]
        if not len(vert):
            continue
        masks = _tangent_masks(sectors, vert_mask)
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


@no_type_check
def loop_limit_normals(
    mesh: "MeshLike", scheme: str | Scheme = LOOP, creases: Creases | None = None
) -> Float64[np.ndarray, "V 3"]:
    """Return unit normals of Loop's limit surface at the limit of each vertex, on the side that the faces point to.

    On a crease it is the mean of the normals of both sides. At a corner, where there may be no tangent plane, it is the
    mean of the normals of the surrounding faces, weighted by angle. Loop's surface is not smooth where a boundary or
    crease has 7 neighbours or more on one side; there it is the normal to the two tangents. Rows are 0 at vertices
    without faces, and where the tangents are collinear.

    Args:
        mesh: the control mesh, in any form that `as_mesh` takes.
        scheme: one that `has_loop_limit`, or its spec.
        creases: as for `loop_limit`.

    Example:
        >>> import meshfit
        >>> meshfit.loop_limit_normals("octahedron").round(3)[0].tolist()
        [1.0, 0.0, 0.0]

    Raises:
        MeshError, SchemeError: as `loop_limit`.
    """
    mesh, scheme = mesh if isinstance(mesh, Mesh) else as_mesh(mesh, triangles=True), resolve(scheme)
    topology = Topology.of(mesh)
    tangents = loop_limit_tangents(topology, scheme, creases)
    size = float(np.abs(mesh.verts).max(initial=0.0))
    mesh = Mesh(mesh.verts / (size or 1.0), mesh.faces)  # squares must neither overflow nor underflow
    along, across = (unit_vectors(np.asarray(tangent @ mesh.verts)) for tangent in (tangents.along, tangents.across))
    normal = np.cross(along, across)
    normal[np.linalg.norm(normal, axis=1) < _COLLINEAR] = 0.0
    total = np.zeros_like(mesh.verts)
    np.add.at(total, tangents.vert, unit_vectors(normal))
    corners = np.ones(mesh.num_verts, dtype=bool)
    corners[tangents.vert] = False
    around = corner_angles(mesh)[:, :, None] * face_normals(mesh)[:, None, :]
    at_corner = corners[mesh.faces]
    np.add.at(total, mesh.faces[at_corner], around[at_corner])
    return unit_vectors(total)


def _tangent_masks(sectors: Sectors, mask: VertMask) -> Tangents:
    size = sectors.ring.shape[1]
    if sectors.is_open:
        return open_tangents(size)
    return dart_masks(size, mask.ring(size))[1:] if sectors.is_dart else smooth_tangents(size)
