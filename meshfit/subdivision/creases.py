"""Creases, edges that stay sharp for some levels or permanently, and corners, vertices that stay where they are.

The rules are those of Hoppe et al. 1994, Piecewise smooth surface reconstruction, with the midpoint at every sharp
edge; finite sharpness is that of DeRose, Kass and Truong 1998, Subdivision surfaces in character animation.
"""

import contextlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray

from meshfit.doors import no_type_check
from meshfit.errors import MeshError, SchemeError
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.cleaning import VertexMap
from meshfit.mesh.geometry import face_normals
from meshfit.mesh.io.text import read_word_lines
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import NONE, Indices, Mask, Topology
from meshfit.printable import described, value_text
from meshfit.units import count_text

Shares = Float64[np.ndarray, "_"]
Numbers = NDArray[Any] | Sequence[int | float]
Rows = NDArray[Any] | Sequence[Sequence[int]]
_CREASED = 2


@dataclass(frozen=True, eq=False)
class SharpRules:
    """Shares of the smooth, crease and corner rules in one level of refinement; at each vertex they sum to one.

    Attributes:
        edge: (E,) share of the sharp rule of an edge.
        smooth: (V,) share of the rule of smooth vertices and of darts, at which a single crease ends.
        crease: (V,) share of the rule along a curve.
        corner: (V,) share of staying in place.
        pair: (V, 2) the neighbours along the curve; `NONE` where the crease rule has no share.
    """

    edge: Shares
    smooth: Shares
    crease: Shares
    corner: Shares
    pair: Int64[np.ndarray, "V 2"]


