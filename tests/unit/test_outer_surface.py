"""The outer surface of a mesh: hidden parts are dropped, and nothing else."""

import numpy as np
import pytest
from igl.copyleft import cgal

import meshfit
from meshfit.errors import MeshError
from meshfit.mesh.geometry import face_areas, face_normals, signed_volume
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.outer_surface import _outer_surface, outer_surface
from meshfit.mesh.pieces import piece_of_face
from meshfit.mesh.proximity import nearest_on_surface, winding_numbers
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.targets import load_target
from meshfit.mesh.topology import Topology
from tests.shapes import patch, torus
from tests.soups import ball, box, car, figure, grid, joined, room, teapot, tube, turned, two_balls

DISTANCE = np.sqrt(1.25)
HEIGHT = 0.0131


def area(mesh):
    return float(face_areas(mesh).sum())


def is_closed(mesh):
    return Topology.of(mesh).is_watertight


def share_kept(outer, part):
    """The share of a part's area that lies on an outer surface."""
    points = sample_surface(part, 2000, np.random.default_rng(0)).points
    return float((nearest_on_surface(outer, points).distances < 1e-6).mean())


def test_sound_meshes_are_returned_as_they_are():
    apart = joined(ball(level=1), ball((3.0, 0.0, 0.0), level=1))
    for mesh in (box((0, 0, 0), (1, 1, 1)), torus(), patch(), apart, ball(level=1)):
        equal = Mesh(mesh.verts.copy(), mesh.faces.copy())
        assert outer_surface(mesh) is mesh
        assert outer_surface(equal) is equal


def test_crossing_balls_are_united():
    balls = two_balls(level=4)
    outer = outer_surface(balls)
    assert is_closed(outer)
    assert piece_of_face(outer)[0] == 1
    # Each unit ball hides a cap of height 1 - d / 2 of the other; the faces are inside the sphere by 0.2 %.
    caps = 4 * np.pi * (1 - DISTANCE / 2)
    np.testing.assert_allclose(area(outer), 8 * np.pi - caps, rtol=4e-3)
    union = cgal.mesh_boolean(*(array for part in _two(balls) for array in (part.verts, part.faces)), "union")
    np.testing.assert_allclose(area(outer), area(Mesh(*union[:2])), rtol=1e-9)
    np.testing.assert_allclose(signed_volume(outer), signed_volume(Mesh(*union[:2])), rtol=1e-9)
    for first in (True, False):
        inverted = joined(*(turned(part) if number == first else part for number, part in enumerate(_two(balls))))
        np.testing.assert_allclose(area(outer_surface(inverted)), area(outer), rtol=1e-9)


def _two(mesh):
    half, verts = mesh.num_faces // 2, mesh.num_verts // 2
    return Mesh(mesh.verts[:verts], mesh.faces[:half]), Mesh(mesh.verts[verts:], mesh.faces[half:] - verts)


def test_what_lies_in_a_cavity_is_hidden():
    shell, core = ball(level=2), ball(radius=0.6, level=2)
    for inner in (core, turned(core), joined(turned(core), ball(radius=0.3, level=1))):
        outer = outer_surface(joined(inner, shell))
        assert outer.num_faces == shell.num_faces
        np.testing.assert_allclose(area(outer), area(shell))
    # The walls of the hollow and the ball in it are hidden.
    outer = outer_surface(room())
    assert is_closed(outer)
    middle = outer.verts[outer.faces].mean(axis=1)
    assert (np.abs(middle).max(axis=1) > 0.95).all()


def test_a_piece_that_crosses_itself_keeps_its_outside():
    cow = load_target("cow")
    outer = outer_surface(cow)
    assert is_closed(outer)
    assert area(outer) < area(cow) - 0.01
    middle, off = outer.verts[outer.faces].mean(axis=1), 1e-6 * face_normals(outer)
    largest = np.argsort(-face_areas(outer))[:500]
    outside, inside = (winding_numbers(cow, (middle + side)[largest], exact=True) for side in (off, -off))
    np.testing.assert_allclose(outside, 0, atol=1e-6)
    np.testing.assert_allclose(inside, 1, atol=1e-6)


