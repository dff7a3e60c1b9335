"""Targets of images: their specs, identities, and a whole experiment with them."""

import json
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.loading import load_experiment
from meshfit.errors import ConfigError, MeshError, ViewError
from meshfit.experiment.plan import plan
from meshfit.experiment.running.worker import pack_inputs, unpack_inputs
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.storage.targets import read_images
from meshfit.fitting.problem import Problem
from meshfit.images.files import renamed, save_views
from meshfit.images.hull_source import control_mesh_from
from meshfit.images.rasteriser import render_view, shading
from meshfit.images.specs import (
    ImageFiles,
    RenderedViews,
    image_spec,
    is_image_target,
    label_of_target,
    title_of_target,
)
from meshfit.images.sphere_cameras import cameras_around
from meshfit.images.target import ImageTarget
from meshfit.images.targets import content_sha256, load_image_target, load_images
from meshfit.images.views import Views
from meshfit.images.visual_hull import visual_hull
from meshfit.measuring.mask_overlap import mask_ious, mask_overlap
from meshfit.measuring.measure import measure
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.topology import Topology
from meshfit.settings import build
from meshfit.subdivision.sphere import icosphere
from tests.cli import answered, invoke, refused, trials_in_this_process
from tests.loops import over

pytest.importorskip("PIL", reason="images need pillow")

SIZE = 40


def egg():
    return icosphere(3).with_verts(icosphere(3).verts * (1.0, 0.8, 0.6) + (5.0, 0.0, 0.0))


def views_of(mesh, count=4, **options):
    cameras = cameras_around(mesh, count, SIZE)
    return Views(renamed((render_view(mesh, camera, **options) for camera in cameras), "view-"))


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    views = views_of(egg())
    save_views(folder, views, [shading(view) for view in views], "npy")
    save_mesh(egg(), tmp_path / "egg.ply")
    return folder


@over(
    "value, text, title, label",
    [
        ({"views": {"of": "bunny"}}, "views:of=bunny,count=12", "bunny (12 views)", "bunny-12-views"),
        ("views:of=bunny, count=1,hold_out=4", "views:of=bunny,count=1", "bunny (1 view)", "bunny-1-view"),
        (
            {"views": {"of": "bunny", "count": 8, "depth": True, "kind": "orthographic", "size": 64}},
            "views:of=bunny,count=8,size=64,kind=orthographic,depth=true",
            "bunny (8 views, orthographic, depth, 64 px)",
            "bunny-8-views-orthographic-depth-64",
        ),
        ({"images": "/a/photos"}, "/a/photos", None, None),
        (
            {"images": "/a/photos", "cameras": "/b/t.json", "hold_out": 3, "depth": False},
            "images:images=/a/photos,cameras=/b/t.json,depth=false,hold_out=3",
            "photos-no-depth",
            "photos-no-depth",
        ),
        ("/a/photos/transforms.json", "/a/photos/transforms.json", "photos", "photos"),
    ],
)
def test_mappings_and_texts_have_one_canonical_text(value, text, title, label):
    settings = build(ExperimentSettings, {"targets": [value]})
    assert settings.targets == (text,)
    assert str(image_spec(text)) == text
    if title is not None:
        assert (title_of_target(text), label_of_target(text)) == (title, label)
    assert build(ExperimentSettings, settings.model_dump(mode="json")) == settings


@over(
    "value, message",
    [
        ({"views": {"of": "bunny", "counts": 3}}, "no such key 'counts': did you mean 'count'"),
        ({"views": {"count": 3}}, "'of' is missing"),
        ({"views": {"of": "bunny", "count": 0}}, "views.count: expected an integer from 1"),
        ({"views": {"of": "bunny", "count": "many"}}, "views.count"),
        ({"views": {"of": "bunny", "depth": "yes"}}, "expected true or false"),
        ({"views": {"of": "bunny", "kind": "fisheye"}}, "allowed: pinhole, orthographic"),
        ({"views": {"of": "bunny"}, "images": "x"}, "no key beside it"),
        ({"images": "x", "size": 3}, "no such key 'size'"),
        ({"photos": "x"}, "expected a name, a path"),
        ("views:bunny", "expected 'key=value'"),
    ],
)
def test_bad_specs_are_refused_in_one_line(value, message):
    with pytest.raises(ConfigError, match=r"^targets\[0\]: ") as caught:
        build(ExperimentSettings, {"targets": [value]})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_paths_of_images_are_relative_to_the_config(photos):
    path = photos.parent / "photos.yaml"
    path.write_text("targets: [photos, {images: photos, truth: egg.ply}, {views: {of: egg.ply}}]\n")
    targets = load_experiment(str(path)).settings.targets
    here = photos.parent
    assert targets == (
        f"{here}/photos",
        f"images:images={here}/photos,truth={here}/egg.ply",
        f"views:of={here}/egg.ply,count=12",
    )
    assert all(map(is_image_target, targets))
    assert not is_image_target(str(here / "egg.ply"))
    assert not is_image_target("bunny")


