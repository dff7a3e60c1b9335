import numpy as np
import pytest

from meshfit.errors import MeasureError
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import nearest_on_surface
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.targets import load_target
from meshfit.report.figures.trial_meshes import distances_to, distinct_meshes, worst_vertex
from meshfit.subdivision.refine import subdivide

SQUARE = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def test_distances_to_a_square_are_what_geometry_says():
    points = Mesh([[0.5, 0.5, 0.25], [2.0, 0.5, 0.0], [4.0, 5.0, 0.0], [0.1, 0.2, 0.0]], [])
    found = distances_to(points, SQUARE)
    assert found == pytest.approx([0.25, 1.0, 5.0, 0.0], abs=1e-12)
    assert worst_vertex(found) == 2


def test_distances_are_those_that_the_measurement_has():
    bone = load_target("bone")
    ball = Mesh(0.1 * icosahedron().verts + bone.verts.mean(axis=0), icosahedron().faces)
    assert np.array_equal(distances_to(ball, bone), nearest_on_surface(bone, ball.verts).distances)
    assert distances_to(bone, bone) == pytest.approx(np.zeros(bone.num_verts), abs=1e-9)


def test_what_has_no_distances_is_refused():
    with pytest.raises(MeasureError, match="no faces"):
        distances_to(SQUARE, Mesh(SQUARE.verts, []))
    with pytest.raises(MeasureError, match="finite"):
        distances_to(Mesh([[np.nan, 0, 0]], []), SQUARE)
    with pytest.raises(MeasureError, match="worst"):
        worst_vertex(distances_to(Mesh([], []), SQUARE))


def test_meshes_that_look_alike_are_one_whatever_their_vertices():
    ball = icosahedron()
    finer, larger = subdivide(ball, "midpoint", 1), Mesh(1.05 * ball.verts, ball.faces)
    groups = distinct_meshes([("a", ball), ("b", larger), ("c", finer)])
    assert [labels for labels, _ in groups] == [["a", "c"], ["b"]]
    assert groups[0][1] is ball
