"""Clouds of points as targets: fitted, measured, tabulated, drawn and saved, and refused where they cannot serve."""

import json
import os
import re
import signal

import numpy as np
import pytest

from meshfit.config.loading import load_experiment
from meshfit.errors import MeshError
from meshfit.experiment.plan import plan
from meshfit.experiment.running.backends import Remote
from meshfit.experiment.running.scheduler import run_trials
from meshfit.experiment.running.trial_target import load_trial_target
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.storage.targets import read_target
from meshfit.fitting.fit import fit
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.io.point_clouds import load_point_cloud
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.proximity import point_distances
from meshfit.subdivision.sphere import icosphere
from tests.cli import answered, invoke, refused, trials_in_this_process
from tests.cli.processes import contents, meshfit, start, wait_until
from tests.inline import Inline

FEW = "fit={coarse_steps: 3, tries: 1, level_steps: 4, last_steps: 2}"
SMALL = ("--set", FEW, "--set", "measure={samples: 500, points: 500}")
CONFIG = """\
targets: [points.xyz]
schemes: [loop]
source: {mesh: auto, wanted_verts: 150}
fit: {method: gauss-newton, verts: 150, level_steps: 4, last_steps: 2, levels: 0}
measure: {samples: 500, points: 500}
device: cpu
"""
FAR = np.array([4e5, -5e6, 300.0])


