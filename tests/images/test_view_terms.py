"""Silhouettes, depth and normals of a mesh, differentiable in its vertices, and fits with them as losses."""

import numpy as np
import pytest
import torch

from meshfit.errors import ConfigError
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.loop import run
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.images.camera import Camera
from meshfit.images.files import renamed
from meshfit.images.rasteriser import rasterise, render_view
from meshfit.images.sphere_cameras import cameras_around
from meshfit.images.views import Views
from meshfit.loss.differentiable_view import SeenMesh, ViewCamera
from meshfit.loss.view_terms import ViewTarget, view_terms
from meshfit.mesh.mesh import Mesh
from meshfit.settings import build
from meshfit.subdivision.sphere import icosphere
from tests.loops import over

CPU = torch.device("cpu")
KINDS = ("pinhole", "orthographic")
ALL = ("silhouette", "depth", "normals")


def seen(mesh, camera, verts=None):
    positions = torch.tensor(mesh.verts) if verts is None else verts
    return SeenMesh.of(positions, mesh, ViewCamera.of(camera, torch.float64, CPU))


def egg(level=2):
    return icosphere(level).with_verts(icosphere(level).verts * (1.0, 0.8, 0.6))


def views_of(mesh, count, size=32, kind="pinhole"):
    return Views(
        renamed((render_view(mesh, camera) for camera in cameras_around(mesh, count, size, kind=kind)), "view-")
    )


