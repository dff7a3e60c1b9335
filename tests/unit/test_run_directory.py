import json
import math
import os
from pathlib import Path

import pytest

from meshfit.errors import MeshfitWarning, StoreError
from meshfit.experiment.storage.result import read_results
from meshfit.experiment.storage.run_directory import json_text, make_folder, write_atomically
from tests.loops import over
from tests.runs import result_of


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
        ({"distance": {"mean": -0.5}}, "distance.mean is -0.5, which is impossible"),
        ({"seed": ["long"] * 10**5}, 'not the result of a trial: seed is ["long", '),
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


def test_missing_and_empty_run_directories_are_told_apart(tmp_path):
    with pytest.raises(StoreError, match="no such run directory"):
        read_results([tmp_path / "missing"])
    with pytest.raises(StoreError, match="no complete trial under"):
        read_results([tmp_path])


def test_json_holds_no_nan():
    with pytest.raises(ValueError, match="Out of range"):
        json_text({"x": float("nan")})