def test_identity_follows_the_content_and_not_the_place(photos):
    moved = photos.rename(photos.with_name("moved"))
    before = content_sha256(str(moved))
    moved.rename(photos)
    hashes = {
        content_sha256(text) for text in (str(photos), f"images:images={photos},hold_out=1", "views:of=bone,size=32")
    }
    assert before in hashes
    assert len(hashes) == 3
    view = next(iter((photos / "images").iterdir()))
    view.write_bytes(next(path for path in (photos / "images").iterdir() if path != view).read_bytes())
    assert content_sha256(str(photos)) not in hashes


def test_rendered_views_know_their_truth_and_views_held_out():
    target = load_image_target("views:of=bone,count=3,size=48,depth=true,hold_out=2")
    assert target.compared_with == "truth"
    assert target.views.have_depth
    assert len(target.held_out) == 2
    assert isinstance(target.shape, PointCloud)
    assert mask_ious(target.truth, target.views) == [1.0, 1.0, 1.0]
    overlap = mask_overlap(target.truth, target.views, target.held_out)
    assert (overlap.least, overlap.held_out_least) == (1.0, 1.0)
    assert {view.camera for view in target.views}.isdisjoint(view.camera for view in target.held_out)


def test_overlap_is_that_of_disks():
    mesh = icosphere(4)
    views = views_of(mesh, 2, depth=False, normals=False)
    small = mesh.with_verts(mesh.verts * 0.8)
    assert mask_ious(small, views) == pytest.approx([0.64, 0.64], abs=0.06)
    far = mesh.with_verts(mesh.verts + np.array([0.0, 5.0, 0.0]))
    assert max(mask_ious(far, views)) == 0.0
    overlap = mask_overlap(small, views)
    assert overlap.held_out_mean is None
    assert overlap.shortfalls[0].startswith("masks differ: IoU 0.6")
    assert not mask_overlap(mesh, views).shortfalls


def test_measuring_and_problems_take_a_target_of_images():
    truth, views = egg(), views_of(egg())
    target = ImageTarget(views, truth, "egg")
    measured = measure(truth, target, samples=500, points=500)
    assert measured.iou.mean == 1.0
    assert measured.hausdorff.symmetric < 1e-9
    assert measured.flat()["iou.mean"] == 1.0
    problem = Problem("icosahedron", replace(target, truth=None))
    assert problem.images is views
    assert problem.target.num_verts == sum(view.mask.sum() for view in views)
    frame = Frame((5.0, 0.0, 0.0), 2.0)
    moved = target.moved(frame)
    np.testing.assert_allclose(moved.shape.verts, frame.normalise(target.shape).verts, atol=1e-12)
    assert measure(frame.normalise(truth), moved, samples=500, points=500).iou.mean > 0.99
    with pytest.raises(MeshError, match="images: expected Views"):
        measure(truth, truth, images=[1])


CONFIG = """\
targets:
  - {views: {of: egg.ply, count: 3, size: 40, hold_out: 2}}
  - {images: photos, depth: false}
schemes: [loop]
source: {mesh: octahedron, levels: 2}
fit: {steps: 5, samples: 100}
measure: {samples: 500, points: 500}
device: cpu
"""


@pytest.fixture
def coarse_hulls(monkeypatch):
    """Let hulls be carved from few voxels."""
    monkeypatch.setattr("meshfit.images.visual_hull.visual_hull", partial(visual_hull, resolution=24))


@pytest.mark.usefixtures("coarse_hulls")
def test_an_experiment_with_images_runs_whole(photos):
    folder = photos.parent
    (folder / "small.yaml").write_text(CONFIG)
    with trials_in_this_process():
        ran = invoke("run", folder / "small.yaml", "--runs", folder / "runs", "-j", 1, "--quiet")
    assert ran.code == 0, ran.err
    assert "egg (3 views, 40 px)" in ran.out
    assert "distances are to the true mesh" in ran.out
    assert "distances are to the visual hull" in ran.out
    results = {path.parts[-4]: json.loads(path.read_text()) for path in (folder / "runs").rglob("result.json")}
    rendered, files = results["egg-3-views-40"], results["photos-no-depth"]
    assert rendered["images"] == {"views": 3, "held_out": 2, "compared_with": "truth"}
    assert files["images"] == {"views": 4, "held_out": 0, "compared_with": "hull"}
    assert rendered["iou"]["mean"] > 0.5
    assert rendered["iou"]["held_out_mean"] > 0.5
    assert files["iou"]["held_out_mean"] is None
    assert not files["shortfalls"] or files["shortfalls"][0].startswith("masks differ")
    assert "4 views, 0 held out" in answered(
        "show", next((folder / "runs/small/photos-no-depth").rglob("result.json")).parent
    )
    assert "mask IoU" in answered("table", folder / "runs")
    _check_that_the_run_has_its_images(folder, photos)


