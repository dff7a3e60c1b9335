"""Rows of a sparse operator, collected entry by entry."""

from collections.abc import Mapping
from fractions import Fraction

import numpy as np
from scipy.sparse import coo_array, csr_array

from meshfit.mesh.topology import Indices
from meshfit.subdivision.masks import Weight


class StencilRows:
    """Entries (row, column, weight) over some vertices; entries at the same place add up."""

    def __init__(self, num_verts: int) -> None:
        self.num_verts = num_verts
        self._entries: list[tuple[Indices, Indices, np.ndarray]] = []

    def add(self, rows: Indices, columns: Indices, weight: "Weight | np.ndarray") -> None:
        """Add one entry for each (row, column) pair."""
        values = np.broadcast_to(np.asarray(weight if isinstance(weight, np.ndarray) else float(weight)), rows.shape)
        self._entries.append((rows, columns, values))

    def add_curve(self, rows: Indices, along: dict[int, Indices], weights: Mapping[int, Fraction]) -> None:
        """Add weights by offset along a boundary; `along` gives the vertex at each offset."""
        for offset, weight in weights.items():
            if weight:
                self.add(rows, along[offset], weight)

    def operator(self, num_rows: int) -> csr_array:
        """Return the rows as a sparse (num_rows, V) matrix in float64."""
        rows, columns, values = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        entries = coo_array((values.astype(np.float64), (rows, columns)), shape=(num_rows, self.num_verts))
        return csr_array(entries)
