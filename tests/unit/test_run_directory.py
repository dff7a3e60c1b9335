import json
import math
import os
import shutil
from pathlib import Path

import pytest

from meshfit.errors import MeshError, MeshfitWarning, StoreError
from meshfit.experiment.plan import plan
from meshfit.experiment.storage.failure import read_failure
from meshfit.experiment.storage.mesh_files import check_mesh_file, file_record
from meshfit.experiment.storage.result import read_results
from meshfit.experiment.storage.run_directory import (
    RunDirectory,
    json_text,
    make_folder,
    read_result,
    write_atomically,
)
from tests.loops import over
from tests.runs import complete, failed, result_of
from tests.small import experiment


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "result.json"
    write_atomically(path, "old")

    def full(_descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match=r"result\.json: cannot be written: No space left on device"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_open_reader_still_sees_the_whole_old_file(tmp_path):
    path = tmp_path / "result.json"
    write_atomically(path, "old and long")
    with path.open() as reader:
        write_atomically(path, "new")
        assert reader.read() == "old and long"
    assert path.read_text() == "new"


def test_a_place_that_cannot_hold_runs_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match=r"cannot be created: .*; choose another place with --runs"):
        make_folder(tmp_path / "file" / "runs")


def test_results_are_found_below_any_folder_and_name_where_they_lie(tmp_path):
    for name in ("b/two", "a/one"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "result.json").write_text(json.dumps(result_of() | {"host": name}))
        (tmp_path / name / ".result.json.x1").write_text("half")
    found = read_results([tmp_path])
    assert [result["host"] for result in found] == ["a/one", "b/two"]
    assert [Path(result["folder"]) for result in found] == [tmp_path / "a/one", tmp_path / "b/two"]
    assert len(read_results([tmp_path / "a", tmp_path])) == 2


def test_results_are_found_at_any_depth_in_the_order_of_their_paths(tmp_path):
    folders = ["z", "a-b", "a/c/d/e", "a", "a.b", ".hidden"]
    for folder in folders:
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / "result.json").write_text(json.dumps(result_of() | {"host": folder}))
        (tmp_path / folder / "other.json").write_text("{}")
    (tmp_path / "z/round").symlink_to(tmp_path, target_is_directory=True)
    expected = sorted(tmp_path / folder / "result.json" for folder in folders)
    found = read_results([tmp_path])
    assert [Path(result["folder"]) for result in found] == [path.parent for path in expected]
    assert [result["host"] for result in found] == [str(path.parent.relative_to(tmp_path)) for path in expected]
    with pytest.raises(StoreError, match="no complete trial under"):
        read_results([tmp_path / "z/other.json"])


@over(
    ("changes", "message"),
    [
        ("{", "not valid JSON: Expecting property name enclosed in double quotes: line 1 column 2 (char 1)"),
        ("", "not valid JSON: Expecting value"),
        ("\ud800", "not valid JSON"),
        ("[]", "expected a JSON object, got a list"),
        ("{}", "not the result of a trial: no schema_version"),
        ({"seed": "1"}, 'not the result of a trial: seed is "1"'),
        ({"settings": {"targets": []}}, "not the result of a trial: no settings.targets"),
        ({"distance": {"mean": math.nan}}, "distance.mean is NaN, expected a finite number"),
        ({"distance": {"mean": "0.1"}}, 'distance.mean is "0.1", expected a finite number'),
        ({"distance": {"mean": 10**400}}, "distance.mean is …, expected a finite number"),
        ({"settings": {"targets": ["a"], "schemes": []}}, "not the result of a trial: no settings.schemes"),
        ({"quality": {"components": 3.7}}, "quality.components is 3.7, expected a whole number"),
        ({"quality": {"components": 3.0}}, "quality.components is 3.0, expected a whole number"),
        ({"quality": {"watertight": 1}}, "quality.watertight is 1, expected true or false"),
        ({"distance": {"mean": True}}, "distance.mean is true, expected a finite number"),
        ({"distance": {"mean": -0.5}}, "distance.mean is -0.5, which is impossible"),
        ({"seed": ["long"] * 10**5}, 'not the result of a trial: seed is ["long", '),
        ({"seconds": {"fit": "10"}}, 'not the result of a trial: seconds.fit is "10", expected a number'),
        (
            {"seconds": {"fit": math.inf}},
            "not the result of a trial: seconds.fit is Infinity, expected a finite number",
        ),
        ({"seconds": {"fit": -1.0}}, "not the result of a trial: seconds.fit is -1.0, which is impossible"),
        ({"frame": True}, "not the result of a trial: frame is true, expected an object"),
        ({"versions": {"numpy": 2}}, "not the result of a trial: versions.numpy is 2, expected text"),
        ({"warnings": [["a"]]}, 'not the result of a trial: warnings.0 is ["a"], expected text'),
        ({"verdict": {"sound": True, "checks": [{}]}}, "not the result of a trial: no verdict.checks.0.name"),
        ({"cloud": {}}, "not the result of a trial: no cloud.points"),
        ({"hausdorff": []}, "hausdorff is [], expected an object"),
        ("[" * 200_000, "not valid JSON: nested too deeply"),
        ('{"a":' * 100_000, "not valid JSON: nested too deeply"),
    ],
)
def test_a_damaged_result_takes_only_its_own_trial_out(tmp_path, changes, message):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.json").write_text(json.dumps(result_of()))
    path = tmp_path / "b/result.json"
    text = changes if isinstance(changes, str) else json.dumps(result_of() | changes)
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.warns(MeshfitWarning) as caught:
        assert [Path(result["folder"]).name for result in read_results([tmp_path])] == ["a"]
    (text,) = (str(warning.message) for warning in caught)
    assert text.startswith(f"left out: {path}: {message}")
    assert text.endswith("; the next `meshfit run` repeats the trial")
    assert len(text) < 300 + len(str(path))
    with (
        pytest.warns(MeshfitWarning),
        pytest.raises(StoreError, match=r"no complete trial under .*; damaged: 1 result"),
    ):
        read_results([path.parent])


