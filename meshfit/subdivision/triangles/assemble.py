"""The one assembler: it lays masks down on a topology as a sparse operator, and never asks which scheme they are of."""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import csr_array, diags_array, eye_array, vstack

from meshfit.mesh.topology import Indices, Mask, Topology, next_in_face, previous_in_face
from meshfit.subdivision.creases import Creases, SharpRules
from meshfit.subdivision.masks import CurveMask, EdgeMask, FaceMask, VertMask
from meshfit.subdivision.push_back import pushed_back
from meshfit.subdivision.stencils import Stencils
from meshfit.subdivision.triangles.scheme import PushBack, TriangleScheme
from meshfit.subdivision.triangles.splits import Division

REGULAR_VALENCE = 6


def assemble(
    topology: Topology, scheme: TriangleScheme, division: Division, creases: Creases | None = None
) -> csr_array:
    """The operator S of one level: verts_fine = S verts_coarse, old vertices first.

    Args:
        topology: the coarse connectivity, an oriented manifold; verts without faces stay where they are.
        scheme: the masks.
        division: what `divide` made of the topology.
        creases: sharp edges and corners, for schemes that take them.

    Returns:
        Sparse (V + N, V) float64; its rows sum to one.
    """
    even = _old_verts(topology, scheme, division)
    odd = _new_verts(topology, scheme, division)
    rules = None if creases is None else creases.rules(topology)
    if rules is not None:
        even, odd = _sharpened(topology, scheme.boundary, rules, even, odd)
    if scheme.push_back is not None:
        even, odd = _push_back(topology, scheme.push_back, division, rules, even, odd)
    return csr_array(vstack([even, odd], format="csr"))


def _old_verts(topology: Topology, scheme: TriangleScheme, division: Division) -> csr_array:
    if scheme.vert is None:
        return csr_array(eye_array(topology.num_verts, format="csr"))
    stencils = Stencils(topology)
    on_border = topology.boundary_verts
    ring = _ring_weights(topology, scheme.vert)
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


def _ring_weights(topology: Topology, mask: VertMask) -> Float64[np.ndarray, " V"]:
    """What the one-ring of each inner vertex gets; weights are asked for at valences that occur, and at no others."""
    inner = np.flatnonzero(~topology.boundary_verts & (topology.valence > 0))
    valences, place = np.unique(topology.valence[inner], return_inverse=True)
    weights = np.zeros(topology.num_verts)
    weights[inner] = np.array([mask.ring(int(valence)) for valence in valences], dtype=np.float64)[place]
    return weights


def _new_verts(
    topology: Topology, scheme: TriangleScheme, division: Division, on_curve: Mask | None = None
) -> csr_array:
    stencils = Stencils(topology)
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


def _add_regular(stencils: Stencils, mask: EdgeMask | FaceMask, rows: Indices, halfedge: Indices) -> None:
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


def _add_border(stencils: Stencils, scheme: TriangleScheme, division: Division) -> None:
    topology, border = stencils.topology, division.border
    tail, head = topology.tail[border], topology.head[border]
    neighbours = topology.boundary_neighbours
    along = {-1: neighbours[tail, 0], 0: tail, 1: head, 2: neighbours[head, 1]}
    for place, weights in zip(division.border_place, scheme.boundary.inserted, strict=True):
        stencils.add_curve(place, along, weights)


def _sharpened(
    topology: Topology, boundary: CurveMask, rules: SharpRules, even: csr_array, odd: csr_array
) -> tuple[csr_array, csr_array]:
    """The operators of a 1-to-4 split with the rule along the boundary on every crease as well, by their shares."""
    bent, cut = Stencils(topology), Stencils(topology)
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
    push_back: PushBack,
    division: Division,
    rules: SharpRules | None,
    even: csr_array,
    odd: csr_array,
) -> tuple[csr_array, csr_array]:
    between = linear_interpolation(topology, division)
    old, pushed = pushed_back(push_back.alpha, between, even, odd)
    if push_back.at_valence3 is not None:
        smooth = ~topology.boundary_verts * 1.0 if rules is None else rules.smooth
        safe = _new_verts(topology, push_back.at_valence3, division, smooth < 1)
        share = _touches_valence3(topology, division, smooth)
        share = share if rules is None else share * (1 - rules.edge)
        alpha = np.broadcast_to(np.asarray(push_back.alpha, dtype=np.float64), (topology.num_verts,))
        blend = share * (between @ alpha)
        pushed = diags_array(1 - share) @ pushed + diags_array(share - blend) @ odd + diags_array(blend) @ safe
    return old, csr_array(pushed)


def _touches_valence3(topology: Topology, division: Division, smooth: np.ndarray) -> np.ndarray:
    """(N,) the largest share of the smooth rule at ends of valence 3."""
    share = np.zeros(division.num_new)
    ends = np.stack([topology.tail[division.inner], topology.head[division.inner]])
    share[division.inner_place] = np.where(topology.valence[ends] == 3, smooth[ends], 0.0).max(axis=0)
    return share


def linear_interpolation(topology: Topology, division: Division) -> csr_array:
    """(N, V) the operator that puts each new vertex linearly between the old ones it was inserted between."""
    stencils = Stencils(topology)
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


def vertex_attribute_carry(topology: Topology, division: Division) -> csr_array:
    """(V + N, V) the operator that keeps old values and interpolates new ones linearly, as for per-vertex α."""
    kept = eye_array(topology.num_verts, format="csr")
    return csr_array(vstack([kept, linear_interpolation(topology, division)], format="csr"))
