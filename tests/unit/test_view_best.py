import numpy as np
import pytest

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.solids import icosahedron
from meshfit.report.figures.camera import MARGIN, camera_of, is_visible
from meshfit.report.figures.colours import shared_limit
from meshfit.report.figures.layout import distance_panel
from meshfit.subdivision.refine import subdivide

pytest.importorskip("pyvista", reason="pictures need pyvista")

BALL = icosahedron()
CAMERA = camera_of(BALL)


def test_of_a_closed_convex_mesh_the_near_side_is_is_visible():
    ball = subdivide(BALL, "loop", 2)
    towards = CAMERA.project(ball.verts)[:, 2]
    for vert in range(ball.num_verts):
        if abs(towards[vert]) > 0.2:  # not on the outline, which nothing hides
            assert is_visible(ball, vert, CAMERA) == (towards[vert] > 0)


def test_a_ring_is_where_the_farthest_vert_is_seen():
    for vert in range(BALL.num_verts):
        distances = np.zeros(12)
        distances[vert] = 2.0
        panel = distance_panel(BALL, distances, 1.0, CAMERA, (80, 60), "ball")
        right, up, _ = CAMERA.project(BALL.verts)[vert]
        assert (panel.ring.left, panel.ring.top) == pytest.approx((40 + 30 * right, 30 - 30 * up))
        assert panel.ring.dashed != is_visible(BALL, vert, CAMERA)
    assert panel.lines == ("ball",)
    assert panel.image.shape == (60, 80, 4)


def test_a_frame_has_the_shape_of_what_it_holds():
    bar = Mesh(BALL.verts * [2.0, 1.0, 1.0], BALL.faces)
    camera, aspect = camera_of(bar).framing(bar)
    assert aspect > 1.2
    seen = np.abs(camera.project(bar.verts)[:, :2]).max(axis=0)
    half = aspect, 1.0
    assert (seen < half).all()
    assert (np.array(half) - seen) == pytest.approx(MARGIN * aspect, rel=0.1)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_a_mesh_fits_into_a_picture_of_any_shape(aspect):
    camera, found = CAMERA.framing(BALL, aspect=aspect)
    assert found == aspect
    reach = np.abs(camera.project(BALL.verts)[:, :2]).max(axis=0)
    assert (reach < np.maximum(1.0, [aspect, 1 / aspect])).all()


def test_what_is_too_large_for_a_view_is_drawn_smaller_and_what_is_not_at_its_scale():
    small, large = (Frame((1.0, 2.0, 3.0), size).normalise(BALL) for size in (2.0, 0.5))
    assert CAMERA.centred_on(small, 1.0).scale == CAMERA.scale
    camera = CAMERA.centred_on(large, 1.0)
    assert np.abs(camera.project(large.verts)[:, :2]).max() == pytest.approx(1 - MARGIN, abs=0.01)


def test_a_shared_scale_ends_at_a_round_number_that_holds_nearly_all():
    spread = np.linspace(0, 0.0371, 1000)
    assert shared_limit([spread, spread / 2]) == pytest.approx(0.04)
    assert shared_limit([np.array([*[0.01] * 999, 7.0])]) == pytest.approx(0.01)
    assert shared_limit([np.zeros(5)]) == shared_limit([]) == 1.0
