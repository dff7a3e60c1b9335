"""Assembler of schemes on triangles: masks laid down on a topology as a sparse operator."""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import csr_array, diags_array, eye_array, vstack

from meshfit.mesh.topology import NONE, Indices, Mask, Topology, next_in_face, previous_in_face
from meshfit.subdivision.creases import Creases, SharpRules
from meshfit.subdivision.masks import CurveMask, Weight
from meshfit.subdivision.push_back import push_back
from meshfit.subdivision.stencils import StencilRows
from meshfit.subdivision.triangles.scheme import EdgeMask, FaceMask, SpokeMask, TriangleScheme, VertMask
from meshfit.subdivision.triangles.splits import Division

REGULAR_VALENCE = 6


class _Stencils(StencilRows):
    """Entries over the vertices of one topology, by their roles around an edge or face."""

    def __init__(self, topology: Topology) -> None:
        super().__init__(topology.num_verts)
        self.topology = topology

    def add_beyond(self, rows: Indices, halfedge: Indices, weight: Weight) -> None:
        """Add the vertex across each half-edge; beyond the boundary, the apex of its own face, mirrored in the edge.

        The mirror image, tail + head - apex, completes a parallelogram, so that linear functions stay exact.
        """
        topology, twin = self.topology, self.topology.twin[halfedge]
        inner = twin != NONE
        self.add(rows[inner], topology.apex[twin[inner]], weight)
        outer, edge = rows[~inner], halfedge[~inner]
        self.add(outer, topology.tail[edge], weight)
        self.add(outer, topology.head[edge], weight)
        self.add(outer, topology.apex[edge], -weight)

    def add_wings(self, rows: Indices, halfedge: Indices, weight: Weight) -> None:
        """Add the two vertices beyond the other edges of the face across each half-edge, mirrored at the boundary."""
        topology, twin = self.topology, self.topology.twin[halfedge]
        inner = twin != NONE
        for other in (next_in_face, previous_in_face):
            self.add_beyond(rows[inner], other(twin[inner]), weight)
        # Mirrored in the boundary edge (x, y) with apex o, the neighbour's own neighbours are 2x - o and 2y - o.
        outer, edge = rows[~inner], halfedge[~inner]
        for end in (topology.tail, topology.head):
            self.add(outer, end[edge], 2 * weight)
            self.add(outer, topology.apex[edge], -weight)

    def add_spokes(self, rows: Indices, halfedge: Indices, mask: SpokeMask, share: np.ndarray) -> None:
        """Add the interior vertex at the tail of each half-edge and its one-ring, with spoke 0 along the half-edge."""
        topology = self.topology
        valence = topology.valence[topology.tail[halfedge]]
        for n in np.unique(valence):
            chosen = valence == n
            centre, *ring = mask.weights(int(n))
            row, part, spoke = rows[chosen], share[chosen], halfedge[chosen]
            self.add(row, topology.tail[spoke], centre * part)
            for weight in ring:
                self.add(row, topology.head[spoke], weight * part)
                spoke = topology.next_around_tail(spoke)


def assemble(
    topology: Topology, scheme: TriangleScheme, division: Division, creases: Creases | None = None
) -> csr_array:
    """Return the operator S of one level: verts_fine = S verts_coarse, old vertices first.

    Args:
        topology: the coarse connectivity, an oriented manifold; vertices without faces stay where they are.
        scheme: the masks.
        division: of the topology, from `divide`.
        creases: sharp edges and corners, for schemes that take them.

    Returns:
        Sparse (V + N, V) float64; its rows sum to one.
    """
    even = _old_verts(topology, scheme, division)
    odd = _new_verts(topology, scheme, division)
    rules = None if creases is None else creases.rules(topology)
    if rules is not None:
        even, odd = _sharpened(topology, scheme.boundary, rules, even, odd)
    if scheme.alpha is not None:
        even, odd = _push_back(topology, scheme, division, rules, even, odd)
    return csr_array(vstack([even, odd], format="csr"))


