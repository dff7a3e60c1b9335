"""Shapes between two meshes with the same faces: parts turn and stretch, in place of vertices on straight lines.

Alexa, Cohen-Or, Levin, *As-rigid-as-possible shape interpolation*, 2000, on surfaces: each face turns by a part of its
rotation and stretches by a part of its stretch, and the vertices follow by least squares over the edges (a Poisson
equation). Rotations count from that of the whole shape, and are continued from face to face beyond half a turn
(Winkler, Drieseberg, Alexa, Hormann, *Multi-scale geometry interpolation*, 2010).
"""

from collections.abc import Iterable
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree
from scipy.spatial.transform import Rotation

from meshfit.doors import no_type_check
from meshfit.errors import MeshError
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.geometry import nearest_rotations, unit_vectors
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.sparse_factors import SymmetricFactors, nested_dissection
from meshfit.mesh.topology import Indices, Topology
from meshfit.printable import described
from meshfit.units import count_text

Vectors = Float64[np.ndarray, "_ 3"]

# Rotations by less than this angle have no axis.
_SMALL = 1e-6
# Weights of the faces around a face, and of all faces, in its rotation.
_AROUND, _OF_ALL = 1e-3, 1e-9
# Local-global rounds.
_ROUNDS = 3


@no_type_check
def interpolate_shapes(
    first: MeshLike, second: MeshLike, shares: Iterable[float] = (0.25, 0.5, 0.75)
) -> list[Mesh | PolygonMesh]:
    """Return shapes between two meshes with the same faces, such as two results of one source.

    Parts turn instead of shrinking, as they do if each vertex moves on a straight line; a rigid motion is interpolated
    as a rigid motion. Share 0 is the first shape and share 1 the second, to the bit. Swapping the two reverses the way.

    Args:
        first: a mesh in any form that `as_mesh` takes; its attributes are kept.
        second: another with the same faces.
        shares: of the way from the first to the second, 0 to 1.

    Example:
        >>> import meshfit
        >>> cube = meshfit.as_mesh("cube", triangles=True)
        >>> meshfit.interpolate_shapes(cube, cube.with_verts(3 * cube.verts), [0.5])
        [Mesh(8 verts, 12 faces, box 2.309 × 2.309 × 2.309)]

    Raises:
        MeshError: the meshes have different faces, a coordinate is not finite, or a share is not within 0 and 1.
    """
    meshes = [as_mesh(mesh, role) for mesh, role in ((first, "first"), (second, "second"))]
    require_same_faces(meshes, ("first", "second"))
    if isinstance(shares, int | float):
        shares = (shares,)
    if not isinstance(shares, Iterable):
        raise MeshError(f"shares: expected numbers from 0 to 1, got {described(shares)}")
    wanted = [_share(value) for value in shares]
    triangles = [mesh.triangulated() if isinstance(mesh, PolygonMesh) else mesh for mesh in meshes]
    # Polygons that bend are triangulated by their shape, but both in one way.
    between = ShapeInterpolation(triangles[0], triangles[0].with_verts(triangles[1].verts))
    return [meshes[0].with_verts(between.verts(share)) for share in wanted]


def require_same_faces(meshes: list[Mesh | PolygonMesh], names: Iterable[str]) -> None:
    """Refuse meshes that do not have the same faces, or coordinates that are not finite.

    Raises:
        MeshError: naming the first mesh that differs, and how.
    """
    head, *others = zip(names, meshes, strict=True)
    for name, mesh in (head, *others):
        if not np.isfinite(mesh.verts).all():
            vert = int(np.flatnonzero(~np.isfinite(mesh.verts).all(axis=1))[0])
            raise MeshError(f"{name}: vertex {vert} has a coordinate that is not finite")
    for name, mesh in others:
        difference = _difference(head[1], mesh)
        if difference:
            raise MeshError(
                f"{head[0]} and {name}: {difference}; shapes in between require the same faces in the same order, "
                "such as two results of one source by fit.connectivity: fixed"
            )


