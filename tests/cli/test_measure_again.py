"""`meshfit measure --again`: complete trials measured with other settings, without their fits."""

import json
import shutil

import pytest

from tests.cli import answered, invoke, refused
from tests.cli.processes import contents
from tests.loops import over

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
    before = values(shown(runs))
    assert again().startswith("measured 4 of 4 trials again;")
    results = shown(runs)
    assert all("measured_again" in result for result in results)
    for new, old in zip(values(results), before, strict=True):
        assert new == pytest.approx(old, rel=1e-9)


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
    first.write_bytes(first.read_bytes()[:200])
    ran = invoke("measure", "--again", "runs", "-j", 1, "--samples", 700)
    assert ran.code == 1
    assert f"{first.relative_to(runs.parent)}: cannot be read as PLY" in ran.err
    assert "measured 3 of 4 trials again" in ran.out


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