def test_a_sheet_is_cut_where_a_ball_hides_it():
    sheet, unit = grid((0, 0, HEIGHT), (2, 0, 0), (0, 2, 0)), ball()
    cut = area(Mesh(*cgal.mesh_boolean(unit.verts, unit.faces, *_flat_box(), "intersect")[:2])) / 2
    outer = outer_surface(joined(sheet, unit))
    np.testing.assert_allclose(area(outer), area(unit) + 16 - cut, rtol=1e-5)
    inner = grid((0, 0, 0), (0.3, 0, 0), (0, 0.3, 0))
    np.testing.assert_allclose(area(outer_surface(joined(inner, unit))), area(unit))


def _flat_box():
    thin = box((-2, -2, HEIGHT - 1e-7), (2, 2, HEIGHT + 1e-7))
    return thin.verts, thin.faces


def test_insides_of_a_soup_are_hidden_unless_its_windows_are_open():
    panels, seats = car()
    outer = outer_surface(joined(panels, seats))
    assert share_kept(outer, panels) > 0.98
    assert share_kept(outer, seats) < 0.02
    panels, seats = car(glazed=False)
    outer = outer_surface(joined(panels, seats))
    assert share_kept(outer, panels) > 0.98
    backs = grid((0.15, 0.4, 0.5), (0, 0.2, 0), (0, 0, 0.15))
    assert share_kept(outer, backs) > 0.9
    # Every face twice, wound both ways.
    panels, seats = car()
    outer = outer_surface(joined(panels, turned(panels), seats))
    assert share_kept(outer, seats) < 0.02


def test_tubes_that_end_inside_a_body_are_cut_there():
    pot = teapot()
    outer = outer_surface(pot)
    spout = tube([(0.65, 0, -0.29), (0.7, 0, -0.28)], [0.2, 0.2])
    assert area(pot) - 1.2 < area(outer) < area(pot) - 0.4
    assert share_kept(outer, spout) < 0.05


@pytest.mark.slow
def test_the_same_mesh_gives_the_same_bytes():
    for make in (lambda: joined(*car()), lambda: load_target("cow"), lambda: figure(6, level=2)):
        first = outer_surface(make())
        _outer_surface.cache_clear()
        second = outer_surface(make())
        assert first is not second
        assert first.verts.tobytes() == second.verts.tobytes()
        assert first.faces.tobytes() == second.faces.tobytes()


def test_meshes_without_faces_are_refused():
    with pytest.raises(MeshError, match="without faces has no outer surface"):
        outer_surface(Mesh(np.eye(3), []))


def test_hidden_parts_are_no_error():
    balls = two_balls(level=2)
    skin = outer_surface(balls)
    everything = meshfit.measure(skin, balls, samples=500, points=100)
    outer = meshfit.measure(skin, balls, samples=500, points=100, surface="outer")
    assert everything.hausdorff.backward > 0.8
    assert outer.hausdorff.symmetric < 1e-9
    # Nor are those of a result, whose faces and quality are those of the file.
    other = meshfit.measure(balls, skin, samples=500, points=100, surface="outer")
    assert other.hausdorff.symmetric < 1e-9
    assert other.quality.faces == balls.num_faces
    grown = meshfit.measure(balls.with_verts(1.1 * balls.verts), balls, samples=500, points=100, surface="outer")
    face = balls.verts[balls.faces[grown.farthest.forward.face]] * 1.1
    gap = np.array(grown.farthest.forward.position) - face[0]
    normal = np.cross(face[1] - face[0], face[2] - face[0])
    assert abs(gap @ normal) < 1e-9 * np.linalg.norm(normal)