def test_a_result_of_another_trial_or_with_a_damaged_mesh_is_damaged(tmp_path):
    own, other = complete(tmp_path, seed=0), complete(tmp_path, seed=1)
    shutil.copy(other / "result.json", own)
    with pytest.raises(
        StoreError, match=r"result.json: the result of another trial, \w{10}; the next `meshfit run` rep"
    ):
        read_result(own)
    mesh = (other / "result.ply").read_bytes()
    record = json.loads((other / "result.json").read_text()) | {"files": {"result.ply": file_record(mesh)}}
    (other / "result.json").write_text(json.dumps(record))
    check_mesh_file(other / "result.ply", read_result(other))
    (other / "result.ply").write_bytes(b"x" + mesh[1:])
    with pytest.raises(
        MeshError, match=r"result.ply: damaged: not the mesh that the trial wrote; delete .*result.json"
    ):
        check_mesh_file(other / "result.ply", read_result(other))
    (other / "result.ply").write_bytes(mesh[1:])
    with pytest.raises(StoreError, match=r"result.ply has 2 bytes, expected 3; the next `meshfit run` repeats"):
        read_result(other)
    (other / "result.ply").unlink()  # to save space, say
    assert read_result(other) == record


@over(
    "change",
    [{"step": "7"}, {"kind": ["a"]}, {"message": None}, {"attempts": -1}, {"identity": "0" * 64}, {"traceback": "a"}],
)
def test_a_record_of_a_failure_that_is_damaged_or_of_another_trial_is_unreadable(tmp_path, change):
    folder = failed(tmp_path)
    assert read_failure(folder).kind == "diverged"
    path = folder / "failure.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    failure = read_failure(folder)
    assert (failure.kind, failure.record) == ("unreadable", {})
    assert str(path) in failure.message


def test_a_folder_in_the_place_of_a_file_is_set_aside_and_a_link_is_not_written_through(tmp_path):
    (trial,) = plan([experiment(tmp_path)])
    store = RunDirectory(tmp_path / "runs")
    with store.lock(trial):
        folder = store.folder(trial)
        (folder / "result.json/mine").mkdir(parents=True)
        (tmp_path / "precious").write_text("mine")
        (folder / "trial.log").symlink_to(tmp_path / "precious")
        store.clear(trial)
        store.write(trial, "result.json", "{}")
        store.append(trial, "trial.log", "line")
    assert [path.name for path in folder.glob("result.json-set-aside-*/*")] == ["mine"]
    assert (tmp_path / "precious").read_text() == "mine"


def test_missing_and_empty_run_directories_are_told_apart(tmp_path):
    with pytest.raises(StoreError, match="no such run directory"):
        read_results([tmp_path / "missing"])
    with pytest.raises(StoreError, match="no complete trial under"):
        read_results([tmp_path])


def test_json_holds_no_nan():
    with pytest.raises(ValueError, match="Out of range"):
        json_text({"x": float("nan")})
