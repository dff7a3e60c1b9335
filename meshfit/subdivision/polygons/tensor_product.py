"""Tensor product of a curve rule on a net of quads: the rule along its lines, then across them.

Position t on a half-edge is the t-th vertex inserted in its edge, counted from the tail of the half-edge.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array

from meshfit.errors import MeshError
from meshfit.mesh.topology import NONE, Indices, PolygonTopology
from meshfit.subdivision.masks import CurveMask
from meshfit.subdivision.polygons.scheme import TensorProductMask
from meshfit.subdivision.polygons.selection import boundary_rows, scatter, select, weighted_sum
from meshfit.subdivision.polygons.splits import PolygonDivision
from meshfit.units import count_text


@dataclass(frozen=True, eq=False)
class TensorProduct:
    """A tensor product mask laid down on a connectivity.

    Attributes:
        topology: an oriented manifold.
        mask: the rule.
        boundary: the rule along the boundary.
    """

    topology: PolygonTopology
    mask: TensorProductMask
    boundary: CurveMask

    def rows(self, division: PolygonDivision) -> csr_array:
        """(N, V) the new vertices off the boundary.

        Raises:
            MeshError: the mask has no rule for a vertex or a face.
        """
        if self.mask.diagonal is None and not self.mask.is_local:
            _require_regular(self.topology)
        total = csr_array((division.num_new, self.topology.num_verts))
        if not self.topology.num_faces:
            return total
        for t, place in enumerate(division.inner_place):
            total = total + scatter(place, self._in_edges(t, division.inner), division.num_new)
        inside = np.flatnonzero(division.corner_place != NONE)
        place = division.corner_place[inside]
        share = 1 / np.bincount(place, minlength=division.num_new)[place]
        return csr_array(total + scatter(place, self._in_corners[inside], division.num_new, share))

    def _in_edges(self, t: int, halfedge: Indices) -> csr_array:
        if not self.mask.moves:
            return self._along[t][halfedge]
        points = {0: self._along[t][halfedge], 1: self._across[t][halfedge]}
        points[-1] = self._across[-1 - t][self.topology.twin[halfedge]]
        return weighted_sum(points, self.mask.curve.vert)

    @cached_property
    def _in_corners(self) -> csr_array:
        """(C, V) the new vertex in each corner of a face: the mean of the rule from either side."""
        before = self.topology.preceding(np.arange(len(self.topology.corners)))
        return csr_array((self._inward(0) + self._inward(-1)[before]) / 2)

    def _inward(self, t: int) -> csr_array:
        """(C, V) the new vertex nearest to each half-edge, on the line that crosses it at a position."""
        weights, points = self.mask.curve.inserted[0], {0: self._along[t], 1: self._across[t]}
        if weights.keys() - points.keys():
            points |= {-1: self._beyond[t], 2: csr_array(self._facing @ self._beyond[-1 - t])}
        return weighted_sum(points, weights)

    @cached_property
    def _along(self) -> list[csr_array]:
        """For each position, (C, V) the new vertex there on each half-edge."""
        topology, count = self.topology, len(self.mask.curve.inserted)
        halfedge, border = topology.edge_halfedge, topology.boundary_edges
        inner, outer = np.flatnonzero(~border), np.flatnonzero(border)
        own = [
            scatter(inner, self._on_line(t, halfedge[inner]), topology.num_edges)
            + scatter(outer, boundary_rows(topology, halfedge[outer], self.boundary.inserted[t]), topology.num_edges)
            for t in range(count)
        ]
        first = halfedge[topology.edge_of] == np.arange(len(topology.corners))
        forward, backward = np.flatnonzero(first), np.flatnonzero(~first)
        size = len(topology.corners)
        return [
            scatter(forward, csr_array(own[t])[topology.edge_of[forward]], size)
            + scatter(backward, csr_array(own[-1 - t])[topology.edge_of[backward]], size)
            for t in range(count)
        ]

    def _on_line(self, t: int, halfedge: Indices) -> csr_array:
        topology, weights = self.topology, self.mask.curve.inserted[t]
        points = {0: select(topology.tail[halfedge], topology.num_verts)}
        points[1] = select(topology.head[halfedge], topology.num_verts)
        if weights.keys() - points.keys():
            points |= {-1: self._behind[halfedge], 2: self._behind[topology.twin[halfedge]]}
        return weighted_sum(points, weights)

    @cached_property
    def _facing(self) -> csr_array:
        """(C, C) the mean of the half-edges of the same face that each does not touch; in triangles, the other two."""
        topology, entries = self.topology, []
        for size in np.unique(topology.sizes):
            steps = np.arange(2, size - 1) if size > 3 else np.array([1, 2])
            start = topology.starts[topology.sizes == size][:, None, None]
            here = np.arange(size)[None, :, None]
            other = start + (here + steps) % size
            rows = np.broadcast_to(start + here, other.shape).reshape(-1)
            entries.append((rows, other.reshape(-1), np.full(other.size, 1 / len(steps))))
        rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))
        return csr_array(coo_array((values, (rows, columns)), shape=(len(topology.corners),) * 2))

    @cached_property
    def _across(self) -> list[csr_array]:
        """For each position, (C, V) the next vertex on the line that crosses a half-edge there, inside its face."""
        return [csr_array(self._facing @ self._along[-1 - t]) for t in range(len(self._along))]

    @cached_property
    def _beyond(self) -> list[csr_array]:
        """For each position, (C, V) the next vertex on the other side; the mirror image where the line ends."""
        topology, size = self.topology, len(self.topology.corners)
        through = topology.twin != NONE
        through[through] = topology.sizes[topology.face[topology.twin[through]]] > 3
        inner, outer = np.flatnonzero(through), np.flatnonzero(~through)
        return [
            scatter(inner, self._across[-1 - t][topology.twin[inner]], size)
            + scatter(outer, 2 * self._along[t][outer] - self._across[t][outer], size)
            for t in range(len(self._along))
        ]

    @cached_property
    def _behind(self) -> csr_array:
        """(C, V) the point behind the tail of each half-edge, by which the line along it continues there."""
        topology, num_verts = self.topology, self.topology.num_verts
        size = len(topology.corners)
        on_border = topology.boundary_verts[topology.tail]
        outer, inner = np.flatnonzero(on_border), np.flatnonzero(~on_border)
        mirrored = 2 * select(topology.tail[outer], num_verts) - select(topology.head[outer], num_verts)
        heads, tail = select(topology.head, num_verts), topology.tail[inner]
        weights = 4 / np.maximum(topology.valence, 1)[topology.tail]
        after = topology.next_around_tail(inner)
        before = topology.following(topology.twin[inner])
        line = scatter(topology.tail, heads, num_verts, weights)[tail] - heads[inner] - heads[after] - heads[before]
        if self.mask.diagonal:
            far, twice = self._diagonal, topology.following(topology.twin[before])
            near = far[inner] + far[after] + far[before] + far[twice]
            line = line + float(self.mask.diagonal) * (near - scatter(topology.tail, far, num_verts, weights)[tail])
        return csr_array(scatter(outer, mirrored, size) + scatter(inner, line, size))

    @cached_property
    def _diagonal(self) -> csr_array:
        """(C, V) the mean of the corners of the same face not next to each; in triangles, the missing fourth corner."""
        topology, num_verts = self.topology, self.topology.num_verts
        corner = np.arange(len(topology.corners))
        sizes = topology.sizes[topology.face]
        total = csr_array((len(corner), num_verts))
        for size in np.unique(sizes):
            chosen = corner[sizes == size]
            steps = dict.fromkeys(range(2, size - 1), 1 / max(size - 3, 1)) or {0: -1, 1: 1, 2: 1}
            for step, weight in steps.items():
                first = topology.starts[topology.face[chosen]]
                vert = topology.corners[first + (chosen - first + step) % size]
                share = np.full(len(chosen), float(weight))
                total = total + scatter(chosen, select(vert, num_verts), len(corner), share)
        return csr_array(total)


def _require_regular(topology: PolygonTopology) -> None:
    """Refuse faces and vertices that a tensor product has no rule for.

    Raises:
        MeshError: it names the first such face or vertex.
    """
    remedy = "; catmull-clark, kobbelt and sqrt2 take any"
    irregular = np.flatnonzero(topology.sizes != 4)
    if len(irregular):
        face = int(irregular[0])
        raise MeshError(f"this scheme needs quads: face {face} has {topology.sizes[face]} corners{remedy}")
    used = topology.valence > 0
    irregular = np.flatnonzero(used & ~topology.boundary_verts & (topology.valence != 4))
    if not len(irregular):
        irregular = np.flatnonzero(topology.boundary_verts & (topology.valence > 3))
    if len(irregular):
        vert = int(irregular[0])
        where, allowed = ("on the boundary", "2 or 3") if topology.boundary_verts[vert] else ("inside", "4")
        raise MeshError(
            f"this scheme needs a regular mesh: vertex {vert}, {where}, has valence {topology.valence[vert]}, "
            f"{allowed} is allowed ({count_text(len(irregular), 'such vertex')}){remedy}"
        )
