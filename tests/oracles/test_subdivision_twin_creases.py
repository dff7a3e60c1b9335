"""A plain twin of Loop and of its interpolatory blend with creases, vertex by vertex, from the published rules.

Where sharpness ends within a level, OpenSubdiv's way: the rule before it and the rule after it, by the mean of what is
left of the sharpness that ends.
"""

from math import cos, inf, pi

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.subdivision.creases import Creases
from meshfit.subdivision.refine import subdivide
from tests.laws.naive import Walk, same_face_sets
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, opened, patch, real

MESHES = {
    "mixed closed": mixed_closed,
    "mixed open": mixed_open,
    "cow": lambda: real("cow", 300),
    "open mousehead": lambda: opened(real("mousehead", 300), 7),
    "patch": lambda: patch(5, 4),
}


class Creased(Walk):
    """A mesh with the sharpness of its edges in a dictionary, with infinitely sharp boundaries."""

    def __init__(self, mesh: Mesh, sharpness: dict[frozenset, float], corners: set[int]) -> None:
        super().__init__(mesh)
        self.corners = corners
        self.sharpness = {frozenset(edge): sharpness.get(frozenset(edge), 0.0) for edge in self.edges()}
        self.sharpness |= {frozenset(edge): inf for edge in self.rim.items()}

    def old(self, v: int) -> np.ndarray:
        """Loop's rule for a vertex."""
        around = {w: self.sharpness[frozenset((v, w))] for w in self.neighbours[v]}
        ending = [s for s in around.values() if 0 < s <= 1]
        before = self._by(v, [w for w, s in around.items() if s > 0])
        if not ending:
            return before
        share = sum(ending) / len(ending)
        return share * before + (1 - share) * self._by(v, [w for w, s in around.items() if s > 1])

    def _by(self, v: int, sharp: list[int]) -> np.ndarray:
        if v in self.corners or len(sharp) > 2:
            return self.points[v]
        if len(sharp) == 2:
            return (self.points[sharp[0]] + 6 * self.points[v] + self.points[sharp[1]]) / 8
        n = self.valence(v)
        share = 5 / 8 - (3 / 8 + cos(2 * pi / n) / 4) ** 2
        return (1 - share) * self.points[v] + share / n * sum(self.points[w] for w in self.neighbours[v])

    def new(self, a: int, b: int) -> np.ndarray:
        """Loop's rule for an edge."""
        ends = self.points[a] + self.points[b]
        s = min(self.sharpness[frozenset((a, b))], 1)
        if s == 1:
            return ends / 2
        wings = self.points[self.apex[a, b]] + self.points[self.apex[b, a]]
        return s * ends / 2 + (1 - s) * (3 * ends + wings) / 8


def refined_once(walk: Creased, alpha: float) -> Creased:
    """One level, edges' verts in the order in which `edges` lists them."""
    loop = [walk.old(v) for v in range(len(walk.points))]
    lost = [point - moved for point, moved in zip(walk.points, loop, strict=True)]
    points = [moved + alpha * shift for moved, shift in zip(loop, lost, strict=True)]
    middle, sharpness = {}, {}
    for a, b in walk.edges():
        new = len(points)
        points.append(walk.new(a, b) + alpha * (lost[a] + lost[b]) / 2)
        middle[frozenset((a, b))] = new
        for end in (a, b):
            sharpness[frozenset((end, new))] = max(walk.sharpness[frozenset((a, b))] - 1, 0)
    faces = []
    for a, b, c in walk.faces:
        p, q, r = (middle[frozenset(edge)] for edge in ((a, b), (b, c), (c, a)))
        faces += [(a, p, r), (b, q, p), (c, r, q), (p, q, r)]
    return Creased(Mesh(np.array(points), np.array(faces)), sharpness, walk.corners)


@pytest.mark.slow
@over("make", MESHES.values())
@over("seed", [0, 1])
@pytest.mark.parametrize(("spec", "alpha"), [("loop", 0), ("interp-loop", 1), ("interp-loop:alpha=0.4", 0.4)])
def test_twins(make, seed, spec, alpha):
    mesh, generator = make(), np.random.default_rng(seed)
    topology = Topology.of(mesh)
    edges = topology.edges[generator.random(topology.num_edges) < 0.4]
    sharpness = generator.choice([0.1, 0.7, 1.0, 1.25, 2.6, inf], size=len(edges))
    corners = np.flatnonzero(generator.random(mesh.num_verts) < 0.1)
    walk = Creased(
        mesh, {frozenset(e): s for e, s in zip(edges.tolist(), sharpness, strict=True)}, set(corners.tolist())
    )
    for _ in range(3):
        walk = refined_once(walk, alpha)
    ours = subdivide(mesh, spec, 3, creases=Creases.of(topology, edges, sharpness, corners))
    twin = np.array(walk.points)
    distance, name = cKDTree(ours.verts).query(twin)
    assert distance.max() < 1e-13 * max(1.0, float(np.abs(mesh.verts).max()))
    assert len(np.unique(name)) == len(twin) == ours.num_verts
    assert same_face_sets(name[np.array(walk.faces)], ours.faces)
