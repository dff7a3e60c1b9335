"""The subdivision matrix around one vertex: its first rings after refinement from the same rings before."""

from fractions import Fraction

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import NONE, Topology, next_in_face
from meshfit.subdivision.masks import CurveMask
from meshfit.subdivision.refine import refine
from meshfit.subdivision.registry import SCHEMES, resolve
from meshfit.subdivision.triangles.scheme import FaceMask, Split, TriangleScheme
from tests.shapes import fan, wheel


def local_matrix(valence: int, scheme: str | TriangleScheme, rings: int = 2) -> np.ndarray:
    """Around an interior vertex, 1 + n r (r + 1) / 2 square; of two steps for √3 schemes, which turn back by then."""
    return _local_matrix(wheel(valence, rings + 2), scheme, rings)


def boundary_matrix(neighbours: int, scheme: str, rings: int = 2) -> np.ndarray:
    """The same around a boundary vertex, of one 1-to-4 step."""
    return _local_matrix(fan(neighbours, rings + 2), scheme, rings)


def _local_matrix(mesh: Mesh, scheme: str | TriangleScheme, rings: int) -> np.ndarray:
    scheme = resolve(scheme) if isinstance(scheme, str) else scheme
    levels = 1 if scheme.split is Split.QUADRISECT else 2
    topology = Topology.of(mesh)
    refinement = refine(topology, scheme, levels)
    fine = Topology(refinement.matrix.shape[0], refinement.faces)
    coarse_verts = ring_verts(topology, rings, mesh.verts)
    fine_verts = ring_verts(fine, rings, refine(topology, _linear(scheme.split), levels)(mesh.verts))
    rows = refinement.matrix.toarray()[fine_verts]
    assert not np.delete(rows, coarse_verts, axis=1).any(), "the rings do not suffice"
    return rows[:, coarse_verts]


def _linear(split: Split) -> TriangleScheme:
    """Linear interpolation on either split."""
    midpoint = SCHEMES["midpoint"].declare()
    if split is Split.QUADRISECT:
        return midpoint
    boundary = midpoint.boundary
    return TriangleScheme(split, FaceMask(Fraction(1, 3)), CurveMask(boundary.vert, boundary.inserted * 2))


def ring_verts(topology: Topology, rings: int, places: np.ndarray) -> list[int]:
    """Vertex 0, then for each ring its verts counter-clockwise, starting on the spoke nearest to the x axis.

    Every vertex of a ring is reached by walking straight along a spoke, then turning left by a sixth and walking on.
    """
    spokes = _spokes(topology, places)
    verts = [0]
    for ring in range(1, rings + 1):
        verts += [_walk(topology, spoke, ring - turned, turned) for spoke in spokes for turned in range(ring)]
    # On a boundary the last spoke has no face to its left: its verts are those before vertex 0.
    last = int(topology.boundary_neighbours[0, 0])
    for _ in range(rings if last != NONE else 0):
        verts.append(last)
        last = int(topology.boundary_neighbours[last, 0])
    return verts


def _spokes(topology: Topology, places: np.ndarray) -> np.ndarray:
    out = np.flatnonzero(topology.tail == 0)
    reach = places[topology.head[out]] - places[0]
    angle = np.arctan2(reach[:, 1], reach[:, 0])
    return out[np.argsort(np.where(angle < -1e-6, angle + 2 * np.pi, angle))]


def _walk(topology: Topology, halfedge: int, ahead: int, left: int) -> int:
    for step in range(1, ahead + left):
        halfedge = _turn(topology, halfedge, 2 if step == ahead else 3)
    return int(topology.head[halfedge])


def _turn(topology: Topology, halfedge: int, sixths: int) -> int:
    """Of the half-edges out of the head, the one so many places clockwise from the way back; 3 is straight on."""
    onward = next_in_face(np.array([halfedge]))
    for _ in range(sixths - 1):
        onward = next_in_face(topology.twin[onward])
    return int(onward[0])
