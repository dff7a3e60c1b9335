"""Deformation graphs: nodes on a mesh whose rotations and translations move the vertices around them.

Sumner, Schmid, Pauly, *Embedded deformation for shape manipulation*, 2007; stiffness along the edges of the graph as
rigid as possible (Sorkine and Alexa 2007), with a rotation at each node.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from meshfit.fitting.registration.template import Template
from meshfit.mesh.geometry import nearest_rotations, unit_vectors
from meshfit.mesh.mesh import Verts

Rotations = Float64[np.ndarray, "N 3 3"]

# Nodes that move a vertex: the nearest ones, whose weights end at so many covering radii.
_NODES_PER_VERT, _REACH = 6, 2.0
# Distances from a node are computed up to so many present covering radii, which is beyond its reach in the end.
_SEARCH = 1.3 * _REACH
# Nodes beyond the wanted number, so that each piece of the mesh has one.
_MORE_NODES = 200
# Smallest and largest scale at a node.
_SCALES = (0.2, 5.0)


@dataclass(frozen=True, eq=False)
class DeformationGraph:
    """Nodes on a mesh, each with a rotation about itself and a translation.

    A vertex v goes to Σ w (R (v - g) + g + t) over its nodes g.

    Attributes:
        rest: (V, 3) the vertices at rest.
        nodes: (N, 3) positions of the nodes at rest.
        node_verts: (N,) vertices that the nodes are at.
        node_of: (V, K) nodes of each vertex.
        weights: (V, K) their weights, with a sum of 1; 0 for places that are not used.
        tail: (E,) a node of each ordered pair of nodes that move a common vertex.
        head: (E,) the other.
        shares: (E,) weight of the pair: 1, or less for nodes that have little in common.
        rotations: (N, 3, 3).
        translations: (N, 3).
    """

    rest: Verts
    nodes: Float64[np.ndarray, "N 3"]
    node_verts: Int64[np.ndarray, " N"]
    node_of: Int64[np.ndarray, "V K"]
    weights: Float64[np.ndarray, "V K"]
    tail: Int64[np.ndarray, " E"]
    head: Int64[np.ndarray, " E"]
    shares: Float64[np.ndarray, " E"]
    rotations: Rotations
    translations: Float64[np.ndarray, "N 3"]

    @classmethod
    def of(cls, template: Template, count: int) -> "DeformationGraph":
        """Spread about `count` nodes over a mesh, by distances along its edges, and weigh them."""
        verts = template.mesh.verts
        chosen, reached = _spread(template, count)
        node_of, weights = _nearest_nodes(verts, chosen, reached)
        matrix = _matrix(node_of, weights, len(chosen))
        common = (matrix.T @ matrix).tocoo()
        pairs = common.row != common.col
        share = common.data[pairs]
        return cls(
            rest=verts,
            nodes=verts[chosen],
            node_verts=np.array(chosen),
            node_of=node_of,
            weights=weights,
            tail=common.row[pairs].astype(np.int64),
            head=common.col[pairs].astype(np.int64),
            shares=np.minimum(1.0, share / np.median(share)) if len(share) else share,
            rotations=np.tile(np.eye(3), (len(chosen), 1, 1)),
            translations=np.zeros((len(chosen), 3)),
        )

    @property
    def num_nodes(self) -> int:
        """N, the number of nodes."""
        return len(self.nodes)

    def positions(self) -> Verts:
        """Return (V, 3) where the vertices are."""
        turned = np.einsum("vkij,vkj->vki", self.rotations[self.node_of], self._arms())
        moved = turned + (self.nodes + self.translations)[self.node_of]
        return np.asarray((moved * self.weights[:, :, None]).sum(axis=1))

    def turned(self, vectors: Float64[np.ndarray, "V 3"]) -> Float64[np.ndarray, "V 3"]:
        """Return unit vectors at the vertices, turned by the mean rotation of their nodes."""
        mean = (self.rotations[self.node_of] * self.weights[:, :, None, None]).sum(axis=1)
        return unit_vectors(np.einsum("vij,vj->vi", mean, vectors))

    def restricted(self, verts: Int64[np.ndarray, " M"]) -> "DeformationGraph":
        """Return the graph with some of its vertices only."""
        return replace(self, rest=self.rest[verts], node_of=self.node_of[verts], weights=self.weights[verts])

    def posed(self, verts: Verts) -> "DeformationGraph":
        """Return the graph of the same mesh at rest in another pose and size."""
        return replace(self, rest=verts, nodes=verts[self.node_verts])

    def fitted_to(self, verts: Verts, *, similar: bool = False) -> "DeformationGraph":
        """Return the graph with the rotations and translations that bring its vertices nearest to `verts`.

        Args:
            verts: (V, 3) positions.
            similar: with a scale at each node, as a factor of the rotation.
        """
        gather = _matrix(self.node_of, self.weights, self.num_nodes).T.tocsr()
        total = gather.sum(axis=1)[:, None]
        centre, goal = gather @ self.rest / total, gather @ verts / total
        products = (self.rest[:, :, None] * verts[:, None, :]).reshape(-1, 9)
        moments = (gather @ products).reshape(-1, 3, 3) - total[:, :, None] * centre[:, :, None] * goal[:, None, :]
        rotations = nearest_rotations(moments)
        if similar:
            spread = gather @ (self.rest**2).sum(axis=1) - total[:, 0] * (centre**2).sum(axis=1)
            scales = np.einsum("nij,nji->n", rotations, moments) / np.maximum(spread, 1e-300)
            rotations = np.clip(scales, *_SCALES)[:, None, None] * rotations
        translations = goal - self.nodes - np.einsum("nij,nj->ni", rotations, centre - self.nodes)
        return self.placed(rotations, translations)

    def moved(self, step: Float64[np.ndarray, "N 6"], largest_turn: float) -> "DeformationGraph":
        """Return the graph after a step: a turn and a translation of each node.

        Args:
            step: (N, 6) rotation vectors, then translations.
            largest_turn: angle beyond which a turn is shortened.
        """
        turns = step[:, :3]
        angles = np.linalg.norm(turns, axis=1, keepdims=True)
        turns = turns * np.minimum(1.0, largest_turn / np.maximum(angles, 1e-12))
        rotations = rotation_matrices(turns) @ self.rotations
        return self.placed(rotations, self.translations + step[:, 3:])

    def rescaled(self) -> "DeformationGraph":
        """Return the graph with the local scale at each node that its edges have, as a factor of the rotation.

        The stiffness then is that of similarities: a part may grow or shrink, if those around it do so gradually.
        """
        units = self.rotations / np.cbrt(np.linalg.det(self.rotations))[:, None, None]
        arms = self.nodes[self.head] - self.nodes[self.tail]
        moved = (self.nodes + self.translations)[self.head] - (self.nodes + self.translations)[self.tail]
        along = (np.einsum("eij,ej->ei", units[self.tail], arms) * moved).sum(axis=1)
        squares = (arms**2).sum(axis=1)
        total, spread = (np.bincount(self.tail, self.shares * each, self.num_nodes) for each in (along, squares))
        scales = np.divide(total, spread, out=np.ones(self.num_nodes), where=spread > 0)
        return self.placed(np.clip(scales, *_SCALES)[:, None, None] * units, self.translations)

    def placed(self, rotations: Rotations, translations: Float64[np.ndarray, "N 3"]) -> "DeformationGraph":
        """Return the graph with these rotations and translations of its nodes."""
        return replace(self, rotations=rotations, translations=translations)

    def jacobian(self, verts: Int64[np.ndarray, " M"], roots: Float64[np.ndarray, "M 3 3"]) -> csr_array:
        """Return the (3 M, 6 N) derivative of L x by a step, for some vertices x and a 3 × 3 matrix L for each."""
        node_of, weights = self.node_of[verts], self.weights[verts]
        arms = self.rest[verts][:, None] - self.nodes[node_of]
        arms = np.einsum("mkij,mkj->mki", self.rotations[node_of], arms) * weights[:, :, None]
        by_turn = np.cross(arms[:, None, :, :], roots[:, :, None, :])
        by_translation = weights[:, None, :, None] * roots[:, :, None, :]
        values = np.concatenate([by_turn, by_translation], axis=3)
        columns = np.broadcast_to((6 * node_of[:, None, :, None] + np.arange(6)), values.shape)
        return _rows(values, columns, 3 * len(verts), 6 * self.num_nodes)

    def stiffness(self) -> tuple[csr_array, Float64[np.ndarray, " R"]]:
        """Return the derivative of R (g' - g) + g + t - g' - t' by a step, over the pairs of nodes, and its value."""
        arms = self.nodes[self.head] - self.nodes[self.tail]
        turned = np.einsum("eij,ej->ei", self.rotations[self.tail], arms)
        starts, ends = (self.nodes + self.translations)[self.tail], (self.nodes + self.translations)[self.head]
        eye = np.broadcast_to(np.eye(3), (len(arms), 3, 3))
        values = np.concatenate([-cross_matrices(turned), eye, -eye], axis=2)
        columns = np.concatenate([6 * self.tail[:, None] + np.arange(6), 6 * self.head[:, None] + np.arange(3, 6)], 1)
        columns = np.broadcast_to(columns[:, None], values.shape)
        return _rows(values, columns, 3 * len(arms), 6 * self.num_nodes), (turned + starts - ends).ravel()

    def _arms(self) -> Float64[np.ndarray, "V K 3"]:
        return np.asarray(self.rest[:, None] - self.nodes[self.node_of])


def rotation_matrices(vectors: Float64[np.ndarray, "N 3"]) -> Rotations:
    """Return the rotations of rotation vectors (Rodrigues)."""
    angles = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)[:, None, None]
    cross = cross_matrices(vectors)
    return np.asarray(np.eye(3) + np.sin(angles) / angles * cross + (1 - np.cos(angles)) / angles**2 * (cross @ cross))


