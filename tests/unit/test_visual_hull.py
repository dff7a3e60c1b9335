"""The visual hull, and the contours of masks that carve it."""

from dataclasses import replace

import numpy as np
import pytest

from meshfit.errors import ViewError
from meshfit.images.camera import Camera
from meshfit.images.rasteriser import rasterise, render_view
from meshfit.images.silhouettes import Silhouette
from meshfit.images.sphere_cameras import cameras_around
from meshfit.images.tunnels import without_narrow_tunnels
from meshfit.images.views import View
from meshfit.images.visual_hull import visual_hull
from meshfit.mesh.any_mesh import as_mesh
from meshfit.mesh.geometry import signed_volume, unit_vectors, vert_area_vectors
from meshfit.mesh.manifold import TopologyCounts
from meshfit.mesh.proximity import winding_numbers, zero_surface
from meshfit.mesh.topology import Topology
from tests.loops import over
from tests.shapes import torus

_PIXELS = 64
_AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
_BALL = as_mesh("icosahedron")


def _views(mesh, cameras):
    return [render_view(mesh, camera, f"view {k}", depth=False, normals=False) for k, camera in enumerate(cameras)]


def _zoomed(camera, factor):
    focal = (camera.focal[0] * factor, camera.focal[1] * factor)
    return Camera(camera.kind, camera.width, camera.height, focal, camera.centre, camera.pose)


def test_hull_of_a_box_seen_along_its_axes_is_the_box():
    cube = as_mesh("cube").triangulated()
    box = cube.with_verts(np.sign(cube.verts) * (0.5, 0.8, 1.1) + (0.1, -0.2, 0.3))
    hull = visual_hull(_views(box, cameras_around(box, _AXES, 128, kind="orthographic")), 64)
    counts = TopologyCounts.of(Topology.of(hull))
    assert (counts.pieces, counts.openings, counts.handles) == (1, 0, 0)
    assert signed_volume(hull) == pytest.approx(8 * 0.5 * 0.8 * 1.1, rel=0.03)
    for bound in (np.min, np.max):
        assert np.abs(bound(hull.verts, axis=0) - bound(box.verts, axis=0)).max() < 0.02


def test_hull_encloses_the_object_shows_its_masks_and_shrinks_with_more_views():
    ring, volumes = torus(48, 24), []
    cameras = cameras_around(ring, 12, _PIXELS)
    for count in (3, 6, 12):
        views = _views(ring, cameras[:count])
        hull = visual_hull(views, 64)
        topology = Topology.of(hull)
        assert topology.is_watertight
        volumes.append(signed_volume(hull))
        below = ring.verts - 0.05 * unit_vectors(vert_area_vectors(ring))
        assert (winding_numbers(hull, below) > 0.5).all()
        for view in views:
            seen = rasterise(hull, view.camera).face >= 0
            assert (seen & view.mask).sum() / (seen | view.mask).sum() > 0.95
    assert volumes[0] > volumes[1] > volumes[2] > 0.97 * signed_volume(ring)
    assert TopologyCounts.of(topology).handles >= 1


def test_tunnels_are_filled_that_are_narrow_and_that_no_mask_shows_and_nothing_else_changes():
    x, y, z = np.meshgrid(*[np.arange(-8.0, 9.0)] * 3, indexing="ij")
    ball, axes = 6.3 - np.sqrt(x**2 + y**2 + z**2), [np.arange(17.0)] * 3
    groove = np.minimum(ball, np.hypot(x - 6, y) - 1.2)

    def handles(values):
        return TopologyCounts.of(Topology.of(zero_surface(values, axes))).handles

    for depth, radius, left in ((0.3, 1.5, 0), (0.7, 1.5, 1), (0.3, 3.4, 1)):
        tunnel = np.where(np.hypot(x, y) < radius, -depth, groove)
        filled = without_narrow_tunnels(tunnel, 0.5, 1.0)
        assert (handles(tunnel), handles(filled)) == (1, left)
        changed = filled != tunnel
        assert not changed[(tunnel > 0) | (np.hypot(x, y) >= radius)].any()
        assert changed.any() == (left == 0)


@over("kind", ["orthographic", "pinhole"])
def test_hull_of_a_single_view_is_as_deep_as_it_is_wide_or_as_is_said(kind):
    views = _views(_BALL, cameras_around(_BALL, 1, _PIXELS, kind=kind))
    camera = views[0].camera
    depth = camera.project(visual_hull(views, 48).verts)[1]
    assert np.ptp(depth) == pytest.approx(np.ptp(_BALL.verts, axis=0).mean(), rel=0.15)
    assert (depth.min() + depth.max()) / 2 == pytest.approx(-camera.position @ camera.forward, rel=0.05)
    said = camera.project(visual_hull(views, 48, depth=(depth.min() + 0.2, depth.min() + 0.6)).verts)[1]
    assert (said.min(), said.max()) == pytest.approx((depth.min() + 0.2, depth.min() + 0.6), abs=0.05)


def test_parts_that_an_image_cuts_off_are_left_to_the_other_views():
    cameras = cameras_around(_BALL, _AXES, _PIXELS, kind="orthographic")
    whole, cut, others = (
        signed_volume(visual_hull(_views(_BALL, chosen), 48))
        for chosen in (cameras, [_zoomed(cameras[0], 1.3), *cameras[1:]], cameras[1:])
    )
    assert whole < cut < 1.01 * others


def test_refusals_name_the_view_and_the_remedy():
    views = _views(_BALL, cameras_around(_BALL, 3, _PIXELS))
    beside = _BALL.with_verts(_BALL.verts + np.array([0.0, 5.0, 0.0]))
    far = _views(beside, [_zoomed(view.camera, 0.2) for view in views])
    cases = {
        "view 'view 1': its mask is empty; ": replace(views[1], mask=np.zeros_like(views[1].mask)),
        "view 'view 1': its mask is full, ": replace(views[1], mask=np.ones_like(views[1].mask)),
        "the masks of the 2 views have no point in common, .*; check the cameras": far[1],
    }
    for text, view in cases.items():
        with pytest.raises(ViewError, match=text) as caught:
            visual_hull([views[0], view], 32)
        assert "\n" not in str(caught.value)


@over("radius", [4.4, 12.3, 38.0])
def test_contour_of_a_disc_is_exact_to_a_fraction_of_a_pixel(radius):
    y, x = np.mgrid[:96, :96] + 0.5
    camera = Camera("pinhole", 96, 96, (90.0, 90.0), (48.0, 48.0), np.eye(4))
    from_centre = np.hypot(x - 48.3, y - 47.6)
    silhouette = Silhouette.of(View("disc", camera, from_centre < radius))
    offsets = silhouette.points - (48.3, 47.6)
    lengths = np.linalg.norm(offsets, axis=1)
    assert abs(lengths.mean() - radius) < 0.08
    assert (lengths - radius).std() < 0.25
    assert np.einsum("nk,nk->n", offsets / lengths[:, None], silhouette.normals).min() > 0.9
    assert silhouette.lengths.sum() == pytest.approx(2 * np.pi * radius, rel=0.04)
    assert np.abs(silhouette.distance - (radius - from_centre)).max() < 1.0
    assert silhouette.distance_at(np.array([[-10.0, 48.0]]))[0] == pytest.approx(radius - 58.3, abs=1.0)