def rays(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with trials_in_this_process():
        yield


def points(name, *columns):
    np.savetxt(name, np.hstack(columns), fmt="%.17g")


def test_a_cloud_becomes_a_closed_surface_in_its_own_place(tmp_path):
    points("points.xyz", 20 * rays(1500) + FAR)
    ran = invoke("fit", "points.xyz", "-o", "out.ply", "--verts", "300", *SMALL, "--keep", "kept", "--noise", "0.01")
    assert ran.code == 0, ran.err
    distances, sound, _, *more = ran.out.splitlines()
    assert len(more) == 1, more
    assert re.match(r"distance from 1,500 points: worst [\d.]+ \([\d.]+ % of the diagonal\), mean ", distances)
    assert sound == "faces: 0 crossing, 0 flipped; 1 piece, closed, genus 0 (target: points, without pieces or genus)"
    result = load_mesh("out.ply")
    radii = np.linalg.norm(result.verts - FAR, axis=1)
    assert np.abs(radii - 20).max() < 0.4
    (folder,) = (path.parent for path in (tmp_path / "kept").rglob("result.json"))
    record = json.loads((folder / "result.json").read_text())
    # The noise is given in the unit of the file.
    assert record["settings"]["fit"]["noise"] == pytest.approx(0.01 / record["frame"]["scale"])
    assert record["cloud"]["points"] == 1500
    assert record["shortfalls"] == []
    assert record["source"]["reason"] == "a cloud of points"
    scale = record["frame"]["scale"]
    exact = point_distances(result, load_point_cloud("points.xyz").verts)
    assert record["hausdorff"]["backward"] * scale == pytest.approx(exact.max(), rel=1e-3)
    shown = answered("show", str(folder))
    assert "source      from the wrap (a cloud of points), alpha 0." in shown
    assert "points      1,500, about 0." in shown
    answered("save", str(folder), "--what", "target", "-o", "again.ply")
    assert load_point_cloud("again.ply").verts.tobytes() == load_point_cloud("points.xyz").verts.tobytes()
    assert refused("save", str(folder), "--what", "target", "-o", "again.stl").endswith("give a name in .ply or .obj")


def test_measure_leads_with_what_is_exact_and_writes_null_for_the_rest(tmp_path):
    save_mesh(icosphere(3), "ball.ply")
    points("points.xyz", 1.1 * rays(2000))
    few = ("--samples", 2000)
    out = answered("measure", "ball.ply", "points.xyz", *few)
    first = out.splitlines()[2]
    assert first.startswith("Hausdorff distance, target to result")
    assert "the target is 2,000 points, about 0.0" in out
    assert "angles are to estimated ones, which have no side" in out
    assert "a point of the target" in out
    values = json.loads(answered("measure", "ball.ply", "points.xyz", "--json", *few))
    assert values["normal_consistency"]["signed"] is None
    assert values["distance"]["backward_rms"] == pytest.approx(0.1, rel=0.05)
    table = answered("measure", "ball.ply", "ball.ply", "--target", "points.xyz", *few)
    assert table.index("RMS") < table.index("F-score")
    ran = answered("measure", "ball.ply", "points.xyz", "--write", "errors.ply", *few)
    assert ran.endswith("wrote errors.ply: distances, unsigned, to the nearest points of the target\n")
    assert "points.xyz: expected a surface, got a cloud" in refused("measure", "points.xyz", "ball.ply")


def test_runs_carry_the_points_and_tables_lead_with_the_distance_from_them(tmp_path):
    points("points.xyz", rays(800), rays(800))
    (tmp_path / "a.yaml").write_text(CONFIG)
    assert invoke("run", "a.yaml", "--runs", "runs").code == 0
    (carried,) = (tmp_path / "runs" / "targets").glob("*.ply")
    cloud = load_point_cloud(carried)
    assert cloud.verts.tobytes() == load_point_cloud("points.xyz").verts.tobytes()
    assert cloud.normals is not None
    table = answered("table", "runs")
    assert "RMS distance, target to result" in table
    (trial,) = (path.parent for path in (tmp_path / "runs").rglob("result.json"))
    # A worker that has only the files that are sent to it gives the same bytes.
    points("points.xyz", rays(800), rays(800))
    trials = plan([load_experiment("a.yaml")])
    run_trials(trials, RunDirectory(tmp_path / "again"), remote=Remote(Inline(), transfer="returned"))
    for name in ("result.ply", "source.ply", "trace.csv"):
        (copy,) = (tmp_path / "again").rglob(name)
        assert copy.read_bytes() == (trial / name).read_bytes(), name
    (tmp_path / "points.xyz").unlink()
    answered("save", str(trial), "--what", "target", "-o", "again.obj")
    assert load_point_cloud("again.obj").num_verts == 800


def test_a_sensor_is_part_of_a_trial_and_decides_the_side(tmp_path):
    seen = rays(900)
    seen = seen[seen[:, 2] > 0.2]
    points("points.xyz", seen + np.array([5.0, 0, 0]))
    (tmp_path / "a.yaml").write_text(CONFIG)
    places = ("[5, 0, 9]", "[5, 0, 0]")
    trials = [plan([load_experiment("a.yaml", [f"target.sensor={place}"])])[0] for place in places]
    assert trials[0].identity != trials[1].identity
    for trial, side in zip(trials, (1, -1), strict=True):
        cleaning, known = trial.settings.cleaning, trial.settings.target
        target = load_trial_target(trial.target, None, "box", cleaning, known, None).mesh
        record = {"settings": {"targets": [trial.target], "target": {"sensor": known.sensor}}}
        for cloud in (target, read_target(tmp_path, record)):
            assert (side * np.einsum("nk,nk->n", cloud.normals, seen) > 0.9).mean() > 0.95
    # No place sees a whole ball.
    points("ball.xyz", rays(900))
    place = trials[0].settings.target.model_copy(update={"sensor": (0.0, 0.0, 5.0)})
    (text,) = load_trial_target(str(tmp_path / "ball.xyz"), None, "box", cleaning, place, None).warnings
    assert text.startswith("target.sensor: from (0, 0, 5), ")
    assert text.endswith(
        " % of the points are hidden behind others, and their normals face inwards; give the place "
        "they were seen from, or none"
    )


FLAT = {
    "four": (np.vstack([np.eye(3), np.zeros(3)]), "4 points are too few to tell a surface; give 48 or more"),
    "few": (rays(47), "47 points are too few to tell a surface; give 48 or more"),
    "plane": (rays(60) * [1, 1, 0], "its 60 points lie in a plane, and no closed surface does; start from a sheet: "),
    "line": (rays(60)[:, :1] * [1, 2, 3] + np.float32(0.1), "its 60 points lie on a line: there is no surface in them"),
}


def test_points_without_a_closed_surface_are_refused(tmp_path):
    for name, (verts, message) in FLAT.items():
        points(f"{name}.xyz", verts)
        assert message in refused("fit", f"{name}.xyz", "-o", "a.ply")
        if name != "line":
            with pytest.raises(MeshError, match=message[:20]):
                fit("sphere", PointCloud(verts), method="gauss-newton")
    (tmp_path / "a.ptx").write_text("1\n1\n")
    assert refused("fit", "a.ptx", "-o", "a.ply").endswith("export its points as PLY, XYZ, PTS, PCD or LAS")
    (tmp_path / "a.foo").write_text("\x01")
    assert ", .xyz, .xyzn, .pts, " in refused("fit", "a.foo", "-o", "a.ply")


REFUSED = {
    "first-order": ("fit={method: first-order}", "without the faces that fit.method: first-order samples; use fit.met"),
    "target": (
        "source={mesh: target}",
        "without the faces that source.mesh: target starts from; use source.mesh: wrap",
    ),
    "quadric": (
        "fit={method: external, tool: quadric}",
        "without the faces that quadric needs; use fit.tool: poisson, alpha-wrap, pycpd, ",
    ),
}


def test_what_a_cloud_cannot_serve_is_refused_with_what_to_use(tmp_path):
    points("points.xyz", rays(50))
    (tmp_path / "a.yaml").write_text(CONFIG)
    for setting, message in REFUSED.values():
        (tmp_path / "a.yaml").write_text(CONFIG if "source" in setting else "targets: [points.xyz]\n")
        line = refused("run", "a.yaml", "--runs", "runs", "--set", setting)
        assert f"{tmp_path / 'points.xyz'}: a cloud of 50 points, {message}" in line
    text = "its faces tell the outside, so target.sensor has no effect; remove it"
    assert refused("fit", "bone", "-o", "a.ply", "--sensor", "0,0,1") == f"error: bone: {text}"
    for option, value, message in (
        ("--sensor", "1,2", "expected three numbers with commas between them, such as 0,0,2.5"),
        ("--sensor", "1,2,nan", "expected three numbers with commas between them, such as 0,0,2.5"),
        ("--noise", "-1", "expected auto, or a length of 0 or more in the unit of the target's file"),
    ):
        assert refused("fit", "points.xyz", "-o", "a.ply", option, value) == f"error: {option} {value}: {message}"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_two_workers_and_a_run_that_was_killed_give_the_bytes_of_one(tmp_path):
    names = ("result.ply", "source.ply", "trace.csv")
    points("points.xyz", rays(1500))
    (tmp_path / "a.yaml").write_text(CONFIG.replace("[loop]", "[loop, interp-loop]").replace("150", "600"))
    for jobs in (1, 2):
        meshfit("run", "a.yaml", "-q", "--runs", f"jobs{jobs}", "--jobs", jobs, folder=tmp_path)
    process = start("run", "a.yaml", "-q", "--runs", "killed", "--jobs", 1, folder=tmp_path)
    wait_until(lambda: any((tmp_path / "killed").rglob("progress.json")), process)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)
    meshfit("run", "a.yaml", "-q", "--runs", "killed", folder=tmp_path)
    expected = contents(tmp_path / "jobs1", *names)
    assert len(expected) == 6
    assert contents(tmp_path / "jobs2", *names) == expected
    assert contents(tmp_path / "killed", *names) == expected


@pytest.mark.slow
def test_tools_that_take_points_get_them(tmp_path):
    points("points.xyz", rays(2000), rays(2000))
    (tmp_path / "a.yaml").write_text("targets: [points.xyz]\nschemes: [loop]\nmeasure: {samples: 500, points: 500}\n")
    for tool in ("alpha-wrap", "poisson"):
        options = "{alpha: 0.1, offset: 0.01}" if tool == "alpha-wrap" else "{depth: 5}"
        setting = f"fit={{method: external, tool: {tool}, options: {options}}}"
        assert invoke("run", "a.yaml", "--runs", tool, "--set", setting).code == 0
        (path,) = (tmp_path / tool).rglob("result.json")
        assert json.loads(path.read_text())["distance"]["backward_mean"] < 0.05
