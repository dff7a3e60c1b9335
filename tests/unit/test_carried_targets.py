"""Carried targets: written once, read in place of the original file, and found wherever the run directory is."""

import json
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.experiment.plan import plan
from meshfit.experiment.running.backends import Remote
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.running.scheduler import run_trials
from meshfit.experiment.status.cleaning import clean
from meshfit.experiment.status.scan import scan_experiments
from meshfit.experiment.storage.copies import copies_in
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.storage.targets import carry, find_carried, read_target
from meshfit.experiment.trial_status import TrialStatus
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron
from meshfit.mesh.targets import file_sha256, load_target
from meshfit.subdivision.refine import subdivide
from tests.inline import Inline
from tests.small import ellipsoid, experiment
from tests.unit.test_trial_runner import prepared, run_trial

pytestmark = pytest.mark.usefixtures("without_shape_checks")


def ball_record(folder, sha256="a" * 64, **settings):
    """The record of a trial on a file of its own, and the folder of that trial."""
    path = folder / "ball.ply"
    save_mesh(subdivide(octahedron(), "loop", 1), path)
    trial = folder / "runs" / "experiment" / "ball" / "loop" / "seed-0-0123456789"
    trial.mkdir(parents=True)
    return trial, {"inputs": {"target": sha256}, "settings": {"targets": [str(path)], **settings}}


def test_each_target_is_carried_once_to_the_bit(tmp_path):
    rng = np.random.default_rng(0)
    ball = subdivide(octahedron(), "loop", 2)
    save_mesh(Mesh(ball.verts + 1e-9 * rng.random(ball.verts.shape), ball.faces), tmp_path / "odd.ply")
    targets = [str(tmp_path / "odd.ply"), str(ellipsoid(tmp_path))]
    trials = plan([experiment(tmp_path, targets=targets, seeds=[0, 1], fit={"steps": 2})])
    store = RunDirectory(tmp_path / "runs")
    run_batch(trials, store, lambda *_: None)
    carried = sorted(path.name for path in (tmp_path / "runs/targets").iterdir() if path.suffix)
    assert carried == sorted({f"{dict(trial.inputs)['target']}.ply" for trial in trials})
    for trial in trials:
        original = load_target(trial.target)
        shutil.move(trial.target, f"{trial.target}.moved")
        found = read_target(store.folder(trial), store.result(trial))
        shutil.move(f"{trial.target}.moved", trial.target)
        np.testing.assert_array_equal(found.verts, original.verts)
        np.testing.assert_array_equal(found.faces, original.faces)


def test_a_target_with_other_cleaning_is_another_file(tmp_path):
    names = set()
    for changes in ({}, {"repair": "refuse"}, {"weld": 1e-6}, {"weld": 1e-6, "repair": "refuse"}):
        trial, store, folder = prepared(tmp_path, fit={"steps": 1}, **changes)
        run_trial(trial, store, lambda _: None)
        names.add(find_carried(folder, store.result(trial)).name)
    assert len(names) == 4


def test_the_carried_target_is_shown_where_the_original_has_changed_or_is_gone(tmp_path):
    trial, record = ball_record(tmp_path)
    path = trial.parents[3] / "targets" / f"{'a' * 64}.ply"
    carried = Mesh(2.0 * octahedron().verts, octahedron().faces)
    carry(path, lambda: carried)
    np.testing.assert_array_equal(read_target(trial, record).verts, carried.verts)
    (tmp_path / "ball.ply").unlink()
    moved = tmp_path / "elsewhere"
    shutil.move(tmp_path / "runs", moved)
    trial = moved / trial.relative_to(tmp_path / "runs")
    np.testing.assert_array_equal(read_target(trial, record).verts, carried.verts)
    (tmp_path / "link").symlink_to(trial.parents[1])
    np.testing.assert_array_equal(read_target(tmp_path / "link/loop" / trial.name, record).verts, carried.verts)


def test_without_a_copy_the_original_is_read_if_it_is_the_same_file(tmp_path):
    trial, record = ball_record(tmp_path)
    with pytest.raises(MeshError, match=r"it has changed since; and the run directory has no copy.*'targets'"):
        read_target(trial, record)
    record["inputs"]["target"] = file_sha256(tmp_path / "ball.ply")
    assert read_target(trial, record).num_verts == load_mesh(tmp_path / "ball.ply").num_verts
    assert read_target(trial, {"settings": record["settings"]}).num_verts == 18
    (tmp_path / "ball.ply").unlink()
    with pytest.raises(MeshError, match=r"no such file.*copy its folder 'targets' too"):
        read_target(trial, record)


@pytest.mark.parametrize("damage", [b"", b"ply\n", "cut", "indices"])
def test_a_damaged_copy_is_passed_over_or_named(tmp_path, damage):
    trial, record = ball_record(tmp_path)
    path = trial.parents[3] / "targets" / f"{'a' * 64}.ply"
    carry(path, octahedron)
    content = path.read_bytes()
    if damage == "cut":
        damage = content[:-5]
    elif damage == "indices":
        damage = content[:-4] + b"\xff\x00\x00\x00"
    path.write_bytes(damage)
    with pytest.raises(MeshError, match=path.name):
        read_target(trial, record)
    record["inputs"].pop("target")
    assert read_target(trial, record).num_verts == 18


def test_what_a_killed_process_left_is_removed_by_the_next(tmp_path):
    path = tmp_path / "targets" / "hash.ply"
    path.parent.mkdir()
    (path.parent / ".hash.ply.abcdefgh").write_bytes(b"half")
    (path.parent / ".other.ply.abcdefgh").write_bytes(b"being written")
    carry(path, octahedron)
    names = {file.name for file in path.parent.iterdir()} - {".lock"}
    assert names == {"hash.ply", ".other.ply.abcdefgh"}
    before = path.stat().st_mtime_ns
    carry(path, lambda: pytest.fail("it exists"))
    assert path.stat().st_mtime_ns == before


