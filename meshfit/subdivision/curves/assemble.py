"""Assembler of schemes on curves: a mask laid down on chains as a sparse operator."""

from collections.abc import Mapping
from fractions import Fraction

import numpy as np
from scipy.sparse import csr_array, eye_array, vstack

from meshfit.mesh.curves import Chains
from meshfit.mesh.topology import NONE, Indices
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.push_back import push_back
from meshfit.subdivision.stencils import StencilRows


def assemble_curves(chains: Chains, scheme: CurveScheme) -> csr_array:
    """Return the operator S of one level: verts_fine = S verts_coarse, old vertices first, then new ones.

    The ends of an open chain stay where they are. Beyond an end e with neighbour n, a mask takes the mirror image
    2e - n, so that equally spaced vertices on a straight line stay equally spaced up to its ends.

    Args:
        chains: the coarse connectivity, without branches; vertices off the chains stay where they are.
        scheme: the mask.

    Returns:
        Sparse (V + N, V) float64; its rows sum to one.
    """
    even, odd = _old_verts(chains, scheme), _new_verts(chains, scheme)
    if scheme.alpha is not None:
        even, odd = push_back(scheme.alpha, linear_interpolation(chains, scheme), even, odd)
    return csr_array(vstack([even, odd], format="csr"))


def linear_interpolation(chains: Chains, scheme: CurveScheme) -> csr_array:
    """Return the (N, V) operator that spaces the new vertices of each segment evenly on it."""
    rows, parts = StencilRows(chains.num_verts), len(scheme.mask.inserted) + 1
    tail, head = chains.tail, chains.head
    for i, place in enumerate(_places(chains, scheme), start=1):
        rows.add(place, tail, Fraction(parts - i, parts))
        rows.add(place, head, Fraction(i, parts))
    return rows.operator(len(tail) * (parts - 1))


def linear_carry(chains: Chains, scheme: CurveScheme) -> csr_array:
    """Return the (V + N, V) operator that keeps old values and interpolates new ones linearly."""
    kept = eye_array(chains.num_verts, format="csr")
    return csr_array(vstack([kept, linear_interpolation(chains, scheme)], format="csr"))


def _places(chains: Chains, scheme: CurveScheme) -> list[Indices]:
    """For each vertex inserted in one segment, (S,) the index of its row counted from the first new vertex."""
    inserted = len(scheme.mask.inserted)
    return [np.arange(len(chains.tail)) * inserted + i for i in range(inserted)]


def _old_verts(chains: Chains, scheme: CurveScheme) -> csr_array:
    rows = StencilRows(chains.num_verts)
    inner = (chains.neighbours != NONE).all(axis=1)
    still, moved = np.flatnonzero(~inner), np.flatnonzero(inner)
    before, after = chains.neighbours[moved].T
    rows.add(still, still, Fraction(1))
    rows.add_curve(moved, {-1: before, 0: moved, 1: after}, scheme.mask.vert)
    return rows.operator(chains.num_verts)


def _new_verts(chains: Chains, scheme: CurveScheme) -> csr_array:
    rows, places = StencilRows(chains.num_verts), _places(chains, scheme)
    for place, weights in zip(places, scheme.mask.inserted, strict=True):
        _add_along(rows, chains, place, weights)
    return rows.operator(len(places) * len(chains.tail))


def _add_along(rows: StencilRows, chains: Chains, place: Indices, weights: Mapping[int, Fraction]) -> None:
    tail, head = chains.tail, chains.head
    rows.add(place, tail, weights.get(0, Fraction(0)))
    rows.add(place, head, weights.get(1, Fraction(0)))
    for offset, end, other, side in ((-1, tail, head, 0), (2, head, tail, 1)):
        if weight := weights.get(offset):
            beyond = chains.neighbours[end, side]
            inside, mirrored = beyond != NONE, beyond == NONE
            rows.add(place[inside], beyond[inside], weight)
            rows.add(place[mirrored], end[mirrored], 2 * weight)
            rows.add(place[mirrored], other[mirrored], -weight)