@dataclass(frozen=True, eq=False)
class Creases:
    """Sharp edges and corners of one topology. Boundary edges are always permanently sharp.

    Attributes:
        sharpness: (E,) number of levels for which each edge stays sharp, in the order of the topology's edges: 0 is
            smooth, `inf` permanently sharp; at 1.3, the rule of the second level is three tenths sharp.
        corners: (V,) vertices that stay where they are. Vertices at which three sharp edges meet stay as well.

    Example:
        >>> import meshfit
        >>> meshfit.Creases.of("octahedron", edges=[(0, 2), (2, 1)], sharpness=2, corners=[4])
        Creases(2 sharp edges of 12, 1 corner)
    """

    sharpness: Shares
    corners: Mask

    def __post_init__(self) -> None:
        _require_sharpness(self.sharpness)

    def __repr__(self) -> str:
        """Return the numbers of sharp edges and corners; the boundary counts where it is tagged."""
        sharp = f"{count_text(int((self.sharpness > 0).sum()), 'sharp edge')} of {len(self.sharpness):,}"
        return f"Creases({sharp}, {count_text(int(self.corners.sum()), 'corner')})"

    @classmethod
    @no_type_check
    def of(
        cls,
        topology: "Topology | MeshLike",
        edges: Rows = (),
        sharpness: Numbers | int | float = inf,
        corners: Numbers = (),
    ) -> "Creases":
        """Tag edges, given by their ends, and corners.

        Args:
            topology: the mesh's connectivity, or a mesh in any form that `as_mesh` takes.
            edges: (K, 2) vertex numbers, in any order.
            sharpness: one for all these edges, or (K,) one for each.
            corners: vertex numbers.

        Raises:
            MeshError: no such vertex, vertices that no edge joins, or a wrong number of sharpness values.
            SchemeError: a sharpness below 0 or NaN.
        """
        if not isinstance(topology, Topology):
            topology = Topology.of(as_mesh(topology, triangles=True))
        marked, tagged = np.array(corners, dtype=np.int64), np.zeros(topology.num_verts, dtype=bool)
        if len(marked) and not ((marked >= 0) & (marked < topology.num_verts)).all():
            bad = marked[(marked < 0) | (marked >= topology.num_verts)][0]
            raise MeshError(f"corner {bad}: vertices are numbered 0 to {topology.num_verts - 1}")
        tagged[marked] = True
        ends = np.array(edges, dtype=np.int64).reshape(-1, 2)
        given, by_edge = np.asarray(sharpness, dtype=np.float64), np.zeros(topology.num_edges)
        if given.shape not in ((), (len(ends),)):
            raise MeshError(
                f"sharpness has shape {given.shape}; expected one number, or one for each of {len(ends)} edges"
            )
        _require_sharpness(np.atleast_1d(given))
        by_edge[edges_between(topology, ends)] = given
        return cls(np.where(topology.boundary_edges, inf, by_edge), tagged)

    def sharpness_on(self, topology: Topology) -> Shares:
        """(E,) the sharpness of each edge, infinite on the boundary."""
        return np.where(topology.boundary_edges, inf, self.sharpness)

    def finer(self, num_fine: int, fine_edges: Int64[np.ndarray, "G 2"]) -> "Creases":
        """Return the creases after a 1-to-4 split: both halves of an edge are sharp for one level less.

        Args:
            num_fine: number of fine vertices; the new vertex of edge e is number V + e.
            fine_edges: (G, 2) the fine edges, smaller vertex first.
        """
        num_coarse = len(self.corners)
        half = fine_edges[:, 0] < num_coarse
        left = np.zeros(len(fine_edges))
        left[half] = np.maximum(self.sharpness[fine_edges[half, 1] - num_coarse] - 1, 0)
        return Creases(left, np.concatenate([self.corners, np.zeros(num_fine - num_coarse, dtype=bool)]))

    def rules(self, topology: Topology) -> SharpRules:
        """Return the shares of the rules in the refinement of this level.

        The number of sharp edges at a vertex decides: none or one, the smooth rule; two, the rule along a curve; more,
        or a tagged corner, and it stays. Where the sharpness of some edges ends within the level, the rule with them
        gets the mean of their remaining sharpness as its share, and the rule without them the rest.
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
        bad = values[~(values >= 0)][0]
        raise SchemeError(f"sharpness {bad:g} is not allowed: expected 0 or more, or inf (permanently sharp)")


def _sum_at_verts(topology: Topology, of_edges: Shares) -> Shares:
    ends = topology.edges.T.reshape(-1)
    return np.bincount(ends, weights=np.tile(of_edges, 2), minlength=topology.num_verts).astype(np.float64)


def _neighbours(verts: Mask, edges: Int64[np.ndarray, "K 2"]) -> Int64[np.ndarray, "B 2"]:
    """For vertices at two of these edges each, return the other ends of both."""
    tail, head = np.concatenate([edges, edges[:, ::-1]]).T
    chosen = verts[tail]
    order = np.lexsort((head[chosen], tail[chosen]))
    return np.asarray(head[chosen][order]).reshape(-1, 2)


@no_type_check
def require_creases(creases: Creases) -> None:
    """Refuse what is no creases.

    Raises:
        MeshError: anything else.
    """
    if not isinstance(creases, Creases):
        made = "make them with creases_by_angle(mesh, degrees) or Creases.of(mesh, edges)"
        raise MeshError(f"creases: expected Creases, got {described(creases)}; {made}")


@no_type_check
def require_matching_creases(creases: Creases, topology: Topology) -> None:
    """Refuse the creases of another mesh, and what is no creases.

    Raises:
        MeshError: the numbers of edges or vertices differ.
    """
    require_creases(creases)
    num_edges, num_verts = len(creases.sharpness), len(creases.corners)
    if (num_edges, num_verts) != (topology.num_edges, topology.num_verts):
        raise MeshError(
            f"the creases belong to a mesh of {num_edges} edges and {num_verts} vertices; "
            f"this mesh has {topology.num_edges} edges and {topology.num_verts} vertices"
        )


def edges_between(topology: Topology, ends: Int64[np.ndarray, "K 2"]) -> Indices:
    """Return the (K,) numbers of the edges that join these vertices.

    Raises:
        MeshError: no such vertex, or vertices that no edge joins.
    """
    outside: Mask = np.asarray(((ends < 0) | (ends >= topology.num_verts)).any(axis=1))
    low, high = np.sort(ends, axis=1).T
    keys = topology.edges[:, 0] * topology.num_verts + topology.edges[:, 1]
    wanted = low * topology.num_verts + high
    place = np.searchsorted(keys, wanted)
    unknown = outside | (np.append(keys, NONE)[place] != wanted)
    if unknown.any():
        bad = int(np.flatnonzero(unknown)[0])
        fault = f"vertices are numbered 0 to {topology.num_verts - 1}" if outside[bad] else "the mesh has no such edge"
        raise MeshError(f"crease ({ends[bad, 0]}, {ends[bad, 1]}): {fault}")
    return np.asarray(place)


@no_type_check
def creases_by_angle(mesh: "MeshLike", degrees: int | float, sharpness: int | float = inf) -> Creases:
    """Return creases at all edges whose faces enclose more than some angle.

    Args:
        mesh: in any form that `as_mesh` takes; polygons are triangulated.
        degrees: the angle between the normals of the two faces; 0 for coplanar faces.
        sharpness: of these edges.

    Example:
        >>> import meshfit
        >>> cube = meshfit.as_mesh("cube", triangles=True)
        >>> creases = meshfit.creases_by_angle(cube, 60)
        >>> creases
        Creases(12 sharp edges of 18, 0 corners)
        >>> meshfit.subdivide(cube, "loop", 2, creases=creases)
        Mesh(98 verts, 192 faces, box 1.155 × 1.155 × 1.155)

    Raises:
        SchemeError: an angle out of range, or a sharpness below 0.
    """
    for name, value in (("degrees", degrees), ("sharpness", sharpness)):
        if not isinstance(value, int | float | np.number):
            raise SchemeError(f"{name}: expected a number, got {value_text(value)}")
    if not 0 < degrees <= 180:
        raise SchemeError(f"a crease angle of {degrees:g} degrees is not allowed: expected more than 0, up to 180")
    mesh = mesh if isinstance(mesh, Mesh) else as_mesh(mesh, triangles=True)
    size = float(np.abs(mesh.verts).max(initial=0.0)) or 1.0
    topology, normals = Topology.of(mesh), face_normals(Mesh(mesh.verts / size, mesh.faces))
    halfedge = topology.edge_halfedge
    paired = topology.twin[halfedge] != NONE
    left, right = normals[halfedge[paired] // 3], normals[topology.twin[halfedge[paired]] // 3]
    # This form is exact near 0 and 180 degrees too, and gives 0 next to a face without area.
    angle = np.arctan2(np.linalg.norm(np.cross(left, right), axis=1), (left * right).sum(axis=1))
    sharp = topology.edges[paired][np.degrees(angle) > degrees]
    return Creases.of(topology, sharp, sharpness)


def read_creases(path: str | Path, topology: Topology, vertex_map: VertexMap, sharpness: int | float = inf) -> Creases:
    """Read creases and corners from a text file, one per line.

    `a b` is the edge between vertices a and b, `a b sharpness` one that is sharp for so many levels, and `a` alone a
    corner. Vertices are counted from 0 in the mesh file's order, and `#` begins a comment.

    Args:
        path: of the text file.
        topology: of the mesh.
        vertex_map: the vertices of the mesh that those of its file became, from `load_target_with_vertex_map`.
        sharpness: of edges that are listed without one.

    Raises:
        MeshError: the file cannot be read or lists nothing, or a line has no vertex or edge of the mesh, or a bad
            sharpness.
        SchemeError: `sharpness` is below 0.
    """
    corners, listed = list[int](), dict[int, float]()
    for line, words in read_word_lines(path):
        where = f"{path}, line {line}"
        ends, levels = _numbers(words)
        if not ends or len(levels) > 1:
            raise MeshError(
                f"{where}: found '{' '.join(words)}'; expected a crease 'a b' or 'a b sharpness', or a corner 'a'"
            )
        (given,) = levels or [sharpness]
        if not given >= 0:
            raise MeshError(f"{where}: sharpness {given:g} is not allowed: expected 0 or more, or inf")
        verts = [_verts(end, vertex_map, where) for end in ends]
        if len(verts) == 1:
            corners += verts[0]
            continue
        for edge in _edges(verts, ends, topology, where):
            if listed.setdefault(edge, given) != given:
                before = f"listed before with sharpness {listed[edge]:g}"
                raise MeshError(f"{where}: edge ({ends[0]}, {ends[1]}) is a duplicate, {before}")
    if not corners and not listed:
        raise MeshError(f"{path}: no creases or corners in it")
    return Creases.of(topology, topology.edges[list(listed)], list(listed.values()), corners)


def _numbers(words: list[str]) -> tuple[list[int], list[float]]:
    """Return the vertices and the sharpness in a line; nothing where its words are not numbers."""
    try:
        return [int(word) for word in words[:2]], [float(word) for word in words[2:]]
    except ValueError:
        return [], []


def _verts(number: int, vertex_map: VertexMap, where: str) -> list[int]:
    """Return the vertices of the mesh that a vertex of the file became."""
    if not 0 <= number < vertex_map.num_file_verts:
        raise MeshError(f"{where}: vertex {number}: the mesh file has vertices 0 to {vertex_map.num_file_verts - 1}")
    if not (verts := vertex_map.mesh_verts(number)):
        raise MeshError(f"{where}: vertex {number} was dropped when the mesh was read, since no valid face uses it")
    return verts


def _edges(verts: list[list[int]], ends: list[int], topology: Topology, where: str) -> list[int]:
    """Return the edges between any of two groups of vertices."""
    edges = []
    for pair in itertools.product(*verts):
        with contextlib.suppress(MeshError):
            edges.append(int(edges_between(topology, np.array([pair]))[0]))
    if not edges:
        raise MeshError(f"{where}: the mesh has no edge between vertices {ends[0]} and {ends[1]}")
    return edges
