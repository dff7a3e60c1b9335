"""The rasteriser against ray casting, formulas of a sphere, and closed surfaces without gaps."""

import igl
import numpy as np
import pytest

from meshfit.images.camera import Camera
from meshfit.images.rasteriser import rasterise, render_view
from meshfit.images.sphere_cameras import cameras_around
from meshfit.images.target import depth_cloud
from meshfit.images.views import View, Views
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.subdivision.sphere import icosphere
from tests.loops import over
from tests.shapes import patch, torus

KINDS = ("pinhole", "orthographic")


def test_it_sees_what_rays_hit_first():
    mesh = Mesh(np.random.default_rng(0).uniform(-1, 1, (60, 3)), np.arange(60).reshape(-1, 3))
    for kind in KINDS:
        camera = cameras_around(mesh, 3, (40, 30), kind=kind)[2]
        raster = rasterise(mesh, camera)
        origins, directions = camera.rays(camera.pixel_centres())
        face, depth = raster.face.ravel(), raster.depth.ravel()
        for row, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
            hits = igl.ray_mesh_intersect(origin, direction, mesh.verts, mesh.faces) or []
            assert face[row] == (hits[0][0] if hits else -1)
            if hits:
                expected = hits[0][1] * (direction @ camera.forward)
                assert depth[row] == pytest.approx(
                    expected, rel=1e-5
                )  # the library's distances are in single precision


@over("kind", KINDS)
def test_depth_normals_and_silhouette_of_a_sphere_follow_their_formulas(kind):
    mesh = icosphere(5)
    sagitta = 1 - np.linalg.norm(mesh.verts[mesh.faces].mean(axis=1), axis=1).min()
    for camera in cameras_around(mesh, 2, 64, kind=kind):
        view = render_view(mesh, camera)
        origins, directions = camera.rays(camera.pixel_centres())
        along = -(origins * directions).sum(axis=1)
        passes = np.linalg.norm(origins + along[:, None] * directions, axis=1)
        mask = view.mask.ravel()
        assert mask[passes < 1 - sagitta].all()
        assert not mask[passes > 1].any()
        steep = passes < 0.9
        distance = along[steep] - np.sqrt(1 - passes[steep] ** 2)
        points = origins[steep] + distance[:, None] * directions[steep]
        depth = distance * (directions[steep] @ camera.forward)
        assert np.abs(view.depth.ravel()[steep] - depth).max() < sagitta / np.sqrt(1 - 0.9**2)
        assert ((view.normals.reshape(-1, 3)[steep] * points).sum(axis=1) > np.cos(0.06)).all()
        assert np.isnan(view.depth[~view.mask]).all()


@over("kind", KINDS)
def test_corners_and_depth_give_the_point_of_the_face(kind):
    mesh = torus()
    for camera in cameras_around(mesh, 2, 50, kind=kind):
        raster = rasterise(mesh, camera)
        seen = raster.face >= 0
        corners = raster.corners[seen]
        np.testing.assert_allclose(corners.sum(axis=1), 1, atol=1e-12)
        assert corners.min() >= 0
        points = np.einsum("nk,nkj->nj", corners, mesh.verts[mesh.faces[raster.face[seen]]])
        centres = camera.pixel_centres().reshape(50, 50, 2)[seen]
        np.testing.assert_allclose(points, camera.unproject(centres, raster.depth[seen]), atol=1e-12)
        assert np.isnan(raster.corners[~seen]).all()


def test_no_gap_opens_where_edges_and_vertices_lie_on_pixel_centres():
    mesh = patch(9, 9)
    pose = np.eye(4)
    pose[:3, 3] = (4.0, 4.0, 8.0)
    for camera in (
        Camera("orthographic", 8, 8, (1.0, 1.0), (4.5, 4.5), pose),
        Camera("pinhole", 8, 8, (8.0, 8.0), (4.5, 4.5), pose),
    ):
        raster = rasterise(mesh, camera)
        assert (raster.face >= 0).all()
        np.testing.assert_allclose(raster.depth, 8.0)
        turned = rasterise(Mesh(mesh.verts, mesh.faces[:, [0, 2, 1]]), camera)
        assert (turned.face == raster.face).all()


def test_faces_that_pass_a_pinhole_camera_are_seen_as_far_as_they_are_in_front():
    ground = Mesh([[-90.0, -1, -90], [90, -1, -90], [90, -1, 90], [-90, -1, 90]], [[0, 2, 1], [0, 3, 2]])
    camera = Camera("pinhole", 9, 10, (5.0, 5.0), (4.5, 5.0), np.eye(4))
    raster = rasterise(ground, camera)
    assert (raster.face[:5] == -1).all()
    assert (raster.face[5:] >= 0).all()
    np.testing.assert_allclose(raster.depth[5:], np.broadcast_to(5 / (np.arange(5)[:, None] + 0.5), (5, 9)))
    behind = np.eye(4)
    behind[:3, 3] = (0, 0, -100)
    assert (rasterise(ground, Camera("pinhole", 9, 10, (5.0, 5.0), (4.5, 5.0), behind)).face == -1).all()


def test_a_moved_view_is_the_view_of_the_moved_mesh():
    mesh, frame = torus(), Frame((0.3, -2.0, 0.7), 2.5)
    for kind in KINDS:
        camera = cameras_around(mesh, 1, 40, kind=kind)[0]
        moved = render_view(mesh, camera).moved(frame)
        again = render_view(frame.normalise(mesh), camera.moved(frame))
        assert (moved.mask == again.mask).mean() > 0.999
        both = moved.mask & again.mask
        np.testing.assert_allclose(moved.depth[both], again.depth[both], atol=1e-9)


@over("kind", KINDS)
def test_the_cloud_of_depth_maps_lies_on_the_mesh_with_its_normals(kind):
    mesh = icosphere(5)
    views = [
        render_view(mesh, camera, f"{row}", normals=False)
        for row, camera in enumerate(cameras_around(mesh, 3, 64, kind=kind))
    ]
    cloud = depth_cloud(Views(views))
    assert cloud.num_verts == sum(view.mask.sum() for view in views)
    assert np.abs(np.linalg.norm(cloud.verts, axis=1) - 1).max() < 1e-3
    inner = cloud.normals.any(axis=1)
    cosines = (cloud.normals * cloud.verts).sum(axis=1)[inner]
    assert np.median(cosines) > 0.999
    assert cosines.min() > 0.5
    assert inner.mean() > 0.9
    assert (depth_cloud(Views(views[:1])).sensor is not None) == (kind == "pinhole")


def test_views_are_held_out_evenly():
    camera = Camera("pinhole", 3, 2, (3.0, 3.0), (1.5, 1.0), np.eye(4))
    views = Views([View(f"v{row}", camera, np.ones((2, 3), dtype=bool)) for row in range(8)])
    fitted, held_out = views.held_out(2)
    assert held_out.names == ["v2", "v6"]
    assert set(fitted.names) | set(held_out.names) == set(views.names)
    assert len(fitted) == 6
    assert views.held_out(["v3"])[1].names == ["v3"]
    assert views.held_out(0)[1] is None