def _difference(first: Mesh | PolygonMesh, second: Mesh | PolygonMesh) -> str:
    """Return how the faces of two meshes differ, or nothing."""
    for one, other, noun in (
        (first.num_verts, second.num_verts, "vertex"),
        (first.num_faces, second.num_faces, "face"),
    ):
        if one != other:
            return f"{one:,} and {count_text(other, noun)}"
    rows = [_corners(mesh) for mesh in (first, second)]
    if all(np.array_equal(a, b) for a, b in zip(*rows, strict=True)):
        return ""
    if len(rows[0][0]) == len(rows[1][0]) and np.array_equal(rows[0][1], rows[1][1]):
        corner = int(np.flatnonzero(rows[0][0] != rows[1][0])[0])
        face = int(np.searchsorted(np.cumsum(rows[0][1]), corner, side="right"))
        return f"face {face} has other vertices in the second"
    return "their faces have different numbers of corners"


def _corners(mesh: Mesh | PolygonMesh) -> tuple[Indices, Indices]:
    """Return the vertices of all corners, and the number of corners of each face."""
    if isinstance(mesh, PolygonMesh):
        return mesh.corners, mesh.sizes
    return mesh.faces.ravel(), np.full(mesh.num_faces, 3)


def _share(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0 <= value <= 1:
        raise MeshError(f"shares: expected numbers from 0 to 1, got {described(value)}")
    return float(value)


class ShapeInterpolation:
    """The way from one shape to another with the same faces.

    With R the rotation of the whole shape and Q that of a face beyond it, an edge e that becomes e' is at share t
    Rᵗ Qᵗ ((1 - t) e + t (R Q)⁻¹ e'). That is e at 0 and e' at 1, and the same way back from the other end.
    Pieces of the mesh turn about the common centre. The centre moves on a straight line.

    Attributes:
        first: the mesh at share 0.
        second: that at share 1.
    """

    def __init__(self, first: Mesh, second: Mesh) -> None:
        self.first, self.second = first, second

    def at(self, share: float) -> Mesh:
        """Return the mesh at a share of the way, with the attributes of the first."""
        return self.first.with_verts(self.verts(share))

    def verts(self, share: float) -> Verts:
        """Return (V, 3) the vertices at a share of the way, 0 to 1."""
        if share in (0, 1):
            return (self.second if share else self.first).verts
        solved = self._relaxed(self._goals(share))
        ends = [mesh.verts for mesh in (self.first, self.second)]
        middles = [verts.mean(axis=0) for verts in ends]
        arms = [self._piece_means @ verts - middle for verts, middle in zip(ends, middles, strict=True)]
        arm = _turned(share * self._whole, (1 - share) * arms[0] + share * _turned(-self._whole, arms[1]))
        goals = arm + (1 - share) * middles[0] + share * middles[1]
        return np.asarray(solved + (goals - self._piece_means @ solved)[self._piece])

    def _goals(self, share: float) -> Vectors:
        """Return the (3 F, 3) edges that the faces should have."""
        bent = (1 - share) * self._edges[0] + share * self._edges[1]
        return _turned(share * self._whole, _turned(share * self._turns.repeat(3, axis=0), bent))

    def _relaxed(self, goals: Vectors) -> Verts:
        """Return (V, 3) vertices, up to translations, whose edges are nearest to their goals.

        Where the goals of neighbours contradict each other, they are turned to the edges (local-global rounds).
        """
        verts = np.asarray(self._factors.solve(self._differences.T @ goals))
        by_face = goals.reshape(-1, 3, 3)
        for _ in range(_ROUNDS):
            edges = (self._differences @ verts).reshape(-1, 3, 3)
            moments = (by_face[:, :, :, None] * edges[:, :, None, :]).sum(axis=1).reshape(-1, 9)
            around = (self._corners.T @ (self._corners @ moments)).reshape(-1, 3, 3)
            turned = np.einsum("fij,fkj->fki", nearest_rotations(_scaled(around)), by_face).reshape(-1, 3)
            verts = np.asarray(self._factors.solve(self._differences.T @ turned))
        return verts

    @cached_property
    def _whole(self) -> Float64[np.ndarray, "3"]:
        """The rotation vector of the whole shape."""
        return self._rotations[0]

    @cached_property
    def _turns(self) -> Vectors:
        """(F, 3) rotation vectors of faces beyond that of the whole."""
        return self._rotations[1]

    @cached_property
    def _rotations(self) -> tuple[Float64[np.ndarray, "3"], Vectors]:
        topology = Topology.of(self.first)
        pairs = topology.face_of(topology.face_pairs.ravel()).reshape(-1, 2)
        whole = Rotation.from_matrix(nearest_rotations(_scaled(self._moments.sum(axis=0)[None]))[0])
        rotations = Rotation.from_matrix(nearest_rotations(_scaled(self._moments)))
        turns = (whole.inv() * rotations).as_rotvec()
        if not _is_torn(turns, pairs):
            return whole.as_rotvec(), turns
        graph = _angles_between(rotations, pairs)
        # Of turns by more than half, the mean is not the middle.
        whole = rotations[_central(graph)]
        return whole.as_rotvec(), _continued((whole.inv() * rotations).as_rotvec(), graph)

    @cached_property
    def _moments(self) -> Float64[np.ndarray, "F 3 3"]:
        """Σ e e'ᵀ over the edges of each face, and a little of that of the faces around it and of all.

        A face without area, which may turn in any way, turns as those around it.
        """
        first, second = (_edges_of(mesh).reshape(-1, 3, 3) for mesh in (self.first, self.second))
        own = (first[:, :, :, None] * second[:, :, None, :]).sum(axis=1).reshape(-1, 9)
        around = self._corners.T @ (self._corners @ own)
        return np.asarray(own + _AROUND * around + _OF_ALL * own.mean(axis=0)).reshape(-1, 3, 3)

    @cached_property
    def _corners(self) -> csr_array:
        """(V, F) 1 for each corner."""
        faces = self.first.faces
        where = faces.ravel(), np.arange(len(faces)).repeat(3)
        return csr_array((np.ones(faces.size), where), shape=(self.first.num_verts, len(faces)))

    @cached_property
    def _edges(self) -> tuple[Vectors, Vectors]:
        """(3 F, 3) edges of each face: those of the first shape, and those of the second turned back."""
        ends = _turned(-self._turns.repeat(3, axis=0), _turned(-self._whole, _edges_of(self.second)))
        return _edges_of(self.first), ends

    @cached_property
    def _differences(self) -> csr_array:
        """(3 F, V) the edges of vertices."""
        faces, count = self.first.faces, self.first.num_verts
        rows, ones = np.arange(faces.size), np.ones(faces.size)
        heads, tails = np.roll(faces, -1, axis=1).ravel(), faces.ravel()
        return csr_array((ones, (rows, heads)), shape=(len(rows), count)) - csr_array(
            (ones, (rows, tails)), shape=(len(rows), count)
        )

    @cached_property
    def _factors(self) -> SymmetricFactors:
        """The factors of the normal equations, with one vertex of each piece held at the origin."""
        held = np.zeros(self.first.num_verts)
        held[np.unique(self._piece, return_index=True)[1]] = 1.0
        square = csr_array(self._differences.T @ self._differences + diags_array(held))
        return SymmetricFactors(square, nested_dissection(square, self.first.verts))

    @cached_property
    def _piece(self) -> Indices:
        """(V,) the piece of each vertex; a vertex without faces is one of its own."""
        square = self._differences.T @ self._differences
        return np.asarray(connected_components(square, directed=False)[1], dtype=np.int64)

    @cached_property
    def _piece_means(self) -> csr_array:
        """(P, V) the matrix of the mean over each piece."""
        counts = np.bincount(self._piece)
        where = (self._piece, np.arange(len(self._piece)))
        return csr_array((1 / counts[self._piece], where), shape=(len(counts), len(self._piece)))


def _edges_of(mesh: Mesh) -> Vectors:
    """Return the (3 F, 3) edges of each face."""
    return np.asarray(np.roll(mesh.verts[mesh.faces], -1, axis=1) - mesh.verts[mesh.faces]).reshape(-1, 3)


def _turned(vectors: Float64[np.ndarray, "... 3"], points: Vectors) -> Vectors:
    """Return points turned by rotation vectors: one for each, or one for all."""
    return np.asarray(Rotation.from_rotvec(vectors).apply(points)) if len(points) else points


def _scaled(moments: Float64[np.ndarray, "N 3 3"]) -> Float64[np.ndarray, "N 3 3"]:
    sizes = np.linalg.norm(moments, axis=(1, 2))[:, None, None]
    return np.asarray(np.divide(moments, sizes, out=np.zeros_like(moments), where=sizes > 0))


def _is_torn(vectors: Vectors, pairs: Int64[np.ndarray, "P 2"]) -> bool:
    """Return whether the rotation vectors of some neighbours differ by more than half a turn."""
    return bool((np.linalg.norm(vectors[pairs[:, 0]] - vectors[pairs[:, 1]], axis=1) > np.pi).any())


def _angles_between(rotations: Rotation, pairs: Int64[np.ndarray, "P 2"]) -> csr_array:
    """Return the (F, F) graph of neighbours, with the angle between their rotations."""
    one, other = pairs.T
    angles = (rotations[one].inv() * rotations[other]).magnitude() + _SMALL
    return coo_array((angles, (one, other)), shape=(len(rotations), len(rotations))).tocsr()


def _central(graph: csr_array) -> int:
    """Return the face in the middle of the two that are the farthest apart in a graph, on its largest piece."""
    piece = connected_components(graph, directed=False)[1]
    inside = piece == np.bincount(piece).argmax()
    end = int(inside.argmax())
    for _ in range(2):
        before = dijkstra(graph, directed=False, indices=[end])[0]
        end = int(np.where(inside, before, -1.0).argmax())
    farther = np.maximum(before, dijkstra(graph, directed=False, indices=[end])[0])
    return int(np.where(inside, farther, np.inf).argmin())


def _continued(vectors: Vectors, graph: csr_array) -> Vectors:
    """Return rotation vectors that differ by less than half a turn between neighbours, as far as that is possible.

    From the face that turns least, a spanning tree of the smallest angles adds whole turns where they are missing.

    Args:
        vectors: (F, 3) of faces.
        graph: (F, F) angles between neighbours.
    """
    tree = minimum_spanning_tree(graph)
    angles = np.linalg.norm(vectors, axis=1)
    piece = connected_components(tree, directed=False)[1]
    order = np.lexsort((angles, piece))
    roots = order[np.unique(piece[order], return_index=True)[1]]
    hops = dijkstra(tree, directed=False, indices=roots, unweighted=True, min_only=True)
    ends = np.array(tree.nonzero())
    inner, outer = np.take_along_axis(ends, np.argsort(hops[ends], axis=0, kind="stable"), axis=0)
    before = np.arange(len(vectors))
    before[outer] = inner
    result = vectors.copy()
    by_hops = np.argsort(hops, kind="stable")
    for faces in np.split(by_hops, np.searchsorted(hops[by_hops], np.arange(1, hops.max() + 1)))[1:]:
        parent = result[before[faces]]
        axes = np.where(angles[faces, None] > _SMALL, vectors[faces], parent)
        axes = unit_vectors(axes)
        own = (vectors[faces] * axes).sum(axis=1)
        turns = np.rint(((parent * axes).sum(axis=1) - own) / (2 * np.pi))
        result[faces] += (2 * np.pi * turns)[:, None] * axes
    return result