def _old_verts(topology: Topology, scheme: TriangleScheme, division: Division) -> csr_array:
    if scheme.vert is None:
        return csr_array(eye_array(topology.num_verts, format="csr"))
    stencils = _Stencils(topology)
    on_border = topology.boundary_verts
    ring = ring_weights(topology, scheme.vert)
    moved = on_border if division.moves_border else np.zeros_like(on_border)
    still = np.flatnonzero(~moved)
    stencils.add(still, still, 1 - ring[still])
    inner = np.flatnonzero(~on_border[topology.tail])
    tail = topology.tail[inner]
    stencils.add(tail, topology.head[inner], ring[tail] / topology.valence[tail])
    border = np.flatnonzero(moved)
    before, after = topology.boundary_neighbours[border].T
    stencils.add_curve(border, {-1: before, 0: border, 1: after}, scheme.boundary.vert)
    return stencils.operator(topology.num_verts)


def ring_weights(topology: Topology, mask: VertMask) -> Float64[np.ndarray, " V"]:
    """Return the (V,) weight of the one-ring of each inner vertex, computed only at valences that occur; else 0."""
    inner = np.flatnonzero(~topology.boundary_verts & (topology.valence > 0))
    valences, place = np.unique(topology.valence[inner], return_inverse=True)
    weights = np.zeros(topology.num_verts)
    weights[inner] = np.array([mask.ring(int(valence)) for valence in valences], dtype=np.float64)[place]
    return weights


def _new_verts(
    topology: Topology, scheme: TriangleScheme, division: Division, on_curve: Mask | None = None
) -> csr_array:
    stencils = _Stencils(topology)
    curved = topology.boundary_verts if on_curve is None else on_curve
    rows, halfedge = division.inner_place, division.inner
    regular = np.ones(len(rows), dtype=bool)
    if scheme.spokes is not None:
        tips = _tips(topology, scheme.inserted, halfedge)
        ends = topology.tail[tips]
        extraordinary = (topology.valence[ends] != REGULAR_VALENCE) & ~curved[ends]
        count = extraordinary.sum(axis=0)
        regular = count == 0
        for tip, chosen in zip(tips, extraordinary, strict=True):
            stencils.add_spokes(rows[chosen], tip[chosen], scheme.spokes, 1 / count[chosen])
    _add_regular(stencils, scheme.inserted, rows[regular], halfedge[regular])
    _add_border(stencils, scheme, division)
    return stencils.operator(division.num_new)


def _tips(topology: Topology, mask: EdgeMask | FaceMask, halfedge: Indices) -> Int64[np.ndarray, "K N"]:
    """(K, N) the half-edges whose tails are the ends of each edge (K = 2), or the corners of each face (K = 3)."""
    if isinstance(mask, EdgeMask):
        return np.stack([halfedge, topology.twin[halfedge]])
    return np.stack([halfedge, next_in_face(halfedge), previous_in_face(halfedge)])


def _add_regular(stencils: _Stencils, mask: EdgeMask | FaceMask, rows: Indices, halfedge: Indices) -> None:
    topology = stencils.topology
    tips = _tips(topology, mask, halfedge)
    if isinstance(mask, EdgeMask):
        for tip in tips:
            stencils.add(rows, topology.tail[tip], mask.end)
            stencils.add(rows, topology.apex[tip], mask.opposite)
            if mask.wing:
                stencils.add_beyond(rows, next_in_face(tip), mask.wing)
                stencils.add_beyond(rows, previous_in_face(tip), mask.wing)
        return
    for tip in tips:
        stencils.add(rows, topology.tail[tip], mask.corner)
        if mask.across:
            stencils.add_beyond(rows, tip, mask.across)
        if mask.wing:
            stencils.add_wings(rows, tip, mask.wing)


