"""Assembler of schemes on polygons: masks laid down on a topology as a sparse operator."""

import numpy as np
from scipy.sparse import csr_array, vstack

from meshfit.mesh.topology import NONE, Indices, PolygonTopology
from meshfit.subdivision.polygons.scheme import LINEAR_SCHEMES, CornerMask, MeanMask, PolygonScheme, TensorProductMask
from meshfit.subdivision.polygons.selection import (
    boundary_rows,
    face_means,
    scatter,
    select,
    weighted_sum,
)
from meshfit.subdivision.polygons.splits import PolygonDivision
from meshfit.subdivision.polygons.tensor_product import TensorProduct
from meshfit.subdivision.push_back import push_back


def assemble_polygons(topology: PolygonTopology, scheme: PolygonScheme, division: PolygonDivision) -> csr_array:
    """Return the operator S of one level: verts_fine = S verts_coarse, old vertices that are kept first.

    Args:
        topology: the coarse connectivity, an oriented manifold; vertices without faces stay where they are.
        scheme: the masks.
        division: of the topology, from `divide_polygons`.

    Returns:
        Sparse (K + N, V) float64; its rows sum to one.

    Raises:
        MeshError: the masks have no rule for a vertex or face, which is named.
    """
    even, odd = _old_verts(topology, scheme, division), _new_verts(topology, scheme, division)
    if scheme.alpha is not None:
        linear = _new_verts(topology, LINEAR_SCHEMES[scheme.split], division)
        even, odd = push_back(scheme.alpha, linear, even, odd)
    operator = csr_array(vstack([even, odd], format="csr"))
    operator.eliminate_zeros()
    operator.sort_indices()
    return operator


def _old_verts(topology: PolygonTopology, scheme: PolygonScheme, division: PolygonDivision) -> csr_array:
    num_verts = topology.num_verts
    if scheme.vert is None or scheme.boundary is None:
        return select(division.kept, num_verts)
    on_border, valence = topology.boundary_verts, topology.valence
    weights = np.zeros((int(valence.max(initial=0)) + 1, 3))
    weights[0] = 1, 0, 0
    for n in np.unique(valence[valence > 0]):
        weights[n] = [float(weight) for weight in scheme.vert.weights(int(n))]
    own, ring, faces = weights[valence].T
    inner = np.flatnonzero(~on_border[topology.tail])
    tail = topology.tail[inner]
    around = scatter(tail, select(topology.head[inner], num_verts), num_verts, ring[tail] / valence[tail])
    means = face_means(topology)[topology.face[inner]]
    around = around + scatter(tail, means, num_verts, faces[tail] / valence[tail])
    still = np.flatnonzero(~on_border | (not division.moves_border))
    kept = scatter(still, select(still, num_verts), num_verts, np.where(on_border, 1.0, own)[still])
    border = np.flatnonzero((topology.twin == NONE) & division.moves_border)
    curve = boundary_rows(topology, border, scheme.boundary.vert)
    return csr_array(kept + around + scatter(topology.tail[border], curve, num_verts))


def _new_verts(topology: PolygonTopology, scheme: PolygonScheme, division: PolygonDivision) -> csr_array:
    mask, boundary = scheme.inserted, scheme.boundary
    if isinstance(mask, CornerMask):
        return _in_corners(topology, mask, division)
    assert boundary is not None  # noqa: S101  the scheme has checked it
    if isinstance(mask, TensorProductMask):
        rows = TensorProduct(topology, mask, boundary).rows(division)
    else:
        rows = _by_means(topology, mask, division)
    for place, weights in zip(division.border_place, boundary.inserted, strict=True):
        rows = rows + scatter(place, boundary_rows(topology, division.border, weights), division.num_new)
    return csr_array(rows)


def _by_means(topology: PolygonTopology, mask: MeanMask, division: PolygonDivision) -> csr_array:
    means, num_verts, num_new = face_means(topology), topology.num_verts, division.num_new
    own = division.corner_place[topology.starts]
    faces = np.flatnonzero(own != NONE)
    rows = scatter(own[faces], means[faces], num_new)
    inner, twin = division.inner, topology.twin[division.inner]
    for place in division.inner_place:
        ends = select(topology.tail[inner], num_verts) + select(topology.head[inner], num_verts)
        beside = means[topology.face[inner]] + means[topology.face[twin]]
        rows = rows + scatter(place, float(mask.end) * ends + float(mask.mean) * beside, num_new)
    return csr_array(rows)


def _in_corners(topology: PolygonTopology, mask: CornerMask, division: PolygonDivision) -> csr_array:
    corner = np.arange(len(topology.corners))
    after, before = topology.following(corner), topology.preceding(corner)
    out, into = topology.twin == NONE, topology.twin[before] == NONE
    kept, inside = out & into, ~out & ~into
    # Whether the edge that goes on from the next corner, or that comes to the one before, is on the boundary.
    ahead, behind = inside & out[after], inside & into[before]
    own = select(topology.tail, topology.num_verts)
    means = face_means(topology)[topology.face]
    rows = csr_array((len(corner), topology.num_verts))
    for chosen, other in ((out & ~into, after), (into & ~out, before)):
        for at, weights in ((chosen & ~kept[other], mask.on_edge), (chosen & kept[other], mask.beside_kept)):
            here = corner[at]
            rows = rows + scatter(here, weighted_sum({0: own[here], 1: own[other[here]]}, weights), len(corner))
    first, second, third = (float(weight) for weight in mask.beside)
    for chosen, other in ((ahead & ~behind, after), (behind & ~ahead, before)):
        here = corner[chosen]
        rows = rows + scatter(here, first * own[here] + second * own[other[here]] + third * means[here], len(corner))
    for at, block in ((kept, own), (ahead & behind, means)):
        rows = rows + scatter(corner[at], block[corner[at]], len(corner))
    rows = rows + _in_face(topology, mask, corner[inside & ~ahead & ~behind])
    return scatter(division.corner_place, csr_array(rows), division.num_new)


def _in_face(topology: PolygonTopology, mask: CornerMask, corner: Indices) -> csr_array:
    """(C, V) the rows of corners away from the boundary."""
    rows = csr_array((len(topology.corners), topology.num_verts))
    sizes = topology.sizes[topology.face[corner]]
    for size in np.unique(sizes):
        here = other = corner[sizes == size]
        for weight in mask.weights(int(size)):
            share = np.full(len(here), float(weight))
            rows = rows + scatter(here, select(topology.tail[other], topology.num_verts), len(topology.corners), share)
            other = topology.following(other)
    return csr_array(rows)
