"""Gauss–Newton fits to images: rows of contours and normals, and what fits reach."""

from functools import cache

import numpy as np
import pytest
import torch

import meshfit
from meshfit.fitting.gauss_newton import image_rows
from meshfit.fitting.gauss_newton.correspondences import find_correspondences
from meshfit.fitting.gauss_newton.engine import GaussNewton
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.image_rows import ImageRows
from meshfit.fitting.gauss_newton.outline import ImagedSurface
from meshfit.fitting.gauss_newton.refinement import with_control_mesh
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.images.rasteriser import render_view
from meshfit.images.sphere_cameras import cameras_around
from meshfit.images.views import Views
from meshfit.images.visual_hull import visual_hull
from meshfit.mesh.geometry import unit_vectors, vert_area_vectors
from meshfit.mesh.proximity import point_distances
from tests.checkpoints import through_a_file
from tests.loops import over
from tests.shapes import torus

_FEW = {"method": "gauss-newton", "levels": 1, "coarse_steps": 5, "level_steps": 2, "last_steps": 2, "tries": 1}


@cache
def _bean():
    """A closed surface with a hollow that no silhouette shows."""
    ball = meshfit.subdivide("icosahedron", "loop", levels=3)
    x, y, z = (ball.verts / np.linalg.norm(ball.verts, axis=1)[:, None]).T
    dent = 1 - 0.35 * np.exp(-4 * ((x - 1) ** 2 + y**2 + z**2))
    return ball.with_verts(np.column_stack([x, 0.8 * y, 0.9 * z]) * dent[:, None] + (3.0, 1.0, 0.0))


@cache
def _views(count, pixels, kind="pinhole", *, normals=True):
    cameras = cameras_around(_bean(), count, pixels, kind=kind)
    return Views(
        [render_view(_bean(), camera, f"{k}", depth=False, normals=normals) for k, camera in enumerate(cameras)]
    )


def _error(mesh):
    """Return the mean distance of vertices, both ways, as a share of the diagonal."""
    ways = (point_distances(*pair).mean() for pair in ((mesh, _bean().verts), (_bean(), mesh.verts)))
    return sum(ways) / 2 / np.linalg.norm(np.ptp(_bean().verts, axis=0))


@over("kind", ["orthographic", "pinhole"])
def test_gradients_of_pixels_are_those_of_differences(kind):
    camera, generator = _views(3, 32, kind)[1].camera, np.random.default_rng(0)
    points = _bean().verts[:20] + generator.normal(size=(20, 3)) * 0.1
    directions = generator.normal(size=(20, 2))
    found = image_rows._gradient(points, directions, camera)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        ahead, behind = (camera.project(points + sign * step)[0] for sign in (1, -1))
        expected = np.einsum("nk,nk->n", (ahead - behind) / 2e-6, directions)
        assert found[:, axis] == pytest.approx(expected, rel=1e-5, abs=1e-5)


def _pairs(mesh, views):
    state = FitState.of(torch.tensor(mesh.verts, dtype=torch.float64), torch.tensor(mesh.faces))
    cloud = TargetCloud.of(mesh, torch.float64, torch.device("cpu"))
    pairs = find_correspondences(state.shape, cloud, torch.Generator().manual_seed(0))
    return ImageRows.of(views).adapted(pairs, state.shape, 0)


@over("kind", ["orthographic", "pinhole"])
def test_the_object_itself_fits_its_images_and_a_smaller_one_does_not(kind):
    views, middle = _views(4, 96, kind), _bean().verts.mean(axis=0)
    pixel = np.ptp(_bean().verts, axis=0).max() / 96
    own = _pairs(_bean(), views)
    assert own.distance < 0.4 * pixel
    assert own.matched > 0.99
    smaller = _pairs(_bean().with_verts(middle + 0.9 * (_bean().verts - middle)), views)
    assert smaller.distance > 3 * pixel
    # All rows of contours push outwards, as far as the object is larger.
    pushes = smaller.residuals[smaller.weights > 0]
    assert float(pushes.norm(dim=1).max()) < 15 * pixel


def test_rims_in_front_of_other_parts_are_not_drawn_to_the_contour():
    ring = torus(64, 32)
    cameras = cameras_around(ring, 6, 96)
    views = Views([render_view(ring, camera, f"{k}", depth=False, normals=False) for k, camera in enumerate(cameras)])
    pixel = np.linalg.norm(cameras[0].position - ring.verts.mean(axis=0)) / cameras[0].focal[0]
    pairs = _pairs(ring, views)
    assert pairs.distance < 0.22 * pixel
    normals = unit_vectors(vert_area_vectors(ring))[ring.faces[pairs.face.numpy()]]
    outwards = np.einsum("nk,nck,nc->n", pairs.residuals.numpy(), normals, pairs.corners.numpy())
    assert abs(np.average(outwards, weights=pairs.weights.numpy())) < 0.01 * pixel


