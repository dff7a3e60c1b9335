"""`meshfit measure --again`: complete trials measured with other settings, without their fits."""

import json
import shutil
from functools import partial

import numpy as np
import pytest

from meshfit.experiment.running.measuring_again import measure_trial_again
from meshfit.experiment.storage.result import read_result_or_warn
from meshfit.experiment.trial_status import TrialStatus
from meshfit.images.visual_hull import visual_hull
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from tests.cli import answered, invoke, refused
from tests.cli.processes import contents
from tests.loops import over
from tests.small import ellipsoid
from tests.unit.test_trial_runner import prepared, run_trial

NAMES = (
    "hausdorff.symmetric",
    "distance.mean",
    "f_score.f1",
    "normal_angle.mean",
    "normal_consistency.signed",
    "quality.faces",
)


@pytest.fixture
def runs(small_run, tmp_path, monkeypatch):
    """A copy of a complete experiment of four trials."""
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(small_run[0] / "runs", tmp_path / "runs")


def again(*options):
    return answered("measure", "--again", "runs", "-j", 1, *options)


def shown(runs):
    return [json.loads(answered("show", path.parent, "--json"))["result"] for path in sorted(runs.rglob("result.json"))]


def mean_distances():
    return answered("table", "runs", "-f", "csv", "--metric", "distance.mean")


def values(results):
    return [[result[group][name] for group, name in (name.split(".") for name in NAMES)] for result in results]


def test_the_settings_of_the_fit_give_its_values_again(runs):
    before = shown(runs)
    again("--samples", 700)
    part = next(runs.rglob("measurement.json")).with_name(".measurement.json.0123abcd")
    part.touch()  # left by a killed process
    assert values(shown(runs)) != values(before)
    assert again() == "measured 0 of 4 trials again, 4 have the values of the fit again\n"
    assert shown(runs) == before
    assert not [*runs.rglob("*measurement.json*")]


TINY = {"method": "gauss-newton", "connectivity": "fixed", "levels": 1, "tries": 1}
TINY |= dict.fromkeys(("coarse_steps", "level_steps", "last_steps"), 1)
OUTER = {"surface": "outer", "samples": 700, "points": 500}
KINDS = {
    "nested": ({"steps": 15}, OUTER),
    "cloud": (TINY, {"samples": 700, "points": 500}),
    "images": (TINY, {"samples": 700, "points": 500}),
    "template": ({"steps": 15}, OUTER),
}


def kind_of_target(kind, folder):
    """A target, and what a config needs for it."""
    path = ellipsoid(folder, "source.ply")
    mesh = load_mesh(path)
    changes = {}
    if kind == "template":
        changes |= {"source": {"mesh": str(path), "radius": None, "centre": None}}
        changes |= {"target": {"truth": str(folder / "truth.ply")}}
    if kind == "images":
        return f"views:of={path},count=3,size=32", changes
    if kind == "cloud":
        np.savetxt(folder / "cloud.xyz", mesh.verts)
        return str(folder / "cloud.xyz"), changes
    inner = Mesh(mesh.verts * 0.2, mesh.faces)
    both = Mesh(np.vstack([mesh.verts, inner.verts]), np.vstack([mesh.faces, inner.faces + mesh.num_verts]))
    save_mesh(both, folder / "nested.ply")
    save_mesh(mesh, folder / "truth.ply")
    return str(folder / "nested.ply"), changes


@pytest.mark.filterwarnings("ignore::meshfit.errors.MeshfitWarning")
@pytest.mark.parametrize(
    "kind", ["nested", "cloud", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("images", "template"))]
)
def test_all_that_depends_on_the_measurement_is_as_in_a_fit_with_its_settings(kind, tmp_path, monkeypatch):
    """Verdict, findings and warnings, too, from the files of the run directory alone."""
    monkeypatch.setattr("meshfit.images.visual_hull.visual_hull", partial(visual_hull, resolution=24))
    fit, settings = KINDS[kind]
    target, known = kind_of_target(kind, tmp_path)
    changes = {"targets": [target], **known, "fit": fit, "write_frame": "normalised"}
    folders = []
    for measure in ({"measure": {"samples": 500, "points": 500}}, {"measure": settings}):
        trial, store, folder = prepared(tmp_path, **changes, **measure)
        assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
        folders.append(folder)
    for path in tmp_path.glob("*.*"):
        path.unlink()
    first, wanted = map(read_result_or_warn, folders)
    assert measure_trial_again(folders[0], settings).error == ""
    found = read_result_or_warn(folders[0])
    for key in wanted.keys() - {"seconds", "peak_memory_mb", "finished", "folder", "identity"}:
        assert found[key] == wanted[key], key
    assert (found["verdict"] == first["verdict"]) == (kind == "cloud")


