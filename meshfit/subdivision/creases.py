"""Creases: edges that stay sharp for some levels or for ever, and verts that are corners.

The rules are those of Hoppe et al. 1994, Piecewise smooth surface reconstruction, with the midpoint at every sharp
edge; sharpness that wears off is that of DeRose, Kass and Truong 1998, Subdivision surfaces in character animation.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray

from meshfit.errors import MeshError, SchemeError
from meshfit.mesh.geometry import face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import NONE, Indices, Mask, Topology

Shares = Float64[np.ndarray, "_"]
Numbers = NDArray[Any] | Sequence[int | float]
Rows = NDArray[Any] | Sequence[Sequence[int]]
_CREASED = 2


@dataclass(frozen=True, eq=False)
class SharpRules:
    """How much of each rule holds in the refinement of one level; at every vertex the three shares sum to one.

    Attributes:
        edge: (E,) share of the sharp rule of an edge.
        smooth: (V,) share of the rule of smooth verts and of darts, at which one crease ends.
        crease: (V,) share of the rule along a curve.
        corner: (V,) share of staying.
        pair: (V, 2) the neighbours along the curve, by number; `NONE` where there is no share of its rule.
    """

    edge: Shares
    smooth: Shares
    crease: Shares
    corner: Shares
    pair: Int64[np.ndarray, "V 2"]


@dataclass(frozen=True, eq=False)
class Creases:
    """The sharp edges and the corners of one topology. Boundary edges are sharp for ever, whatever is said of them.

    Attributes:
        sharpness: (E,) levels that each edge stays sharp for, in the order of the topology's edges: 0 is smooth, `inf`
            sharp for ever; of 1.3, the second level's rule is three tenths sharp.
        corners: (V,) which verts stay where they are. Those at which three sharp edges meet do so anyway.
    """

    sharpness: Shares
    corners: Mask

    def __post_init__(self) -> None:
        _require_sharpness(self.sharpness)

    @classmethod
    def of(
        cls,
        topology: Topology,
        edges: Rows = (),
        sharpness: Numbers | int | float = inf,
        corners: Numbers = (),
    ) -> "Creases":
        """Tag edges by their ends, and corners.

        Args:
            topology: whose edges and verts they are.
            edges: (K, 2) vertex numbers, in any order.
            sharpness: of all of them, or (K,) of each.
            corners: vertex numbers.

        Raises:
            MeshError: no such vertex, verts that no edge joins, or another number of sharpnesses than of edges.
            SchemeError: a sharpness below 0, or no number.
        """
        marked, tagged = np.array(corners, dtype=np.int64), np.zeros(topology.num_verts, dtype=bool)
        if len(marked) and not ((marked >= 0) & (marked < topology.num_verts)).all():
            bad = marked[(marked < 0) | (marked >= topology.num_verts)][0]
            raise MeshError(f"corner {bad}: verts are numbered 0 to {topology.num_verts - 1}")
        tagged[marked] = True
        ends = np.array(edges, dtype=np.int64).reshape(-1, 2)
        each = np.zeros(topology.num_edges)
        own = np.asarray(sharpness, dtype=np.float64)
        if own.shape not in ((), (len(ends),)):
            raise MeshError(
                f"sharpness has shape {own.shape}; one number is needed, or one for each of {len(ends)} edges"
            )
        _require_sharpness(np.atleast_1d(own))
        each[edges_between(topology, ends)] = own
        return cls(np.where(topology.boundary_edges, inf, each), tagged)

    def sharpness_on(self, topology: Topology) -> Shares:
        """(E,) the sharpness of each edge, for ever on the boundary."""
        return np.where(topology.boundary_edges, inf, self.sharpness)

    def finer(self, num_fine: int, fine_edges: Int64[np.ndarray, "G 2"]) -> "Creases":
        """The creases of the 1-to-4 refinement: halves of an edge are sharp for one level less.

        Args:
            num_fine: number of verts there; the new vertex of edge e follows the old verts in place e.
            fine_edges: (G, 2) its edges, smaller vertex first.
        """
        num_coarse = len(self.corners)
        half = fine_edges[:, 0] < num_coarse
        left = np.zeros(len(fine_edges))
        left[half] = np.maximum(self.sharpness[fine_edges[half, 1] - num_coarse] - 1, 0)
        return Creases(left, np.concatenate([self.corners, np.zeros(num_fine - num_coarse, dtype=bool)]))

    def rules(self, topology: Topology) -> SharpRules:
        """What holds in the refinement of this level.

        By the number of sharp edges at a vertex: none or one, the smooth rule; two, that along a curve; more, or a
        tagged corner: it stays. Where the sharpness of some of them ends within the level, the rule with them counts
        by the mean of what is left of it, and the rule without them for the rest.
        """
        sharpness = self.sharpness_on(topology)
        ending = (sharpness > 0) & (sharpness <= 1)
        left = _sum_at_verts(topology, np.where(ending, sharpness, 0.0))
        count = _sum_at_verts(topology, ending * 1.0)
        share = np.divide(left, count, out=np.ones_like(left), where=count > 0)
        before, after = (_sum_at_verts(topology, (sharpness > least) * 1.0) for least in (0, 1))
        crease, corner = np.zeros_like(share), np.zeros_like(share)
        pair = np.full((topology.num_verts, 2), NONE, dtype=np.int64)
        for sharp, part, least in ((before, share, 0), (after, 1 - share, 1)):
            stays = self.corners | (sharp > _CREASED)
            bends = (sharp == _CREASED) & ~stays & (part > 0)
            corner += np.where(stays, part, 0.0)
            crease += np.where(bends, part, 0.0)
            pair[bends] = _neighbours(bends, topology.edges[sharpness > least])
        corner = np.where(self.corners, 1.0, corner)
        return SharpRules(sharpness.clip(max=1), 1 - crease - corner, crease, corner, pair)


def _require_sharpness(values: Shares) -> None:
    if not (values >= 0).all():
        found = values[~(values >= 0)][0]
        raise SchemeError(f"sharpness {found:g} is not allowed: 0 or more is, and inf for edges that stay sharp")


def _sum_at_verts(topology: Topology, of_edges: Shares) -> Shares:
    ends = topology.edges.T.reshape(-1)
    return np.bincount(ends, weights=np.tile(of_edges, 2), minlength=topology.num_verts).astype(np.float64)


def _neighbours(verts: Mask, edges: Int64[np.ndarray, "K 2"]) -> Int64[np.ndarray, "B 2"]:
    """Of verts at two of these edges each, the other ends of both."""
    here, there = np.concatenate([edges, edges[:, ::-1]]).T
    chosen = verts[here]
    order = np.lexsort((there[chosen], here[chosen]))
    return np.asarray(there[chosen][order]).reshape(-1, 2)


def require_matching_creases(creases: Creases, topology: Topology) -> None:
    """Refuse the creases of another mesh.

    Raises:
        MeshError: the numbers of edges or verts differ.
    """
    found, own = (len(creases.sharpness), len(creases.corners)), (topology.num_edges, topology.num_verts)
    if found != own:
        raise MeshError(
            f"creases are of {found[0]} edges and {found[1]} verts; the mesh has {own[0]} edges and {own[1]} verts"
        )


def edges_between(topology: Topology, ends: Int64[np.ndarray, "K 2"]) -> Indices:
    """(K,) the numbers of the edges that join these verts.

    Raises:
        MeshError: no such vertex, or verts that no edge joins.
    """
    outside: Mask = np.asarray(((ends < 0) | (ends >= topology.num_verts)).any(axis=1))
    low, high = np.sort(ends, axis=1).T
    keys = topology.edges[:, 0] * topology.num_verts + topology.edges[:, 1]
    wanted = low * topology.num_verts + high
    place = np.searchsorted(keys, wanted)
    unknown = outside | (np.append(keys, NONE)[place] != wanted)
    if unknown.any():
        bad = int(np.flatnonzero(unknown)[0])
        fault = f"verts are numbered 0 to {topology.num_verts - 1}" if outside[bad] else "the mesh has no such edge"
        raise MeshError(f"crease ({ends[bad, 0]}, {ends[bad, 1]}): {fault}")
    return np.asarray(place)


def creases_by_angle(mesh: Mesh, degrees: int | float, sharpness: int | float = inf) -> Creases:
    """Creases at all edges whose faces make more than some angle.

    Args:
        mesh: whose edges they are.
        degrees: the angle between the normals of the two faces, 0 where they lie in one plane.
        sharpness: of these edges.

    Raises:
        SchemeError: an angle out of range, or a sharpness below 0.
    """
    if not 0 < degrees <= 180:
        raise SchemeError(f"a crease angle of {degrees:g} degrees is not allowed: more than 0, up to 180 is")
    size = float(np.abs(mesh.verts).max(initial=0.0)) or 1.0
    topology, normals = Topology.of(mesh), face_normals(Mesh(mesh.verts / size, mesh.faces))
    halfedge = topology.edge_halfedge
    paired = topology.twin[halfedge] != NONE
    one, other = normals[halfedge[paired] // 3], normals[topology.twin[halfedge[paired]] // 3]
    # In this form also exact near 0 and 180 degrees; 0 beside a face without area.
    angle = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1))
    sharp = topology.edges[paired][np.degrees(angle) > degrees]
    return Creases.of(topology, sharp, sharpness)


@dataclass(frozen=True, eq=False)
class Sectors:
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


def sectors_of(topology: Topology, sharp: Mask) -> Iterator[Sectors]:
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
        yield Sectors(topology.tail[starts[chosen]], rings[chosen, :k], is_open=not closed, is_dart=of_dart)


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
