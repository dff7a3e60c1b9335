"""The topology against naive counting over faces, on closed, open and non-manifold meshes."""

from collections import defaultdict
from itertools import combinations
from operator import attrgetter

import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.mesh.manifold import (
    describe_topology,
    euler_number,
    nonmanifold_edges,
    nonmanifold_verts,
    num_components,
    require_manifold,
)
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron, octahedron, tetrahedron
from meshfit.mesh.topology import NONE, PolygonTopology, Topology, next_in_face, previous_in_face
from tests.loops import over
from tests.shapes import ALL, CLOSED, fan, patch, wheel

BOOK = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
BOW_TIE = np.array([[0, 1, 2], [0, 3, 4]])
TWISTED = np.array([[0, 1, 2], [0, 1, 3]])
every_shape = over("shape", ALL)


def topology_of(shape: str) -> Topology:
    return Topology.of(ALL[shape]())


def faces_at_edges(faces: np.ndarray) -> dict[tuple[int, int], list[int]]:
    found = defaultdict(list)
    for number, face in enumerate(faces.tolist()):
        for k in range(3):
            found[tuple(sorted((face[k], face[(k + 1) % 3])))].append(number)
    return found


@every_shape
def test_half_edges_run_along_their_faces(shape):
    topology = topology_of(shape)
    for number, (a, b, c) in enumerate(topology.faces.tolist()):
        rows = slice(3 * number, 3 * number + 3)
        assert topology.tail[rows].tolist() == [a, b, c]
        assert topology.head[rows].tolist() == [b, c, a]
        assert topology.apex[rows].tolist() == [c, a, b]


def test_walking_within_a_face():
    halfedge = np.array([0, 1, 2, 30, 31, 32])
    assert next_in_face(halfedge).tolist() == [1, 2, 0, 31, 32, 30]
    assert previous_in_face(halfedge).tolist() == [2, 0, 1, 32, 30, 31]


@every_shape
def test_edges_and_their_faces(shape):
    topology = topology_of(shape)
    naive = faces_at_edges(topology.faces)
    assert [tuple(edge) for edge in topology.edges.tolist()] == sorted(naive)
    assert topology.faces_per_edge.tolist() == [len(naive[edge]) for edge in sorted(naive)]
    assert topology.num_edges == len(naive)
    for halfedge, edge in enumerate(topology.edge_of):
        assert sorted(topology.edges[edge]) == sorted((topology.tail[halfedge], topology.head[halfedge]))
    assert np.array_equal(topology.edge_of[topology.edge_halfedge], np.arange(topology.num_edges))