def test_new_values_are_those_of_a_run_with_these_settings_and_the_old_ones_stay(runs):
    kept, table = contents(runs, "result.json"), mean_distances()
    again("--samples", 700, "--set", "measure.points=6e2")
    assert contents(runs, "result.json") == kept
    results = shown(runs)
    for result in results:
        assert (result["settings"]["measure"]["samples"], result["settings"]["measure"]["points"]) == (700, 600)
        assert result["measured_again"]["settings"]["samples"] == 500
    assert mean_distances() != table
    assert "measured on 700 samples" in answered("table", "runs")
    exported = runs.parent / "all.csv"
    answered("export", "runs", "-o", exported)
    assert f"{results[0]['distance']['mean']}" in exported.read_text()
    once = contents(runs, "measurement.json")
    assert "measured 0 of 4 trials again, 4 measured with these settings before" in again(
        "--samples", 700, "--set", "measure.points=600"
    )
    assert contents(runs, "measurement.json") == once
    for path in runs.rglob("measurement.json"):
        path.unlink()
    assert mean_distances() == table


def test_a_measurement_of_an_earlier_result_or_a_damaged_one_is_not_used(runs):
    again("--samples", 700)
    first, second, *_ = sorted(runs.rglob("result.json"))
    first.write_text(json.dumps(json.loads(first.read_text()) | {"finished": "2020-01-01T00:00:00Z"}))
    assert "measured_again" not in json.loads(answered("show", first.parent, "--json"))["result"]
    (second.parent / "measurement.json").write_text("{")
    ran = invoke("table", "runs")
    assert ran.code == 0
    assert ran.err.count("values of the fit are used") == 1
    ran = invoke("measure", "--again", "runs", "-j", 1, "--samples", 700)
    assert (ran.code, "measured 2 of 4 trials again" in ran.out) == (0, True)


def test_a_trial_that_cannot_be_measured_is_named_and_the_others_are_measured(runs):
    first, *_ = sorted(runs.rglob("result.ply"))
    first.write_bytes(first.read_bytes()[:-1] + b"x")
    ran = invoke("measure", "--again", "runs", "-j", 1, "--samples", 700)
    assert ran.code == 1
    assert f"{first.relative_to(runs.parent)}: damaged: not the mesh that the trial wrote; delete " in ran.err
    assert "measured 3 of 4 trials again" in ran.out


def test_a_run_with_other_settings_of_the_measurement_names_the_fits_that_are_complete(small_run, runs, monkeypatch):
    monkeypatch.setattr("meshfit.cli.experiments.estimated", lambda *_, **__: None)
    config = small_run[0] / "small.yaml"
    options = ("--runs", runs, "--dry-run", "--set", "measure.samples=700", "--seeds", 1)
    line = "2 trials with a complete fit are new trials, as measure.samples was 500; to keep the fits: "
    assert invoke("run", config, *options).err.count(f"{line}meshfit measure --again {runs}/small ") == 1
    for other in ("fit.steps=21", "measure.samples=500", "sweep.measure.samples=[500,700]"):
        assert "complete fit" not in invoke("run", config, *options, "--set", other).err


@over(
    ("options", "words"),
    [
        (["--again", "runs", "--set", "fit.steps=3"], "--set fit: needs another fit"),
        (["--again", "runs", "--set", "measure.sample=3"], "did you mean 'samples'?"),
        (["--again", "runs", "--json"], "--json: no effect with --again"),
        (["--again", "elsewhere"], "elsewhere: no such run directory"),
        (["a.ply", "b.ply", "--set", "measure.points=300"], "--set: for trials of run directories; give --again"),
    ],
)
def test_what_cannot_be_done_is_refused(runs, options, words):
    assert words in refused("measure", *options)
    assert not list(runs.rglob("measurement.json"))


@pytest.mark.slow
def test_several_processes_give_the_same_bytes(runs):
    again("--samples", 700)
    alone = {path: json.loads(text)["values"] for path, text in contents(runs, "measurement.json").items()}
    for path in runs.rglob("measurement.json"):
        path.unlink()
    answered("measure", "--again", "runs", "-j", 2, "--samples", 700)
    assert {path: json.loads(text)["values"] for path, text in contents(runs, "measurement.json").items()} == alone