def test_those_that_no_complete_trial_uses_are_removed_with_failed_trials(tmp_path):
    trial, store, folder = prepared(tmp_path, fit={"optimizer": {"lr": 1e30}})
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.FAILED
    experiments = scan_experiments([store.root], datetime.now(UTC))
    assert [found.name for found in experiments] == ["small"]
    (carried,) = (store.root / "targets").glob("*.ply")
    size = carried.stat().st_size
    assert clean(experiments, [TrialStatus.FAILED], [store.root], dry_run=True).targets == {carried: size}
    assert carried.is_file()
    assert clean(experiments, [TrialStatus.FAILED], [store.root]).targets == {carried: size}
    assert not folder.exists()
    assert not (store.root / "targets").exists()


def test_those_of_complete_trials_stay_and_so_do_all_while_one_is_hidden_or_running(tmp_path):
    trial, store, folder = prepared(tmp_path, fit={"steps": 1})
    run_trial(trial, store, lambda _: None)
    (carried,) = (store.root / "targets").glob("*.ply")
    unused = carried.with_name(f"{'f' * 64}.ply")
    unused.write_text("of no trial")
    more = folder.with_name("seed-9-0123456789")

    def cleaned():
        scanned = scan_experiments([store.root], datetime.now(UTC))
        return list(clean(scanned, [TrialStatus.INTERRUPTED], [store.root / "small"]).targets)

    more.mkdir()
    (more / "result.json").write_text("{")
    assert cleaned() == []
    (more / "result.json").unlink()
    with FileLock(more / ".lock"):
        assert cleaned() == []
    (store.root / "link").symlink_to(tmp_path)
    assert cleaned() == []
    (store.root / "link").unlink()
    assert cleaned() == [unused]
    assert [path.name for path in carried.parent.glob("*.ply")] == [carried.name]


def test_a_worker_with_a_directory_of_its_own_does_not_carry(tmp_path):
    trial, store, _ = prepared(tmp_path, fit={"steps": 1})
    run_trial(trial, replace(store, carries_targets=False), lambda _: None)
    assert not (store.root / "targets").exists()
    assert find_carried(store.folder(trial), store.result(trial)) is None


def test_workers_that_return_files_leave_a_copy_too(tmp_path):
    trial, store, folder = prepared(tmp_path, fit={"steps": 1})
    original = load_target(trial.target)
    run_trials([trial], store, remote=Remote(Inline(), transfer="returned"))
    (tmp_path / "ellipsoid.ply").unlink()
    np.testing.assert_array_equal(read_target(folder, store.result(trial)).verts, original.verts)


def test_the_options_of_cleaning_in_a_record_are_those_of_the_trial(tmp_path):
    trial, store, folder = prepared(tmp_path, fit={"steps": 1}, weld=1e-6)
    run_trial(trial, store, lambda _: None)
    record = json.loads((folder / "result.json").read_text())
    assert CleaningOptions.of(record["settings"]) == trial.settings.cleaning


def outcomes(store, trials, **options):
    return [outcome.status for outcome in run_trials(trials, store, remote=Remote(Inline(), **options)).values()]


@pytest.mark.parametrize("transfer", ["shared", "returned"])
def test_copies_stand_in_for_targets_whose_files_are_missing(tmp_path, transfer):
    """Complete trials stay, and others give the bytes that they give with the files."""
    changes = {"seeds": [0, 1], "fit": {"steps": 2}}
    config, store, other = experiment(tmp_path, **changes), *(RunDirectory(tmp_path / name) for name in ("a", "b"))
    first, second = trials = plan([config])
    assert outcomes(other, trials, transfer="shared") == [TrialStatus.COMPLETE] * 2
    run_trials([first], store, remote=Remote(Inline(), transfer="shared"))
    kept = (store.folder(first) / "result.json").read_bytes()
    Path(first.target).unlink()
    with pytest.raises(MeshError, match="no such file"):
        plan([config])
    for damaged in (False, True):  # its results name the target, too
        if damaged:
            (store.root / "small/plan.json").unlink()
        with pytest.warns(MeshfitWarning, match=r"ellipsoid\.ply: no such file; its copy in the run directory is used"):
            found = plan([config], copy_of=copies_in(store.root))
        assert [(trial.folder, trial.settings) for trial in found] == [(each.folder, each.settings) for each in trials]
    planned = trials if transfer == "returned" else found  # the file may be removed after the plan, too
    assert outcomes(store, planned, transfer=transfer) == [TrialStatus.COMPLETE] * 2
    assert "the copy of a missing file" in (store.folder(second) / "trial.log").read_text() or planned is trials
    assert (store.folder(first) / "result.json").read_bytes() == kept
    for name in ("result.ply", "source.ply", "trace.csv"):
        assert (store.folder(second) / name).read_bytes() == (other.folder(second) / name).read_bytes()
    assert store.result(second)["hausdorff"] == other.result(second)["hausdorff"]
    shutil.rmtree(store.root / "targets")
    with pytest.raises(MeshError, match="no such file"):
        plan([config], copy_of=copies_in(store.root))


def test_another_content_of_a_file_is_seen_by_the_next_plan(tmp_path):
    config = experiment(tmp_path, source={"mesh": str(ellipsoid(tmp_path, "source.ply"))})
    before = plan([config])[0]
    for name, role in (("ellipsoid.ply", "target"), ("source.ply", "source")):
        save_mesh(subdivide(octahedron(), "loop", 1), tmp_path / name)
        after = plan([config])[0]
        assert dict(after.inputs)[role] == file_sha256(tmp_path / name) != dict(before.inputs)[role]