def _add_border(stencils: _Stencils, scheme: TriangleScheme, division: Division) -> None:
    topology, border = stencils.topology, division.border
    tail, head = topology.tail[border], topology.head[border]
    neighbours = topology.boundary_neighbours
    along = {-1: neighbours[tail, 0], 0: tail, 1: head, 2: neighbours[head, 1]}
    for place, weights in zip(division.border_place, scheme.boundary.inserted, strict=True):
        stencils.add_curve(place, along, weights)


def _sharpened(
    topology: Topology, boundary: CurveMask, rules: SharpRules, even: csr_array, odd: csr_array
) -> tuple[csr_array, csr_array]:
    """Blend the operators of a 1-to-4 split with the boundary rule along creases, by their shares."""
    bent, cut = _Stencils(topology), _Stencils(topology)
    along = np.flatnonzero(rules.crease)
    before, after = rules.pair[along].T
    bent.add_curve(along, {-1: before, 0: along, 1: after}, boundary.vert)
    edges = np.arange(topology.num_edges)
    cut.add_curve(edges, dict(enumerate(topology.edges.T)), boundary.inserted[0])
    old = diags_array(rules.smooth) @ even + diags_array(rules.crease) @ bent.operator(topology.num_verts)
    new = diags_array(1 - rules.edge) @ odd + diags_array(rules.edge) @ cut.operator(topology.num_edges)
    operators = csr_array(old + diags_array(rules.corner)), csr_array(new)
    for operator in operators:
        operator.eliminate_zeros()
    return operators


def _push_back(
    topology: Topology,
    scheme: TriangleScheme,
    division: Division,
    rules: SharpRules | None,
    even: csr_array,
    odd: csr_array,
) -> tuple[csr_array, csr_array]:
    assert scheme.alpha is not None  # noqa: S101  the caller has checked it
    linear = linear_interpolation(topology, division)
    old, new = push_back(scheme.alpha, linear, even, odd)
    if scheme.at_valence3 is not None:
        smooth = ~topology.boundary_verts * 1.0 if rules is None else rules.smooth
        safe = _new_verts(topology, scheme.at_valence3, division, smooth < 1)
        share = _touches_valence3(topology, division, smooth)
        share = share if rules is None else share * (1 - rules.edge)
        alpha = np.broadcast_to(np.asarray(scheme.alpha, dtype=np.float64), (topology.num_verts,))
        blend = share * (linear @ alpha)
        new = diags_array(1 - share) @ new + diags_array(share - blend) @ odd + diags_array(blend) @ safe
    return old, csr_array(new)


def _touches_valence3(topology: Topology, division: Division, smooth: np.ndarray) -> np.ndarray:
    """(N,) the largest share of the smooth rule at ends of valence 3."""
    share = np.zeros(division.num_new)
    ends = np.stack([topology.tail[division.inner], topology.head[division.inner]])
    share[division.inner_place] = np.where(topology.valence[ends] == 3, smooth[ends], 0.0).max(axis=0)
    return share


def linear_interpolation(topology: Topology, division: Division) -> csr_array:
    """Return the (N, V) operator that puts each new vertex midway between the old ones around it."""
    stencils = _Stencils(topology)
    rows, halfedge = division.inner_place, division.inner
    sides = (topology.tail, topology.head) if len(division.border_place) == 1 else ()
    for side in sides:
        stencils.add(rows, side[halfedge], 1 / 2)
    if not sides:
        for tip in (halfedge, next_in_face(halfedge), previous_in_face(halfedge)):
            stencils.add(rows, topology.tail[tip], 1 / 3)
    parts = len(division.border_place) + 1
    for i, place in enumerate(division.border_place, start=1):
        stencils.add(place, topology.tail[division.border], 1 - i / parts)
        stencils.add(place, topology.head[division.border], i / parts)
    return stencils.operator(division.num_new)


def linear_carry(topology: Topology, division: Division) -> csr_array:
    """Return the (V + N, V) operator that keeps old values and interpolates new ones linearly."""
    kept = eye_array(topology.num_verts, format="csr")
    return csr_array(vstack([kept, linear_interpolation(topology, division)], format="csr"))
