"""Fits with polygons as source or scheme: fitted as triangles, returned as polygons."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

import meshfit
from meshfit.config.source_settings import SourceSettings
from meshfit.errors import SchemeError
from meshfit.experiment.plan import plan
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.source import build_source
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.trial_status import TrialStatus
from meshfit.fitting.callbacks import Interrupted
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.refinement import refine_state
from meshfit.fitting.gauss_newton.schedule import schedule
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.io.files import load_mesh, load_polygons, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, face_rows
from meshfit.mesh.solids import cube, icosahedron
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.growth import growth
from meshfit.subdivision.polygons.table import POLYGON_SCHEMES
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.registry import resolve
from tests.checkpoints import through_a_file
from tests.fits import fit
from tests.loops import over
from tests.quads import quad_cube
from tests.small import experiment

GAUSS_NEWTON = {"method": "gauss-newton", "tries": 1, "coarse_steps": 2, "level_steps": 2, "last_steps": 1}
FAST = ("catmull-clark", "doo-sabin", "sqrt2")
ANYWHERE = sorted(POLYGON_SCHEMES.keys() - {"ternary", "interp-ternary"})


pytestmark = pytest.mark.usefixtures("fewer_target_points")


def goal():
    box = subdivide(cube(), "loop", 3)
    return Mesh(box.verts * np.array([1.0, 0.8, 0.6]), box.faces)


def run_trial(folder, scheme, **changes):
    (trial,) = plan([experiment(folder, schemes=[scheme], **changes)])
    store = RunDirectory(folder / "runs")
    (outcome,) = run_batch([trial], store, lambda *_: None)
    assert outcome.status is TrialStatus.COMPLETE, outcome.message
    return store.folder(trial), store.result(trial)


@pytest.mark.parametrize("scheme", ["catmull-clark", "doo-sabin", "sqrt2"])
def test_a_first_order_trial_keeps_the_polygons_of_its_source(tmp_path, scheme):
    folder, result = run_trial(tmp_path, scheme, source={"mesh": "cube", "levels": 2})
    before, after = (load_polygons(folder / f"{name}.ply") for name in ("source", "result"))
    assert np.array_equal(before.corners, after.corners)
    assert np.array_equal(before.sizes, after.sizes)
    assert (before.sizes == 4).sum() > 0.9 * before.num_faces or scheme == "doo-sabin"
    assert not np.array_equal(before.verts, after.verts)
    # A reader of triangles gets those that were measured.
    for polygons, name in ((before, "source"), (after, "result")):
        assert np.array_equal(load_mesh(folder / f"{name}.ply").faces, polygons.triangulated().faces)
    assert result["source"]["faces"] == before.triangulated().num_faces == result["quality"]["faces"]


def test_a_trial_starts_from_the_polygons_of_a_file_and_takes_snapshots_of_them(tmp_path):
    save_mesh(quad_cube(), tmp_path / "quads.obj")
    fit = {"steps": 4, "samples": 50, "snapshots": 2}
    source = {"mesh": str(tmp_path / "quads.obj"), "levels": 1, "align": "pca"}
    folder, _ = run_trial(tmp_path, "kobbelt", source=source, fit=fit)
    result = load_polygons(folder / "result.ply")
    assert result.sizes.tolist() == [4] * 24
    for step in (2, 4):
        assert np.array_equal(load_polygons(folder / f"snapshots/step-{step:06d}.ply").corners, result.corners)


def test_schemes_on_triangles_start_from_the_cube_of_triangles():
    found = build_source(SourceSettings(mesh="cube", levels=0), "loop")
    assert isinstance(found, Mesh)
    assert np.array_equal(found.faces, cube().faces)
    polygons = build_source(SourceSettings(mesh="cube", levels=0), "catmull-clark")
    assert isinstance(polygons, PolygonMesh)
    assert np.array_equal(polygons.verts, found.verts)
    assert polygons.sizes.tolist() == [4] * 6


@over("mesh", ["octahedron", "icosphere:level=1", "cube"])
@pytest.mark.parametrize("scheme", ANYWHERE)
def test_sources_may_be_put_on_a_sphere(mesh, scheme):
    found = build_source(SourceSettings(mesh=mesh, levels=2, project="sphere", radius=2.0, centre=(1, 0, 0)), scheme)
    assert isinstance(found, PolygonMesh)
    np.testing.assert_allclose(np.linalg.norm(found.verts - [1, 0, 0], axis=1), 2, atol=1e-12)


def test_decimation_leaves_triangles_to_go_on_from():
    found = build_source(SourceSettings(mesh="bone", decimate=200, levels=1), "catmull-clark")
    assert 3 * 190 < found.num_faces <= 3 * 200


def fitted(source, scheme, **changes):
    options = GAUSS_NEWTON | {"connectivity": "fixed", "levels": 1, "verts": 200} | changes
    return fit(source, goal(), device="cpu", scheme=scheme, **options)


def sphere(levels=1):
    return build_source(SourceSettings(mesh="cube", levels=levels, project="sphere", radius=0.3), "catmull-clark")


@pytest.mark.parametrize(
    "scheme",
    [scheme if scheme in FAST else pytest.param(scheme, marks=pytest.mark.slow) for scheme in ANYWHERE],
)
def test_a_gauss_newton_fit_refines_the_polygons_of_its_source(scheme):
    source = sphere(2)
    result = fitted(source, scheme)
    expected = PolygonTopology.of(subdivide(source, scheme, 1))
    assert result.polygons.num_verts == expected.num_verts
    assert np.array_equal(np.sort(result.polygons.sizes), np.sort(expected.sizes))
    assert np.array_equal(result.polygons.triangulated().faces, result.mesh.faces)
    assert np.array_equal(result.polygons.verts, result.mesh.verts)
    before, after = (
        meshfit.measure(mesh, goal(), samples=500, points=200) for mesh in (source.triangulated(), result.mesh)
    )
    assert after.distance.mean < before.distance.mean / 3
    assert after.quality.self_intersecting_faces == 0


def test_two_levels_go_on_from_quads_and_not_from_their_triangles():
    source = sphere(1)
    result = fitted(source, "catmull-clark", levels=2)
    assert result.polygons.num_faces == 16 * source.num_faces
    assert (result.polygons.sizes == 4).all()


def test_a_control_mesh_of_quads():
    source = sphere(1)
    result = fitted(source, "catmull-clark", levels=2, variables="control")
    assert result.control.num_verts == source.num_verts
    assert result.polygons.num_faces == 16 * source.num_faces
    assert np.array_equal(result.polygons.triangulated().faces, result.mesh.faces)
    expected = subdivide(source.with_verts(result.control.verts), "catmull-clark", 2).verts
    np.testing.assert_allclose(result.mesh.verts, expected, rtol=0, atol=1e-6)


def test_where_the_connectivity_is_remeshed_triangles_come_back():
    result = fitted(sphere(2).triangulated(), "catmull-clark", connectivity="remeshed", verts=300)
    assert result.polygons is None
    assert 0.6 * 300 < result.mesh.num_verts <= 300


def test_without_a_last_remesh_polygons_of_a_triangle_surface_come_back():
    """A source of triangles is refined to quads, three of each."""
    mesh = subdivide(icosahedron(), "midpoint", 1)
    result = fitted(mesh.with_verts(0.3 * mesh.verts), "catmull-clark")
    assert result.polygons.sizes.tolist() == [4] * (3 * mesh.num_faces)


def content(result):
    polygons = result.polygons
    return polygons.verts.tobytes(), polygons.corners.tobytes(), result.mesh.faces.tobytes(), result.trace.to_csv()


@cache
def uninterrupted(**changes):
    return content(fitted(sphere(1), "kobbelt", **changes))


@pytest.mark.parametrize(
    "changes", [{}, pytest.param({"variables": "control"}, marks=pytest.mark.slow)], ids=["verts", "control"]
)
@over("stop", [2, 5])
def test_a_fit_goes_on_from_a_checkpoint_to_the_same_bytes(changes, stop):
    saved = []

    def interrupt(step):
        if step.done == stop:
            raise Interrupted

    with pytest.raises(Interrupted):
        fitted(sphere(1), "kobbelt", **changes, on_step=interrupt, save=saved.append)
    again = fitted(sphere(1), "kobbelt", **changes, resume=through_a_file(saved[-1]))
    assert content(again) == uninterrupted(**changes)


@pytest.mark.parametrize("scheme", ["interp-catmull-clark", "kobbelt", "interp-sqrt2"])
def test_refined_surfaces_keep_old_verts_and_are_sound(scheme):
    mesh = sphere(2)
    triangles = mesh.triangulated()
    surface = FitState.of(torch.tensor(mesh.verts), torch.tensor(triangles.faces), polygons=PolygonTopology.of(mesh))
    fine = refine_state(surface, scheme)
    expected = subdivide(mesh, scheme)
    np.testing.assert_allclose(fine.verts.numpy(), expected.verts, rtol=0, atol=1e-12)
    assert face_rows(expected) == [fine.polygons.corners_of(face) for face in range(fine.polygons.num_faces)]
    assert np.array_equal(fine.pattern.connectivity.faces, expected.triangulated().faces)
    plain = refine_state(replace(surface, polygons=None), scheme)
    assert plain.polygons.num_verts == subdivide(triangles, scheme).num_verts


@pytest.mark.parametrize("scheme", ANYWHERE)
def test_growth_is_that_of_large_closed_surfaces_of_triangles(scheme):
    mesh = subdivide(icosahedron(), "midpoint", 3)
    for levels in (0, 1, 2):
        found = subdivide(mesh, scheme, levels).num_verts / mesh.num_verts
        assert np.isclose(found, growth(resolve(scheme), levels), rtol=0.01)
    assert growth(resolve("sqrt3"), 3) == 64


def test_the_last_remesh_is_to_as_many_verts_as_levels_have_made():
    for levels in (0, 1, 3):
        last = schedule(GaussNewtonSettings(levels=levels, decimate_from=1))[-1]
        assert (last.change, last.share, last.refined) == ("remesh", 1.0, levels)


def test_a_limit_of_polygons_is_not_known():
    with pytest.raises((SchemeError, meshfit.MeshfitError), match="limit"):
        fitted(sphere(1), "catmull-clark", variables="control", limit=True)
