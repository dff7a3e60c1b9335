"""`meshfit save`: meshes of finished trials in any format and either frame."""

import contextlib
import gzip
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh

from meshfit.experiment.storage.frame import frame_of
from meshfit.fitting.callbacks import Interrupted
from meshfit.mesh.io.files import load_mesh, load_polygons, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.targets import load_target
from tests.cli import answered, invoke, refused, trials_in_this_process
from tests.small import config_file, ellipsoid
from tests.unit.test_trial_runner import prepared, run_trial

pytestmark = pytest.mark.usefixtures("without_shape_checks")


@pytest.fixture
def finished(tmp_path, monkeypatch):
    """A function that runs a trial, and returns its folder and result."""
    monkeypatch.chdir(tmp_path)

    def run(**changes):
        trial, store, folder = prepared(tmp_path, fit={"steps": 2}, **changes)
        run_trial(trial, store, lambda _: None)
        return folder.relative_to(tmp_path), store.result(trial)

    return run


@pytest.mark.parametrize("written", ["target", "normalised"])
def test_meshes_are_written_in_either_frame_whatever_that_of_the_files(finished, written):
    folder, result = finished(write_frame=written)
    frame = frame_of(result)
    for what in ("result", "source"):
        answered("save", folder, "-o", "a.ply", "--what", what)
        answered("save", folder, "-o", "b.ply", "--what", what, "--frame", "normalised")
        own, normalised = load_mesh("a.ply"), load_mesh("b.ply")
        np.testing.assert_allclose(frame.restore(normalised).verts, own.verts, atol=1e-15)
        same = own if written == "target" else normalised
        np.testing.assert_array_equal(same.verts, load_mesh(folder / f"{what}.ply").verts)
    assert answered("save", folder, "-o", "t.ply", "--what", "target").startswith(
        "wrote t.ply: target of ellipsoid · loop · seed 0, 258 vertices, 512 faces, in the frame of the target's file"
    )
    np.testing.assert_array_equal(load_mesh("t.ply").verts, load_target("ellipsoid.ply").verts)
    answered("save", folder, "-o", "t.ply", "--what", "target", "--frame", "normalised")
    assert np.abs(load_mesh("t.ply").verts).max() == pytest.approx(1.0, abs=1e-12)


def test_the_result_lies_on_the_target_as_other_libraries_read_both(finished):
    ball = load_mesh(ellipsoid(Path.cwd()))
    save_mesh(Mesh(25.4 * ball.verts + [100.0, 0.0, -7.0], ball.faces), "big.stl")
    folder, result = finished(targets=[str(Path("big.stl").absolute())], source={"radius": 0.9})
    verts = {}
    for name in ("x.obj", "x.ply", "x.off", "x.stl", "x.glb", "x.gltf", "y.ply.gz"):
        answered("save", folder, "-o", name)
        if name.endswith(".gz"):
            Path("y.ply").write_bytes(gzip.decompress(Path(name).read_bytes()))
        verts[name] = trimesh.load_mesh(name.removesuffix(".gz"), process=True).vertices
    for name, found in verts.items():
        assert len(found) == len(verts["x.ply"]), name
        np.testing.assert_allclose(np.sort(found, axis=0), np.sort(verts["x.ply"], axis=0), rtol=1e-6, atol=1e-5)
    target = trimesh.load_mesh("big.stl")
    squares = igl.point_mesh_squared_distance(verts["x.ply"], np.asarray(target.vertices), np.asarray(target.faces))[0]
    assert np.sqrt(squares.max()) <= result["hausdorff"]["symmetric"] * result["frame"]["scale"] * 1.02


def test_polygons_stay_polygons_and_control_meshes_are_among_them(finished, tmp_path):
    fit = {"method": "gauss-newton", "connectivity": "fixed", "variables": "control", "levels": 1, "tries": 1}
    trial, store, folder = prepared(
        tmp_path,
        schemes=["catmull-clark"],
        source={"mesh": "cube", "levels": 1},
        fit=fit | {"coarse_steps": 2, "level_steps": 1, "last_steps": 1},
    )
    run_trial(trial, store, lambda _: None)
    for what in ("result", "control"):
        answered("save", folder, "-o", "x.obj", "--what", what)
        assert set(load_polygons("x.obj").sizes) == {4}
        assert load_polygons("x.obj").num_faces == load_polygons(folder / f"{what}.ply").num_faces


@pytest.mark.slow
def test_standard_output_gets_the_mesh_and_nothing_else(small_run):
    folder = next(small_run[0].glob("runs/small/*/loop/seed-0-*"))
    command = [sys.executable, "-m", "meshfit", "save", str(folder), "-o", "-", "--output-format", "off"]
    done = subprocess.run(command, capture_output=True, check=True, cwd="/", env=os.environ)
    assert done.stdout.startswith(b"OFF\n66 128 0\n")
    assert done.stderr.startswith(b"wrote standard output: result of ")