@every_shape
def test_twins_face_each_other(shape):
    topology = topology_of(shape)
    inner = np.flatnonzero(topology.twin != NONE)
    across = topology.twin[inner]
    assert np.array_equal(topology.twin[across], inner)
    assert np.array_equal(topology.tail[across], topology.head[inner])
    assert not (across // 3 == inner // 3).any()
    assert len(inner) == 2 * sum(len(faces) == 2 for faces in faces_at_edges(topology.faces).values())


@every_shape
def test_face_pairs(shape):
    topology = topology_of(shape)
    found = {tuple(sorted(pair)) for pair in (topology.face_pairs // 3).tolist()}
    naive = {pair for faces in faces_at_edges(topology.faces).values() for pair in combinations(faces, 2)}
    assert found == naive


def test_three_faces_at_one_edge_make_three_pairs():
    topology = Topology(5, BOOK)
    assert sorted(tuple(sorted(pair)) for pair in (topology.face_pairs // 3).tolist()) == [(0, 1), (0, 2), (1, 2)]
    assert (topology.twin == NONE).all()


@every_shape
def test_valence_and_boundary(shape):
    topology = topology_of(shape)
    neighbours, border = defaultdict(set), set()
    for (a, b), faces in faces_at_edges(topology.faces).items():
        neighbours[a].add(b)
        neighbours[b].add(a)
        border |= {a, b} if len(faces) == 1 else set()
    assert topology.valence.tolist() == [len(neighbours[v]) for v in range(topology.num_verts)]
    assert set(np.flatnonzero(topology.boundary_verts)) == border
    assert (len(border) == 0) == (shape in CLOSED)


@every_shape
def test_boundary_neighbours_follow_the_faces(shape):
    """The surface lies to the left: the directed edge from a boundary vertex to the next is one of a face."""
    topology = topology_of(shape)
    directed = set(zip(topology.tail.tolist(), topology.head.tolist(), strict=True))
    for vert, (before, after) in enumerate(topology.boundary_neighbours.tolist()):
        assert (before == NONE) == (after == NONE) == (not topology.boundary_verts[vert])
        if after != NONE:
            assert {(before, vert), (vert, after)} <= directed
            assert not {(vert, before), (after, vert)} & directed


def test_turning_around_a_vertex_is_counter_clockwise():
    topology = Topology.of(wheel(7, 2))
    halfedge = np.flatnonzero((topology.tail == 0) & (topology.head == 1))
    ring = []
    for _ in range(7):
        ring.append(int(topology.head[halfedge[0]]))
        halfedge = topology.next_around_tail(halfedge)
    assert ring == [1, 2, 3, 4, 5, 6, 7]
    open_fan = Topology.of(fan(3, 1))
    last = np.flatnonzero((open_fan.tail == 0) & (open_fan.head == 2))
    assert open_fan.next_around_tail(last).tolist() == [NONE]


@over(("mesh", "euler"), [(tetrahedron(), 2), (icosahedron(), 2), (patch(4, 3), 1), (ALL["torus"](), 0), (wheel(5), 1)])
def test_euler_number_does_not_count_verts_without_faces(mesh, euler):
    topology = Topology(mesh.num_verts + 3, mesh.faces)
    assert euler_number(topology) == euler
    assert num_components(topology) == 1


def test_components_and_watertightness():
    two = np.concatenate([octahedron().faces, tetrahedron().faces + 6])
    topology = Topology(10, two)
    assert num_components(topology) == 2
    assert euler_number(topology) == 4
    assert topology.is_watertight
    assert not Topology(10, two[1:]).is_watertight
    assert not Topology(10, np.concatenate([two[:1, ::-1], two[1:]])).is_watertight
    assert not Topology(3, np.empty((0, 3), dtype=np.int64)).is_watertight


@over(
    ("faces", "fault", "number", "message"),
    [
        (BOOK, nonmanifold_edges, 0, r"the test needs a manifold mesh: edge \(0, 1\) has 3 faces"),
        (BOW_TIE, nonmanifold_verts, 0, r"vertex 0 joins separate fans of faces \(1 such vertex\)"),
        (TWISTED, attrgetter("misoriented_edges"), 0, r"edge \(0, 1\) has two faces of opposite orientation"),
    ],
)
def test_what_is_no_manifold_is_refused_by_name(faces, fault, number, message):
    topology = Topology(5, faces)
    assert fault(topology).tolist() == [number]
    with pytest.raises(MeshError, match=message):
        require_manifold(topology, "the test")


def test_two_cones_at_one_tip_are_no_manifold():
    """Every edge has two faces; the fault is at the vertex alone."""
    solid = tetrahedron()
    names = np.array([0, 4, 5, 6])
    topology = Topology(7, np.concatenate([solid.faces, names[solid.faces]]))
    assert topology.is_watertight
    assert nonmanifold_verts(topology).tolist() == [0]


@pytest.mark.parametrize(("around", "closed"), [(300, True), (300, False), (10, True)])
def test_a_hub_of_many_faces_in_two_fans_is_no_manifold(around, closed):
    last = around if closed else around - 1
    rim = np.stack([np.arange(last), (np.arange(last) + 1) % around], axis=1)
    one, other = 2 + rim, 2 + around + rim
    fans = [np.insert(one, 0, 0, axis=1), np.insert(other, 0, 0, axis=1), np.insert(one[:, ::-1], 0, 1, axis=1)]
    assert nonmanifold_verts(Topology(2 + 2 * around, np.concatenate(fans))).tolist() == [0]
    assert nonmanifold_verts(Topology(2 + 2 * around, np.concatenate(fans[::2]))).tolist() == []


@every_shape
def test_manifolds_are_let_through(shape):
    topology = topology_of(shape)
    require_manifold(topology, "the test")
    for faults in (nonmanifold_edges, attrgetter("misoriented_edges"), nonmanifold_verts):
        assert len(faults(topology)) == 0


@over(
    ("faces", "message"),
    [
        ([[0, 1, 2], [0, 2, 1]], "faces 0 and 1 are triangles with the same three vertices; remove one of them"),
        ([[0, 0, 1]], r"face 0 is \[0, 0, 1\]: it has a vertex twice"),
    ],
)
def test_faces_that_no_manifold_has_are_refused(faces, message):
    """Two faces on the same three verts, or one that meets a vertex twice: no complex of triangles has them."""
    with pytest.raises(MeshError, match=message):
        require_manifold(Topology.of(Mesh(np.eye(3), np.array(faces))), "the test")


MOEBIUS = [[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 0], [4, 0, 1]]
PROJECTIVE_PLANE = [
    *[[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 5, 1]],
    *[[1, 2, 4], [2, 3, 5], [3, 4, 1], [4, 5, 2], [5, 1, 3]],
]
SPHERE, TORUS, DISK = tetrahedron().faces, ALL["torus"]().faces, patch(4, 4).faces
FLIPPED = np.concatenate([SPHERE[:1, ::-1], SPHERE[1:]])
TUBE = [face for k in range(3) for face in ([k, (k + 1) % 3, k + 3], [(k + 1) % 3, (k + 1) % 3 + 3, k + 3])]


@over(
    ("pieces", "words"),
    [
        ([SPHERE], "1 piece, closed, genus 0"),
        ([TORUS], "1 piece, closed, genus 1"),
        ([TORUS, SPHERE, TORUS], "3 pieces, closed, total genus 2"),
        ([FLIPPED], "1 piece, closed, genus 0"),
        ([[[0, 1, 2]]], "1 piece, open, 1 boundary loop, Euler number 1"),
        ([DISK, DISK], "2 pieces, open, 2 boundary loops, Euler number 2"),
        ([TUBE], "1 piece, open, 2 boundary loops, Euler number 0"),
        ([MOEBIUS], "1 piece, open, not orientable, 1 boundary loop, Euler number 0"),
        ([PROJECTIVE_PLANE], "1 piece, closed, not orientable, Euler number 1"),
        ([BOOK], "1 piece, not manifold, 3 boundary loops, Euler number 1"),
        ([BOW_TIE], "1 piece, not manifold, 2 boundary loops, Euler number 1"),
        (
            [DISK, TORUS, BOW_TIE, SPHERE, PROJECTIVE_PLANE],
            "5 pieces: 2 closed, total genus 1; 1 closed, not orientable, Euler number 1; "
            "1 open, 1 boundary loop, Euler number 1; 1 not manifold, 2 boundary loops, Euler number 1",
        ),
        ([], "no faces"),
    ],
)
def test_topology_in_words(pieces, words):
    """Vertices without faces lie between the pieces, and count for nothing."""
    faces, num_verts = [], 1
    for piece in pieces:
        faces.append(np.array(piece) + num_verts)
        num_verts += int(np.max(piece)) + 3
    topology = Topology(num_verts, np.concatenate([np.empty((0, 3), dtype=np.int64), *faces]))
    assert describe_topology(topology) == words
    assert describe_topology(PolygonTopology.of(topology)) == words
    lone = [topology, *(Topology(num_verts, piece) for piece in faces)]
    assert euler_number(lone[0]) == sum(euler_number(piece) for piece in lone[1:])
