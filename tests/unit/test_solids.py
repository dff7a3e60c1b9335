"""The named solids have the properties of their names."""

import numpy as np

from meshfit.mesh.geometry import area_vectors, corner_angles, face_areas
from meshfit.mesh.manifold import euler_number, num_components, require_manifold
from meshfit.mesh.solids import SOLIDS
from meshfit.mesh.topology import Topology
from tests.loops import over

COUNTS = {"tetrahedron": (4, 4, {3}), "octahedron": (6, 8, {4}), "icosahedron": (12, 20, {5}), "cube": (8, 12, {3, 6})}
EDGES = {"tetrahedron": np.sqrt(8 / 3), "octahedron": np.sqrt(2), "icosahedron": 4 / np.sqrt(10 + 2 * np.sqrt(5))}
every_solid = over("name", SOLIDS)


def test_every_solid_is_tested_here():
    assert COUNTS.keys() == SOLIDS.keys()


@every_solid
def test_counts_and_valences(name):
    mesh = SOLIDS[name]()
    assert (mesh.num_verts, mesh.num_faces, set(Topology.of(mesh).valence.tolist())) == COUNTS[name]


@every_solid
def test_verts_lie_on_the_unit_sphere_about_0(name):
    verts = SOLIDS[name]().verts
    assert np.allclose(np.linalg.norm(verts, axis=1), 1, rtol=0, atol=1e-15)
    assert np.allclose(verts.mean(axis=0), 0, atol=1e-15)


@every_solid
def test_surfaces_are_closed_and_of_one_piece(name):
    topology = Topology.of(SOLIDS[name]())
    require_manifold(topology, "this test")
    assert topology.is_watertight
    assert num_components(topology) == 1
    assert euler_number(topology) == 2


@every_solid
def test_faces_look_outwards(name):
    mesh = SOLIDS[name]()
    assert ((area_vectors(mesh) * mesh.verts[mesh.faces].mean(axis=1)).sum(axis=1) > 0).all()


@over("name", EDGES)
def test_edges_are_as_long_as_geometry_says(name):
    mesh = SOLIDS[name]()
    ends = mesh.verts[Topology.of(mesh).edges]
    assert np.allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), EDGES[name])
    assert np.allclose(np.degrees(corner_angles(mesh)), 60)


def test_sides_of_the_cube_are_flat_squares_in_two_halves():
    mesh = SOLIDS["cube"]()
    assert np.allclose(face_areas(mesh), (2 / np.sqrt(3)) ** 2 / 2)
    assert np.allclose(np.sort(np.degrees(corner_angles(mesh)), axis=1), [45, 45, 90])
    assert np.allclose(np.abs(mesh.verts), 1 / np.sqrt(3))


@every_solid
def test_each_call_builds_the_same(name):
    first, second = SOLIDS[name](), SOLIDS[name]()
    assert np.array_equal(first.verts, second.verts)
    assert np.array_equal(first.faces, second.faces)
