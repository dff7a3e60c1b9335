import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame, frame_of
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.targets import NAMED_TARGETS, load_target
from meshfit.report.figures.camera import MARGIN, camera_of, guess_up

SQUARE = Mesh([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 2, 1], [0, 3, 2]])
SHAPES = {
    "solid": icosahedron(),
    "flat, seen from above": SQUARE,
    "one triangle": Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]),
    "tiny and far away": Frame((3.0, -2.0, 1.0), 1e6).normalise(icosahedron()),
    "huge": Frame((0.0, 0.0, 0.0), 1e-9).normalise(icosahedron()),
    "without area": Mesh([[0, 0, 0], [1, 1, 1]], [[0, 1, 1]]),
}


def target(name):
    mesh = load_target(name)
    return frame_of(mesh.verts, "tutorial").normalise(mesh)


def check_frames(camera, mesh):
    reach = np.abs(camera.project(mesh.verts)[:, :2]).max(axis=0)
    assert reach.max() == pytest.approx(1 - MARGIN, abs=1e-6)


@pytest.mark.parametrize("mesh", SHAPES.values(), ids=SHAPES)
def test_all_of_any_mesh_is_in_the_picture_and_fills_it(mesh):
    check_frames(camera_of(mesh), mesh)


@pytest.mark.parametrize("name", NAMED_TARGETS)
def test_targets_are_upright_and_seen_from_a_little_above_and_from_the_front(name):
    mesh = target(name)
    camera = camera_of(mesh)
    check_frames(camera, mesh)
    axes = np.array([camera.right, camera.up, camera.direction])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert camera.right[1] == pytest.approx(0, abs=1e-12)
    assert camera.up[1] > 0.8
    assert camera.direction[1] > 0.2
    assert camera.direction[2] > 0.2


def test_a_target_has_one_camera_whatever_its_unit_and_the_order_of_its_faces():
    mesh = target("mousehead")
    order = np.random.default_rng(0).permutation(mesh.num_faces)
    camera = camera_of(mesh)
    assert camera == camera_of(mesh)
    assert camera_of(Mesh(mesh.verts, mesh.faces[order])).direction == camera.direction
    assert camera_of(load_target("mousehead")).direction == camera.direction


def test_drawn_back_a_camera_holds_other_meshes_and_keeps_its_view():
    mesh, large = target("bone"), Frame((0.0, 0.0, 0.0), 0.2).normalise(icosahedron())
    camera = camera_of(mesh)
    wide = camera.containing(mesh, large)
    assert np.abs(wide.project(large.verts)[:, :2]).max() == pytest.approx(1 - MARGIN)
    assert (wide.focal, wide.direction, wide.up) == (camera.focal, camera.direction, camera.up)
    assert camera.containing(mesh) == camera
    assert camera.containing() == camera


def test_without_faces_there_is_no_view():
    with pytest.raises(MeshError, match="without faces"):
        camera_of(Mesh([[0, 0, 0]], []))


def test_named_targets_stand_along_y_and_the_bunny_turned_to_z_along_z():
    for name in ("bunny", "mousehead", "cow", "bone", "airplane"):
        assert guess_up(load_target(name)) == "y"
    bunny = load_target("bunny")
    turned = Mesh(np.stack([bunny.verts[:, 0], -bunny.verts[:, 2], bunny.verts[:, 1]], axis=1), bunny.faces)
    assert guess_up(turned) == "z"
    upright, lying = camera_of(bunny), camera_of(turned)
    np.testing.assert_allclose(upright.project(bunny.verts), lying.project(turned.verts), atol=1e-9)
