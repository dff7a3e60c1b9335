"""The template: what registration needs of a source mesh, at rest and as it moves."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from meshfit.fitting.gauss_newton.surface import Connectivity
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.mesh.geometry import signed_volume, unit_vectors
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.topology import Topology


@dataclass(frozen=True, eq=False)
class Template:
    """A source mesh whose vertices move while its faces stay.

    Attributes:
        mesh: the source at rest.
    """

    mesh: Mesh

    def posed(self, verts: Verts) -> "Template":
        """Return the template at rest in another pose and size, which have no effect on what is known of it already."""
        other = Template(self.mesh.with_verts(verts))
        known = "edges", "rim", "adjacency", "remoteness", "connectivity", "side", "_corners"
        other.__dict__.update({name: self.__dict__[name] for name in known if name in self.__dict__})
        return other

    @cached_property
    def edges(self) -> Int64[np.ndarray, "E 2"]:
        """Vertices of each edge."""
        return np.asarray(Topology.of(self.mesh).edges)

    @cached_property
    def rim(self) -> Bool[np.ndarray, " V"]:
        """Which vertices are on a boundary."""
        rim = np.zeros(self.mesh.num_verts, dtype=bool)
        rim[self.edges[Topology.of(self.mesh).faces_per_edge == 1].ravel()] = True
        return rim

    @cached_property
    def rest_lengths(self) -> Float64[np.ndarray, " E"]:
        """Length of each edge at rest."""
        return self.lengths_at(self.mesh.verts)

    def lengths_at(self, verts: Verts) -> Float64[np.ndarray, " E"]:
        """Return the length of each edge at some positions."""
        tail, head = self.edges.T
        return np.asarray(np.linalg.norm(verts[tail] - verts[head], axis=1))

    @cached_property
    def adjacency(self) -> csr_array:
        """(V, V) 1 for each pair of neighbours."""
        (tail, head), count = self.edges.T, self.mesh.num_verts
        ones, rows = np.ones(2 * len(tail)), np.concatenate([tail, head])
        return csr_array((ones, (rows, np.concatenate([head, tail]))), shape=(count, count))

    @cached_property
    def remoteness(self) -> Float64[np.ndarray, " V"]:
        """Mean distance of each vertex from others along edges, relative to the mean of all."""
        (tail, head), count = self.edges.T, self.mesh.num_verts
        graph = coo_array((self.rest_lengths, (tail, head)), shape=(count, count)).tocsr()
        return remoteness_in(graph)

    @cached_property
    def connectivity(self) -> Connectivity:
        """The faces and edges, for the geometry of faces."""
        return Connectivity(torch.tensor(self.mesh.faces), self.mesh.num_verts, torch.float64)

    @cached_property
    def _corners(self) -> csr_array:
        """(V, F) 1 for each corner."""
        faces = self.mesh.faces
        columns = np.arange(len(faces)).repeat(3)
        return csr_array((np.ones(faces.size), (faces.ravel(), columns)), shape=(self.mesh.num_verts, len(faces)))

    @cached_property
    def side(self) -> float:
        """-1 for a closed mesh that is inside out, such as a mirrored one, else 1."""
        inside_out = not self.rim.any() and signed_volume(self.mesh) < 0
        return -1.0 if inside_out else 1.0

    def points_at(self, verts: Verts) -> OrientedPoints:
        """Return the vertices at some positions, with their normals and areas there."""
        a, b, c = (verts[self.mesh.faces[:, k]] for k in range(3))
        vectors = np.cross(b - a, c - a)
        areas = np.linalg.norm(vectors, axis=1) / 6
        return OrientedPoints(
            verts, self.side * unit_vectors(self._corners @ vectors), self._corners @ areas, self.rim, self.remoteness
        )

    def grown(self, verts: Bool[np.ndarray, " V"], rings: int = 1) -> Bool[np.ndarray, " V"]:
        """Return some vertices and their neighbours, up to a number of rings."""
        for _ in range(rings):
            verts = verts | (self.adjacency @ verts.astype(np.float64) > 0)
        return verts


_LANDMARKS = 40


def remoteness_in(graph: csr_array) -> Float64[np.ndarray, " V"]:
    """Return the mean distance of each vertex of a graph from others, relative to the mean of all."""
    count = graph.shape[0]
    some = np.random.default_rng(0).choice(count, min(_LANDMARKS, count), replace=False)
    distances = dijkstra(graph, directed=False, indices=some)
    distances[~np.isfinite(distances)] = distances[np.isfinite(distances)].max()
    mean = distances.mean(axis=0)
    return np.asarray(mean / mean.mean() - 1)