def _check_that_the_run_has_its_images(folder, photos):
    """Without the photographs, the run directory has them, and continues with them under the same identities."""
    loaded = load_images(f"images:images={photos},depth=false")
    shutil.rmtree(photos)
    path = next((folder / "runs/small/photos-no-depth").rglob("result.json"))
    images = read_images(path.parent, json.loads(path.read_text()))
    for view, kept in zip(loaded.target.views, images.views, strict=True):
        assert view.camera == kept.camera
        np.testing.assert_array_equal(view.mask, kept.mask)
        np.testing.assert_array_equal(view.normals, kept.normals)
    ran = invoke("run", folder / "small.yaml", "--runs", folder / "runs", "--dry-run")
    assert "2 trials: 2 complete, 0 to run" in ran.out
    assert "photos,depth=false: no such file; its copy in the run directory is used" in ran.err
    pack = folder / f"runs/targets/{loaded.sha256}.views.npz"
    assert pack.name in "".join(answered("show", path.parent).split())
    assert pack.stat().st_size < 60_000
    changes = ["--set", f"targets=[{pack}]", "--dry-run"]
    planned = answered("run", folder / "small.yaml", "--runs", folder / "runs", *changes)
    assert "1 trial: 1 complete, 0 to run" in planned


def test_a_worker_elsewhere_gets_the_images(photos):
    experiment = load_experiment("quickstart", [f"targets=[{photos}]", "fit.method=gauss-newton", "schemes=[loop]"])
    (trial,) = plan([experiment])
    store = RunDirectory(photos.parent / "runs")
    files = pack_inputs(trial, store)
    there = unpack_inputs(trial, files, store, photos.parent / "inputs")
    copy = there.current_path(trial.target)
    assert copy != trial.target
    assert load_images(copy).sha256 == dict(trial.inputs)["target"]
    assert there.identity == trial.identity


def test_the_source_for_depth_maps_is_the_hull_of_their_masks(monkeypatch):
    monkeypatch.setattr("meshfit.images.visual_hull.visual_hull", partial(visual_hull, resolution=24))
    views = views_of(egg())
    cloud = ImageTarget(views, None, "egg").shape
    for origin, reason in (("auto", "of 4 masks"), ("hull", "as set")):
        made = control_mesh_from(cloud, views, origin, verts=100)
        assert (made.made_from, made.reason) == ("hull", reason)
        assert made.mesh.num_verts <= 100
        assert Topology.of(made.mesh).is_watertight
    assert control_mesh_from(egg(), None, "auto", verts=100).made_from == "target"
    with pytest.raises(MeshError, match="hull: the target is not given by images"):
        control_mesh_from(egg(), None, "hull")
    with pytest.raises(ConfigError, match="bone: not given by images"):
        plan([load_experiment("accurate", ["targets=bone", "source.mesh=hull"])])


def test_settings_that_go_with_no_images_are_refused(photos):
    for setting, message in (
        ("target.sensor=[0,0,1]", "its cameras are known, so target.sensor has no effect"),
        ("target.surface=outer", "images show the outside alone"),
    ):
        with pytest.raises(ConfigError, match=message):
            plan([load_experiment("accurate", [f"targets=[{photos}]", setting])])
    with pytest.raises(ViewError, match="at most 3 views can be held out"):
        load_images(f"images:images={photos},hold_out=4")


@pytest.mark.usefixtures("coarse_hulls")
def test_a_mesh_is_fitted_to_a_folder_of_images_and_measured(photos, tmp_path):
    with trials_in_this_process():
        fitted = tmp_path / "fitted.obj"
        options = ("--source", tmp_path / "egg.ply", "--connectivity", "fixed", "--register", "off", "-q")
        ran = invoke("fit", photos, "-o", fitted, *options)
    assert ran.code == 0, ran.err
    assert ran.out.startswith("masks: IoU 0.9")
    assert "distance from" in ran.out
    out = answered("measure", fitted, photos, "--metric", "iou,distance.backward_rms", "--samples", 500)
    assert "mask IoU" in out
    out = answered("measure", fitted, f"images:images={photos},depth=false", "--samples", 500)
    assert "only masks can be compared" in out
    assert "Hausdorff" not in out
    assert "no masks" in refused("measure", fitted, tmp_path / "egg.ply", "--metric", "iou")
    assert "is a folder, not a mesh" in refused("fit", tmp_path, "-o", fitted)
    (photos / "transforms.json").unlink()
    photos.rename(tmp_path / "no-cameras")
    assert "has no cameras; expected transforms.json" in refused("fit", tmp_path / "no-cameras", "-o", fitted)


def test_specs_are_plain_values():
    assert image_spec("photos") == ImageFiles("photos")
    assert image_spec("views:of=bunny") == RenderedViews("bunny")