@over("blur", [0.5, 1.0])
def test_coverage_of_a_square_is_the_sigmoid_of_the_distance_from_its_sides(blur):
    square = Mesh(np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    pose = np.eye(4)
    pose[2, 3] = 3.0
    camera = Camera("orthographic", 40, 40, (10.3, 10.3), (20.0, 20.0), pose)
    x = np.abs(np.arange(40) + 0.5 - 20)
    distance = np.minimum(10.3 - x[:, None], 10.3 - x[None, :])
    outside = np.hypot(np.maximum(x[:, None] - 10.3, 0), np.maximum(x[None, :] - 10.3, 0))
    distance = np.where(distance >= 0, distance, -outside)
    wanted = np.where(np.abs(distance) <= 6 * blur, 1 / (1 + np.exp(-distance / blur)), distance > 0)
    np.testing.assert_allclose(seen(square, camera).silhouette(blur).numpy(), wanted, atol=1e-12)


@over("kind", KINDS)
def test_without_blur_it_is_what_an_exact_rasteriser_sees(kind):
    mesh = egg()
    camera = cameras_around(mesh, 3, 48, kind=kind)[1]
    view, raster = render_view(mesh, camera), rasterise(mesh, camera)
    sight = seen(mesh, camera)
    np.testing.assert_allclose(sight.silhouette(1e-4).numpy(), view.mask, atol=1e-6)
    pixels = np.flatnonzero(view.mask)
    frontal = sight.is_frontal(pixels).numpy()
    assert frontal.mean() > 0.9
    np.testing.assert_allclose(sight.depth(pixels).numpy()[frontal], raster.depth.ravel()[pixels][frontal])
    np.testing.assert_allclose(sight.normals(pixels).numpy(), view.normals.reshape(-1, 3)[pixels], atol=1e-12)


@over("level", [1, 3])
def test_blurring_moves_no_outline(level):
    # The covered area stays, whatever the size of the faces, where a product over faces would swell.
    mesh = egg(level)
    camera = cameras_around(mesh, 3, 64)[0]
    area = render_view(mesh, camera).mask.sum()
    assert float(seen(mesh, camera).silhouette(1.0).sum()) == pytest.approx(area, rel=0.01)


def test_what_lies_behind_is_no_outline():
    near = egg().with_verts(egg().verts + np.array([0.0, 0.0, 2.0]))
    far = egg(1).with_verts(egg(1).verts * 0.5)
    both = Mesh(np.concatenate([near.verts, far.verts]), np.concatenate([near.faces, far.faces + near.num_verts]))
    pose = np.eye(4)
    pose[2, 3] = 6.0
    camera = Camera("orthographic", 40, 40, (12.0, 12.0), (20.0, 20.0), pose)
    np.testing.assert_array_equal(
        seen(both, camera).silhouette(0.7).numpy(), seen(near, camera).silhouette(0.7).numpy()
    )


@over("kind, difference", [("pinhole", "iou"), ("orthographic", "squared")])
def test_gradients_are_those_of_finite_differences(kind, difference):
    generator = np.random.default_rng(0)
    target, start = egg(), icosphere(2)
    direction = torch.tensor(generator.normal(size=start.verts.shape))
    views = [ViewTarget.of(view, 1.0, torch.float64, CPU) for view in views_of(target, 3, 32, kind)]
    for name in ALL:

        def value(verts, views=views, name=name, difference=difference):
            return view_terms(verts, start, views, [name], 1.0, difference)[name]

        verts = torch.tensor(0.9 * start.verts, requires_grad=True)
        (gradient,) = torch.autograd.grad(value(verts), verts)
        step = 1e-6
        with torch.no_grad():
            change = (value(verts + step * direction) - value(verts - step * direction)) / (2 * step)
        assert float((gradient * direction).sum()) == pytest.approx(float(change), rel=2e-3, abs=1e-7), name
        assert gradient.abs().max() > 0


def test_a_mesh_that_made_the_views_has_no_loss_and_one_that_is_off_has():
    mesh = egg()
    views = [ViewTarget.of(view, 1.0, torch.float64, CPU) for view in views_of(mesh, 4, 64)]
    at_home = view_terms(torch.tensor(mesh.verts), mesh, views, ALL, 1.0)
    away = view_terms(torch.tensor(mesh.verts) * 1.2, mesh, views, ALL, 1.0)
    assert at_home["depth"] == pytest.approx(0, abs=1e-12)
    assert at_home["normals"] == pytest.approx(0, abs=1e-12)
    assert at_home["silhouette"] < 0.02 < 0.1 < away["silhouette"]
    assert away["depth"] > 0.05
    assert away["normals"] > 1e-3


def problems():
    first, second = views_of(egg(), 5), views_of(egg(1), 2, 24)
    return [
        Problem(icosphere(1), egg(1), seed=0, images=first),
        Problem(icosphere(2), egg(1), seed=1, images=second),
        Problem(icosphere(1), egg(1), seed=2),
    ]


def settings(**losses):
    return build(FirstOrderSettings, {"steps": 3, "samples": 60, "trace_every": 1, "losses": losses})


@over("dtype", [torch.float32, torch.float64])
def test_a_batch_of_ragged_meshes_and_views_gives_the_bytes_of_single_fits(dtype):
    every = problems()
    chosen = settings()
    together = run(FirstOrder(every, chosen, CPU, dtype))
    for problem in every:
        alone = run(FirstOrder([problem], chosen, CPU, dtype))[problem]
        assert alone.mesh.verts.tobytes() == together[problem].mesh.verts.tobytes()
        assert alone.trace.to_csv() == together[problem].trace.to_csv()
    assert together[every[0]].trace.columns[-2:] == ("silhouette", "lr")
    assert "silhouette" not in together[every[2]].trace.columns


def test_a_fit_with_images_continues_from_a_checkpoint_to_the_same_bytes():
    problem = problems()[0]
    chosen = settings(silhouette=1.0, normals=0.1, depth=0.5)
    whole = run(FirstOrder([problem], chosen, CPU, torch.float32))[problem]
    half = FirstOrder([problem], chosen, CPU, torch.float32)
    half.step()
    again = FirstOrder([problem], chosen, CPU, torch.float32)
    again.restore([half.checkpoint(0)])
    rest = run(again)[problem]
    assert rest.mesh.verts.tobytes() == whole.mesh.verts.tobytes()
    assert rest.trace == whole.trace


def test_silhouettes_draw_a_sphere_into_the_masks():
    views = views_of(egg(), 6, 48)
    problem = Problem(icosphere(2), egg(1), images=views)
    chosen = build(
        FirstOrderSettings,
        {"steps": 40, "samples": 10, "losses": {"chamfer": 0, "edge": 0, "laplacian": 0.05, "consistency": 0}},
    )
    trace = run(FirstOrder([problem], chosen, CPU, torch.float32))[problem].trace
    assert trace.column("silhouette")[-1] < 0.35 * trace.column("silhouette")[0]


def test_terms_that_the_target_does_not_have_are_refused():
    with_images, without = problems()[0], problems()[2]
    masks = Views([view.without_normals() for view in with_images.images])
    with pytest.raises(ConfigError, match=r"losses\.silhouette: is for targets of images"):
        FirstOrder([without], settings(silhouette=1.0), CPU, torch.float32)
    with pytest.raises(ConfigError, match=r"losses\.normals: the images have no normals"):
        FirstOrder([Problem(icosphere(1), egg(), images=masks)], settings(normals=1.0), CPU, torch.float32)