def test_staying_in_place_counts_where_images_show_normals(monkeypatch):
    """A surface that is the object already is moved along itself by the facets of its images, and by less if held."""
    bean, rows = _bean(), ImageRows.of(Views(_views(6, 96)))
    cloud = TargetCloud.of(bean, torch.float64, torch.device("cpu"))

    def drift():
        state = FitState.of(torch.tensor(bean.verts), torch.tensor(bean.faces))
        for _ in range(4):
            generator = torch.Generator().manual_seed(0)
            state = state.step(cloud, 0.005, 0.02, generator, adapted=lambda p, s: rows.adapted(p, s, 0)).state
        return np.linalg.norm(state.verts.numpy() - bean.verts, axis=1).mean()

    held = drift()
    without, _ = image_rows._DAMPING
    monkeypatch.setattr(image_rows, "_DAMPING", (without, without))
    assert held < 0.97 * drift()


def test_outlines_of_a_limit_surface_are_where_its_own_normals_turn_away():
    control = meshfit.subdivide("icosahedron", "loop", levels=1)
    state = FitState.of(torch.tensor(control.verts, dtype=torch.float64), torch.tensor(control.faces))
    for levels in (1, 2):
        shape = with_control_mesh(state, "loop", levels, limit=True).shape
        fine = meshfit.subdivide(control, "loop", levels=levels)
        np.testing.assert_allclose(shape.verts.numpy(), meshfit.loop_limit(fine) @ fine.verts, atol=1e-12)
        np.testing.assert_allclose(shape.smooth_normals.numpy(), meshfit.loop_limit_normals(fine), atol=1e-12)
        np.testing.assert_allclose(ImagedSurface.of(shape).normals, shape.smooth_normals.numpy())
    plain = with_control_mesh(state, "loop", 1, limit=False).shape
    assert plain.smooth_normals is plain.vert_normals


def test_silhouettes_give_a_better_surface_than_their_hull_and_normals_show_the_hollow():
    views = _views(4, 48)
    hull, settings = visual_hull(views, 20), meshfit.GaussNewtonSettings(verts=200, **_FEW)
    given = (_views(4, 48, normals=False), views)
    problems = [meshfit.Problem(hull, hull, own=False, images=images) for images in given]
    for outcome, share in zip(meshfit.fit_batch(problems, settings, device="cpu"), (0.9, 0.4), strict=True):
        assert _error(outcome.mesh) < share * _error(hull)
        assert not outcome.shortfalls


def test_thin_parts_that_a_search_for_the_rough_shape_loses_are_those_of_the_hull():
    ball = meshfit.subdivide("icosahedron", "loop", levels=4)
    x, y, z = (ball.verts / np.linalg.norm(ball.verts, axis=1)[:, None]).T
    ears = np.exp(-((4 * z) ** 2) - ((np.abs(x) - 0.75) / 0.12) ** 2) * (y > 0)
    animal = ball.with_verts(np.column_stack([x, y + 1.1 * ears, z]))
    cameras = cameras_around(animal, 6, 64)
    views = Views([render_view(animal, camera, f"{k}", depth=False, normals=False) for k, camera in enumerate(cameras)])
    hull, rows, settings = visual_hull(views, 40), ImageRows.of(views), meshfit.GaussNewtonSettings(verts=300, **_FEW)
    (outcome,) = meshfit.fit_batch([meshfit.Problem(hull, hull, own=False, images=views)], settings, device="cpu")
    assert rows.loses_parts(ball.with_verts(np.column_stack([x, y, z])), hull)
    assert not rows.loses_parts(outcome.mesh, hull)
    assert point_distances(outcome.mesh, animal.verts).max() < 0.2


def test_a_fit_in_a_batch_gives_the_bytes_of_a_single_one():
    views, settings = _views(4, 32), meshfit.GaussNewtonSettings(verts=100, **_FEW)
    problems = []
    for seed, given in enumerate((views, Views(views[:3]))):
        hull = visual_hull(given, 10)
        problems.append(meshfit.Problem(hull, hull, seed, own=False, images=given))
    together = meshfit.fit_batch(problems, settings, device="cpu")
    (alone,) = meshfit.fit_batch(problems[1:], settings, device="cpu")
    assert together[1].mesh.verts.tobytes() == alone.mesh.verts.tobytes()
    assert together[1].trace.rows == alone.trace.rows


@pytest.mark.slow
@over("chosen", [{}, {"variables": "control", "limit": True}])
def test_a_fit_to_images_continues_from_a_checkpoint_to_the_same_bytes(chosen):
    views, settings = _views(4, 32), meshfit.GaussNewtonSettings(verts=100, **_FEW | chosen)
    hull = visual_hull(views, 10)
    problem = meshfit.Problem(hull, hull, own=False, images=views)
    (whole,) = meshfit.fit_batch([problem], settings, device="cpu")
    engine = GaussNewton([problem], settings, torch.device("cpu"), torch.float32)
    for done in range(1, engine.steps):
        engine.step()
        if done in (2, engine.steps - 1):
            again = GaussNewton([problem], settings, torch.device("cpu"), torch.float32)
            again.restore([through_a_file(engine.checkpoint(0))])
            while again.done < again.steps:
                again.step()
            assert again.mesh(0).verts.tobytes() == whole.mesh.verts.tobytes()
            assert again.traces[0].rows == whole.trace.rows
