"""Mesh quality on meshes made for each metric."""

import numpy as np
import pytest

from meshfit.errors import MeasureError
from meshfit.measuring.quality import degenerate_faces, flipped_faces, mesh_quality, smallest_angle
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron, octahedron, tetrahedron
from meshfit.mesh.topology import Topology
from tests.loops import over


def triangles(verts, faces):
    return Mesh(np.array(verts, dtype=np.float64), np.array(faces, dtype=np.int64))


SQUARE = triangles([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def torus(around=24, across=12):
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = 2 * np.pi * u.ravel() / around, 2 * np.pi * v.ravel() / across
    verts = np.stack([(2 + np.cos(b)) * np.cos(a), (2 + np.cos(b)) * np.sin(a), np.sin(b)], axis=1)
    right, up = (u + 1) % around, (v + 1) % across
    corners = [(i * across + j).ravel() for i, j in ((u, v), (right, v), (right, up), (u, up))]
    faces = [np.stack([corners[i] for i in row], axis=1) for row in ((0, 1, 2), (0, 2, 3))]
    return Mesh(verts, np.concatenate(faces))


def joined(first, second):
    return Mesh(
        np.concatenate([first.verts, second.verts]), np.concatenate([first.faces, second.faces + first.num_verts])
    )


def plane(cuts=6):
    """A flat grid of equilateral triangles."""
    verts = np.array([(i + j / 2, j * np.sqrt(3) / 2, 0.0) for i in range(cuts + 1) for j in range(cuts + 1)])
    at = np.arange((cuts + 1) ** 2).reshape(cuts + 1, cuts + 1)
    a, b, c, d = (rows.ravel() for rows in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    return Mesh(verts, np.concatenate([np.stack([a, b, d], axis=1), np.stack([b, c, d], axis=1)]))


def wrapped(mesh, radius):
    """A flat mesh laid over a cylinder along y; infinity leaves it flat."""
    x, y, _ = mesh.verts.T
    return Mesh(np.stack([radius * np.sin(x / radius), y, radius * np.cos(x / radius) - radius], axis=1), mesh.faces)


def pushed_across(mesh, face, excess=0.1):
    """The first vertex of a face pushed through the middle of the opposite edge, by a share of its height."""
    verts = mesh.verts.copy()
    a, b, c = mesh.faces[face]
    verts[a] += (1 + excess) * ((verts[b] + verts[c]) / 2 - verts[a])
    return Mesh(verts, mesh.faces)


def count_flipped(mesh):
    return int(flipped_faces(mesh, Topology.of(mesh)).sum())


def test_open_square():
    found = mesh_quality(SQUARE)
    assert found.watertight is False
    assert (found.components, found.euler_number, found.verts, found.faces) == (1, 1, 4, 2)
    assert (found.self_intersecting_faces, found.flipped_faces, found.degenerate_faces) == (0, 0, 0)
    assert found.smallest_angle == pytest.approx(45)


@over("mesh", [cube(), octahedron(), icosahedron()])
def test_closed_solids_are_sound(mesh):
    found = mesh_quality(mesh)
    assert found.watertight is True
    assert (found.components, found.euler_number, found.verts, found.faces) == (1, 2, mesh.num_verts, mesh.num_faces)
    assert (found.self_intersecting_faces, found.flipped_faces, found.degenerate_faces) == (0, 0, 0)


def test_torus_has_euler_number_zero():
    found = mesh_quality(torus())
    assert (found.euler_number, found.components, found.watertight) == (0, 1, True)
    assert (found.self_intersecting_faces, found.flipped_faces) == (0, 0)


def test_two_components_that_cross():
    apart = mesh_quality(joined(cube(), Mesh(cube().verts + 5, cube().faces)))
    assert (apart.components, apart.euler_number, apart.self_intersecting_faces) == (2, 4, 0)
    crossing = mesh_quality(joined(cube(), Mesh(cube().verts + np.array([0.3, 0.2, 0.1]), cube().faces)))
    assert (crossing.components, crossing.watertight) == (2, True)
    assert crossing.self_intersecting_faces > 6


def test_crossing_triangles():
    verts = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.3, 0.2, 1], [0.2, 0.3, 1]]
    assert mesh_quality(triangles(verts, [[0, 1, 2], [3, 4, 5]])).self_intersecting_faces == 2


def test_verts_without_faces_are_counted_but_make_no_component():
    found = mesh_quality(Mesh(np.concatenate([cube().verts, [[0.1, 0.2, 0.3]]]), cube().faces))
    assert (found.verts, found.components, found.euler_number) == (9, 1, 2)


@over("radius", [np.inf, 30.0, 5.0])
def test_a_vertex_pushed_across_an_edge_flips_one_face(radius):
    with np.errstate(invalid="ignore"):
        sheet = plane() if np.isinf(radius) else wrapped(plane(), radius)
    face = next(i for i, row in enumerate(sheet.faces) if not Topology.of(sheet).boundary_verts[row].any())
    folded = pushed_across(sheet, face)
    assert count_flipped(sheet) == 0
    assert flipped_faces(folded, Topology.of(folded)).nonzero()[0].tolist() == [face]
    assert mesh_quality(folded).flipped_faces == 1


@over("mesh", [cube(), icosahedron(), torus()])
def test_inside_out_is_not_flipped_but_one_reversed_face_is(mesh):
    assert count_flipped(Mesh(mesh.verts, mesh.faces[:, ::-1])) == 0
    faces = mesh.faces.copy()
    faces[5] = faces[5, ::-1]
    odd = Mesh(mesh.verts, faces)
    assert flipped_faces(odd, Topology.of(odd))[5]
    assert mesh_quality(odd).watertight is False


def test_faces_that_meet_at_less_than_a_right_angle_are_flagged_as_documented():
    assert count_flipped(tetrahedron()) == 4


def test_degenerate_faces_are_those_without_area():
    extra = [[0, 0, 1], [2, 2, 2], [0, 4, 2]]  # two with repeated verts, one with three verts on a line
    mesh = Mesh(np.concatenate([SQUARE.verts, [[0.5, 0.5, 0]]]), np.concatenate([SQUARE.faces, extra]))
    assert degenerate_faces(mesh).tolist() == [False, False, True, True, True]
    assert mesh_quality(mesh).degenerate_faces == 3
    assert mesh_quality(mesh).smallest_angle == pytest.approx(0)


@over(("height", "degenerate"), [(3e-12, False), (1e-13, True)])
@over("scale", [1e-3, 1.0, 1e4])
def test_degenerate_is_relative_to_the_size_of_the_mesh(height, degenerate, scale):
    """The sliver's area is height / 2 and the squared diagonal 1: the limit lies at a height of 2e-12."""
    sliver = triangles(scale * np.array([[0, 0, 0], [1, 0, 0], [0.5, height, 0]]), [[0, 1, 2]])
    assert degenerate_faces(sliver).tolist() == [degenerate]


@over("angle", [1e-3, 5.0, 30.0, 59.0])
def test_smallest_angle_of_a_known_triangle(angle):
    apex = [np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0]
    mesh = triangles([[0, 0, 0], [1, 0, 0], apex], [[0, 1, 2]])
    assert smallest_angle(mesh) == pytest.approx(angle, rel=1e-9)
    assert smallest_angle(icosahedron()) == pytest.approx(60)


def test_a_mesh_without_a_surface_is_refused_by_its_role():
    with pytest.raises(MeasureError, match=r"^the result: expected finite .*nan.* at vertex 1"):
        mesh_quality(triangles([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]]), "result")
