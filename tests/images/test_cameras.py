"""Cameras: projection against its formula, its inverse, other coordinates, and poses that no camera has."""

import numpy as np
import pytest

from meshfit.errors import ViewError
from meshfit.images.camera import Camera
from meshfit.images.sphere_cameras import cameras_around, directions_between, sphere_directions
from meshfit.mesh.normalisation import Frame
from tests.loops import over
from tests.shapes import torus

KINDS = ("pinhole", "orthographic")
FRAME = Frame((0.3, -2.0, 0.7), 2.5)


def some_camera(kind="pinhole"):
    rng = np.random.default_rng(3)
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pose[:3, 0] *= np.linalg.det(pose[:3, :3])
    pose[:3, 3] = rng.normal(size=3)
    return Camera(kind, 60, 40, (70.0, 80.0), (31.0, 18.5), pose)


@over("kind", KINDS)
def test_unprojection_is_the_inverse_of_projection(kind):
    camera = some_camera(kind)
    rng = np.random.default_rng(5)
    pixels, depth = rng.uniform(0, 60, (50, 2)), rng.uniform(0.5, 9, 50)
    points = camera.unproject(pixels, depth)
    again, depths = camera.project(points)
    np.testing.assert_allclose(again, pixels, atol=1e-11)
    np.testing.assert_allclose(depths, depth, atol=1e-12)
    np.testing.assert_allclose((points - camera.position) @ camera.forward, depth, atol=1e-12)


@over("kind", KINDS)
def test_rays_pass_through_what_is_seen_at_their_pixels(kind):
    camera = some_camera(kind)
    pixels = np.random.default_rng(5).uniform(0, 40, (20, 2))
    origins, directions = camera.rays(pixels)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    points = camera.unproject(pixels, np.full(20, 4.0))
    np.testing.assert_allclose(np.cross(points - origins, directions), 0, atol=1e-12)
    assert (((points - origins) * directions).sum(axis=1) > 0).all()


@over("kind", KINDS)
def test_a_moved_camera_sees_moved_points_at_the_same_pixels(kind):
    camera = some_camera(kind)
    points = camera.unproject(np.random.default_rng(5).uniform(0, 40, (20, 2)), np.full(20, 4.0))
    pixels, depth = camera.project(points)
    moved_pixels, moved_depth = camera.moved(FRAME).project((points - FRAME.centre) / FRAME.scale)
    np.testing.assert_allclose(moved_pixels, pixels, atol=1e-10)
    np.testing.assert_allclose(moved_depth * FRAME.scale, depth, atol=1e-12)


def test_the_axes_of_an_image_are_those_of_blender():
    camera = Camera("pinhole", 10, 8, (5.0, 5.0), (5.0, 4.0), np.eye(4))
    right, up, ahead = camera.project(np.array([[1.0, 0, -5], [0, 1.0, -5], [0, 0, -5]]))[0]
    assert (right.tolist(), up.tolist(), ahead.tolist()) == ([6, 4], [5, 3], [5, 4])
    assert camera.pixel_centres()[[0, 1, 10]].tolist() == [[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]]


def test_cameras_of_equal_values_are_equal():
    one, same = some_camera(), some_camera()
    assert one == same
    assert hash(one) == hash(same)
    assert one != one.moved(FRAME)
    assert len({one, same, some_camera("orthographic")}) == 2


def changed(**values):
    pose = np.eye(4)
    for place, value in values.pop("pose", {}).items():
        pose[place] = value
    fields = {"kind": "pinhole", "width": 8, "height": 8, "focal": (9.0, 9.0), "centre": (4.0, 4.0), "pose": pose}
    return Camera(**(fields | values))


@over(
    "values, message",
    [
        ({"pose": {(0, 0): np.nan}}, "not finite"),
        ({"pose": {(0, 0): 0.0}}, "not a rotation"),
        ({"pose": {(0, 0): -1.0}}, "mirrored"),
        ({"pose": {(0, 0): 2.0, (1, 1): 2.0, (2, 2): 2.0}}, "scales by 2"),
        ({"pose": {(3, 3): 2.0}}, "last row"),
        ({"focal": (0.0, 3.0)}, "focal"),
        ({"focal": (3.0,)}, "focal"),
        ({"centre": (np.inf, 3.0)}, "principal point"),
        ({"width": 0}, "width"),
        ({"width": 1 << 20, "height": 1 << 20}, "scale it down"),
        ({"kind": "fisheye"}, "fisheye"),
    ],
)
def test_what_no_camera_has_is_refused(values, message):
    with pytest.raises(ViewError, match=message):
        changed(**values)


@over("kind, size", [(kind, size) for kind in KINDS for size in (64, (80, 40))])
def test_every_camera_around_a_mesh_sees_it_whole_and_one_to_its_margin(kind, size):
    mesh = torus().with_verts(torus().verts * (1.0, 3.0, 0.5) + 7.0)
    reach = []
    for camera in cameras_around(mesh, 5, size, kind=kind):
        pixels, depth = camera.project(mesh.verts)
        assert (depth > 0).all()
        reach.append(np.abs((pixels / (camera.width, camera.height) - 0.5) * 2).max())
    assert max(reach) == pytest.approx(0.95, abs=1e-9)


@over("count, least", [(2, 90), (4, 80), (8, 50), (16, 35), (32, 25)])
def test_directions_are_spread_evenly_and_no_two_are_opposite(count, least):
    directions = sphere_directions(count)
    cosines = directions @ directions.T
    assert np.degrees(np.arccos((cosines - 3 * np.eye(count)).max())) > least
    assert cosines.min() > -1 + 1e-6
    between = directions_between(directions, 4)
    assert np.degrees(np.arccos((between @ directions.T).max())) > least / 2
