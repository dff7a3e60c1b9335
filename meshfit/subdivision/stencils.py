"""Stencils: rows of a sparse operator, collected by the roles that vertices play around an edge or face."""

from collections.abc import Mapping
from fractions import Fraction

import numpy as np
from scipy.sparse import coo_array, csr_array

from meshfit.mesh.topology import NONE, Indices, Topology, next_in_face, previous_in_face
from meshfit.subdivision.masks import SpokeMask

Weight = Fraction | float


class Rows:
    """Entries (row, column, weight) over some verts; entries at the same place add up."""

    def __init__(self, num_verts: int) -> None:
        self.num_verts = num_verts
        self._entries: list[tuple[Indices, Indices, np.ndarray]] = []

    def add(self, rows: Indices, columns: Indices, weight: "Weight | np.ndarray") -> None:
        """One entry for each (row, column) pair."""
        values = np.broadcast_to(np.asarray(weight if isinstance(weight, np.ndarray) else float(weight)), rows.shape)
        self._entries.append((rows, columns, values))

    def add_curve(self, rows: Indices, along: dict[int, Indices], weights: Mapping[int, Fraction]) -> None:
        """Weights by offset along a boundary; `along` gives the vertex at each offset."""
        for offset, weight in weights.items():
            self.add(rows, along[offset], weight)

    def operator(self, num_rows: int) -> csr_array:
        """The rows as a sparse (num_rows, V) matrix in float64."""
        rows, columns, values = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        entries = coo_array((values.astype(np.float64), (rows, columns)), shape=(num_rows, self.num_verts))
        return csr_array(entries)


class Stencils(Rows):
    """Entries over the verts of one topology, by the roles that these play around an edge or face."""

    def __init__(self, topology: Topology) -> None:
        super().__init__(topology.num_verts)
        self.topology = topology

    def add_beyond(self, rows: Indices, halfedge: Indices, weight: Weight) -> None:
        """The vertex across each half-edge; where the boundary leaves none, the face's own apex, mirrored in its edge.

        The mirror image, tail + head - apex, completes a parallelogram and so keeps planes plane and linear maps exact.
        """
        topology, twin = self.topology, self.topology.twin[halfedge]
        inner = twin != NONE
        self.add(rows[inner], topology.apex[twin[inner]], weight)
        outer, edge = rows[~inner], halfedge[~inner]
        self.add(outer, topology.tail[edge], weight)
        self.add(outer, topology.head[edge], weight)
        self.add(outer, topology.apex[edge], -weight)

    def add_wings(self, rows: Indices, halfedge: Indices, weight: Weight) -> None:
        """The two vertices beyond the other edges of the face across each half-edge, which may itself be mirrored."""
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
        """Centre and one-ring of the interior vertex at each half-edge's tail, spoke 0 along the half-edge."""
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
