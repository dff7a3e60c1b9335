"""The sheets of a surface with creases: at every vertex, its faces from one sharp edge to the next."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from meshfit.mesh.topology import NONE, Indices, Mask, Topology


@dataclass(frozen=True, eq=False)
class Sheets:
    """Sheets about as many verts, alike in size and kind.

    Attributes:
        vert: (S,) the vertex of each.
        ring: (S, K) its neighbours counter-clockwise; the first of a dart along its crease, the first and last of an
            open sheet along the sharp edges or the boundary that bound it.
        is_open: whether it ends at two edges; if not, it goes once around its vertex.
        is_dart: whether it begins and ends at the same sharp edge.
    """

    vert: Indices
    ring: Int64[np.ndarray, "S K"]
    is_open: bool
    is_dart: bool


def sheets_of(topology: Topology, sharp: Mask) -> Iterator[Sheets]:
    """All sheets, in groups that are alike.

    Args:
        topology: an oriented manifold.
        sharp: (E,) which edges part its sheets, those of the boundary among them.
    """
    starts = _starts(topology, sharp)
    rings, size = _walked(topology, sharp, starts)
    back = rings[np.arange(len(starts)), size - 1] == rings[:, 0]
    dart = back & sharp[topology.edge_of[starts]]
    length = size - back
    for closed, of_dart, k in sorted(set(zip(back.tolist(), dart.tolist(), length.tolist(), strict=True))):
        chosen = (back == closed) & (dart == of_dart) & (length == k)
        yield Sheets(topology.tail[starts[chosen]], rings[chosen, :k], is_open=not closed, is_dart=of_dart)


def _starts(topology: Topology, sharp: Mask) -> Indices:
    """The half-edges that sheets begin with: all on sharp edges, and the first out of each vertex that has none."""
    at_sharp = np.zeros(topology.num_verts, dtype=bool)
    at_sharp[topology.edges[sharp].reshape(-1)] = True
    verts, first = np.unique(topology.tail, return_index=True)
    return np.concatenate([np.flatnonzero(sharp[topology.edge_of]), first[~at_sharp[verts]]])


def _walked(topology: Topology, sharp: Mask, starts: Indices) -> tuple[Int64[np.ndarray, "S M"], Indices]:
    """The neighbours from each start until a sharp edge or the start comes again, and how many these are."""
    columns, size = [topology.head[starts]], np.ones(len(starts), dtype=np.int64)
    at, going = starts.copy(), np.arange(len(starts))
    while len(going):
        column = np.full(len(starts), NONE, dtype=np.int64)
        column[going] = topology.apex[at]
        columns.append(column)
        size[going] += 1
        onward = topology.next_around_tail(at)
        further = (onward != NONE) & (onward != starts[going]) & ~sharp[topology.edge_of[onward]]
        at, going = onward[further], going[further]
    return np.stack(columns, axis=1), size