def cross_matrices(vectors: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 3 3"]:
    """Return the matrices of x ↦ v × x."""
    result = np.zeros((len(vectors), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[:, i, j], result[:, j, i] = -vectors[:, k], vectors[:, k]
    return result


def _spread(template: Template, count: int) -> tuple[list[int], list[tuple[np.ndarray, np.ndarray]]]:
    """Return vertices that are far from each other along edges, and the vertices around each with their distances."""
    verts, (tail, head) = template.mesh.verts, template.edges.T
    # Both ways: an undirected search would transpose the graph each time.
    ends = np.concatenate([tail, head]), np.concatenate([head, tail])
    graph = coo_array((np.tile(template.rest_lengths, 2), ends), shape=(len(verts), len(verts))).tocsr()
    chosen = [int(np.linalg.norm(verts - verts.mean(axis=0), axis=1).argmax())]
    least = np.full(len(verts), np.inf)
    reached = list[tuple[np.ndarray, np.ndarray]]()
    while True:
        limit = np.inf if len(chosen) == 1 else _SEARCH * float(least.max())
        distances = dijkstra(graph, indices=[chosen[-1]], limit=limit)[0]
        rows = np.flatnonzero(np.isfinite(distances))
        reached.append((rows, distances[rows]))
        least[rows] = np.minimum(least[rows], distances[rows])
        enough = len(chosen) >= count and bool(np.isfinite(least).all())
        if enough or len(chosen) >= min(count + _MORE_NODES, len(verts)):
            return chosen, reached
        chosen.append(int(least.argmax()))


def _nearest_nodes(
    verts: Verts, chosen: list[int], reached: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes of each vertex, and their weights: (1 - (distance / reach)²)³, in shares."""
    least = np.full(len(verts), np.inf)
    for rows, distances in reached:
        least[rows] = np.minimum(least[rows], distances)
    reach = _REACH * float(least[np.isfinite(least)].max())
    vert = np.concatenate([rows[distances < reach] for rows, distances in reached])
    node = np.concatenate([np.full((distances < reach).sum(), k) for k, (_, distances) in enumerate(reached)])
    far = np.concatenate([distances[distances < reach] for _, distances in reached])
    weight = (1 - (far / reach) ** 2) ** 3
    order = np.lexsort((-weight, vert))
    vert, node, weight = vert[order], node[order], weight[order]
    place = np.arange(len(vert)) - np.searchsorted(vert, np.arange(len(verts)))[vert]
    kept = place < _NODES_PER_VERT
    node_of, weights = (np.zeros((len(verts), _NODES_PER_VERT), dtype) for dtype in (np.int64, np.float64))
    node_of[vert[kept], place[kept]] = node[kept]
    weights[vert[kept], place[kept]] = weight[kept]
    lone = ~weights.any(axis=1)
    if lone.any():  # on pieces beyond the largest number of nodes
        node_of[lone, 0] = cKDTree(verts[chosen]).query(verts[lone])[1]
        weights[lone, 0] = 1.0
    node_of = np.where(weights > 0, node_of, node_of[:, :1])
    return node_of, weights / weights.sum(axis=1, keepdims=True)


def _matrix(node_of: np.ndarray, weights: np.ndarray, num_nodes: int) -> csr_array:
    rows = np.arange(len(node_of)).repeat(node_of.shape[1])
    return csr_array((weights.ravel(), (rows, node_of.ravel())), shape=(len(node_of), num_nodes))


def _rows(values: np.ndarray, columns: np.ndarray, count: int, width: int) -> csr_array:
    """Return a sparse matrix of `count` rows with equally many entries each."""
    starts = np.linspace(0, values.size, count + 1).astype(np.int32)
    flat = np.ascontiguousarray(columns).reshape(-1).astype(np.int32)
    return csr_array((np.ascontiguousarray(values).reshape(-1), flat, starts), shape=(count, width))