def test_single_precision_far_from_the_origin_is_warned_of(finished):
    mesh = load_mesh(ellipsoid(Path.cwd()))
    save_mesh(Mesh(mesh.verts + 1e6, mesh.faces), "far.ply")
    folder, _ = finished(targets=[str(Path("far.ply").absolute())])
    assert invoke("save", folder, "-o", "x.ply").err == ""
    ran = invoke("save", folder, "-o", "x.stl")
    assert "STL holds single precision, which rounds coordinates by up to 0.06" in ran.err
    assert "of the mesh's size; OBJ, PLY and OFF hold double precision" in ran.err


def test_what_is_not_finished_names_what_there_is(finished, tmp_path):
    trial, store, folder = prepared(tmp_path, fit={"optimizer": {"lr": 1e30}})
    run_trial(trial, store, lambda _: None)
    refusal = refused("save", folder, "-o", "x.obj")
    assert "ellipsoid · loop · seed 0: failed, so it has no result; the mesh before it diverged is " in refusal
    assert refusal.endswith("last_good.ply")
    trial, store, folder = prepared(tmp_path, fit={"steps": 30, "snapshots": 5})

    def stop(progress):
        if progress.step.done == 12:
            raise Interrupted

    run_trial(trial, store, stop)
    assert "interrupted, so it has no result; its latest snapshot, of step 10, is " in refused(
        "save", folder, "-o", "x.obj"
    )
    shutil.rmtree(folder / "snapshots")
    assert "`meshfit run` completes it" in refused("save", folder, "-o", "x.obj")
    folder, _ = finished()
    assert "no control mesh was fitted; fits with fit.variables: control" in refused(
        "save", folder, "--what", "control", "-o", "x.obj"
    )
    assert "no suffix to tell the mesh format" in refused("save", folder, "-o", "x")
    assert "no suffix" in refused("save", folder, "-o", "x")
    assert ".3mf" in refused("save", folder, "-o", "x.3mf")
    record = json.loads((folder / "result.json").read_text())
    (folder / "result.json").write_text(json.dumps(record | {"frame": {}}))
    assert "not the result of a trial: no 'centre' in its frame" in refused("save", folder, "-o", "x.obj")
    (folder / "result.ply").write_bytes(b"ply\n")
    (folder / "result.json").write_text(json.dumps(record))
    assert "result.ply has 4 bytes, expected " in refused("save", folder, "-o", "x.obj")


def test_a_run_directory_that_was_moved_works_from_anywhere_without_the_original(small_run, tmp_path):
    """Run with a relative path of the target, move, delete the original, and save and draw from elsewhere."""
    shutil.copytree(small_run[0] / "runs", tmp_path / "moved")
    for path in (tmp_path / "moved").rglob("result.json"):
        path.write_text(path.read_text().replace(str(small_run[0]), "/gone"))
    folder = next(tmp_path.glob("moved/small/*/loop/seed-0-*"))
    with contextlib.chdir("/"):
        answered("save", folder, "-o", tmp_path / "t.ply", "--what", "target")
        original = load_target(str(small_run[0] / "ellipsoid.ply"))
        np.testing.assert_array_equal(load_mesh(tmp_path / "t.ply").verts, original.verts)
        assert "targets" in answered("show", folder)


@pytest.mark.slow
def test_pictures_and_pages_too(tmp_path):
    pytest.importorskip("pyvista", reason="pictures need the extra `report`")
    (tmp_path / "work").mkdir()
    config_file(tmp_path / "work")
    with trials_in_this_process(), contextlib.chdir(tmp_path / "work"):
        fits = ("--set", "seeds=[0]", "--set", "fit.snapshots=10", "--set", "targets=[ellipsoid.ply]")
        answered("run", "small.yaml", "-q", *fits)
    shutil.move(tmp_path / "work/runs", tmp_path / "moved")
    shutil.rmtree(tmp_path / "work")
    folder = next(tmp_path.glob("moved/*/*/loop/seed-0-*"))
    with contextlib.chdir("/"):
        answered("figure", tmp_path / "moved", "-o", tmp_path / "figure.png")
        answered("render", folder, "-o", tmp_path / "render.png", "--against", "ellipsoid.ply")
        assert invoke("animate", folder, "-o", tmp_path / "fit.gif", "--size", 96).code == 0
        assert invoke("report", tmp_path / "moved", "-o", tmp_path / "page", "-q").code == 0
    page = (tmp_path / "page/index.html").read_text()
    assert "is not shown" not in page
