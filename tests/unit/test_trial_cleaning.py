import json
import os

import pytest
from filelock import FileLock

from meshfit.errors import StoreError
from meshfit.experiment.status.cleaning import clean
from meshfit.experiment.status.scan import scan_experiments
from meshfit.experiment.storage.run_directory import is_half_written, write_atomically
from meshfit.experiment.trial_status import TrialStatus
from tests.runs import NOW, begun, complete, failed, held, result_of, write_plan

FAILED, PARTIAL, BOTH = [TrialStatus.FAILED], [TrialStatus.INTERRUPTED], [TrialStatus.FAILED, TrialStatus.INTERRUPTED]


def cleaned(states, *roots, dry_run=False):
    return clean(scan_experiments(roots, NOW), states, roots, dry_run=dry_run)


def contents(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize(("states", "gone"), [(FAILED, "failed"), (PARTIAL, "interrupted"), (BOTH, "both")])
def test_folders_go_by_their_state_and_the_rest_stays_as_it_is(tmp_path, states, gone):
    folders = {"complete": complete(tmp_path, seed=0), "failed": failed(tmp_path, seed=1)}
    folders["interrupted"] = begun(tmp_path, seed=2)
    write_plan(tmp_path / "small", [{"seed": seed} for seed in range(4)])
    kept = {path: text for path, text in contents(tmp_path).items() if not _is_in(path, folders, gone)}
    cleaned(states, tmp_path)
    assert contents(tmp_path) == kept
    assert {name for name, folder in folders.items() if not folder.exists()} == (
        {"failed", "interrupted"} if gone == "both" else {gone}
    )


def _is_in(path, folders, gone):
    names = ("failed", "interrupted") if gone == "both" else (gone,)
    return any(path.is_relative_to(folders[name]) for name in names)


def test_what_went_is_counted_in_trials_and_bytes(tmp_path):
    folder = begun(tmp_path)
    (folder / "more").mkdir()
    (folder / "more/file").write_bytes(b"x" * 1000)
    size = sum(len(data) for data in contents(folder).values())
    (found,) = cleaned(PARTIAL, tmp_path).removed
    assert (found.trial.path, found.size, found.names) == (folder, size, ())


def test_a_dry_run_says_the_same_and_removes_nothing(tmp_path):
    failed(tmp_path, seed=1)
    begun(tmp_path, seed=2)
    (complete(tmp_path, seed=0) / ".result.json.abcd1234").write_text("half")
    before = contents(tmp_path)
    dry = cleaned(BOTH, tmp_path, dry_run=True)
    assert contents(tmp_path) == before
    wet = cleaned(BOTH, tmp_path)
    assert [(r.trial.path, r.names, r.size) for r in dry.removed] == [
        (r.trial.path, r.names, r.size) for r in wet.removed
    ]
    assert len(wet.removed) == 3


def test_a_running_trial_is_left_and_told(tmp_path):
    running, stopped = begun(tmp_path, seed=1), begun(tmp_path, seed=2)
    with held(running):
        before = contents(running)
        found = cleaned(PARTIAL, tmp_path)
        assert contents(running) == before
    assert [trial.path for trial in found.running] == [running]
    assert [removed.trial.path for removed in found.removed] == [stopped]


def test_a_trial_that_began_since_it_was_looked_at_is_left(tmp_path):
    begun(tmp_path, seed=1)
    folder = begun(tmp_path, seed=2)
    seen = scan_experiments([tmp_path], NOW)
    with held(folder):
        found = clean(seen, PARTIAL, [tmp_path])
        assert folder.exists()
    assert [trial.path for trial in found.running] == [folder]


def test_a_trial_that_ended_since_it_was_looked_at_is_left(tmp_path):
    folder = begun(tmp_path)
    seen = scan_experiments([tmp_path], NOW)
    (folder / "result.json").write_text(json.dumps(result_of()))
    assert clean(seen, BOTH, [tmp_path]).removed == ()
    assert (folder / "result.json").exists()


def test_folders_that_become_empty_go_up_to_the_run_directory(tmp_path):
    runs = tmp_path / "runs"
    failed(runs, target="cow")
    complete(runs, target="bunny")
    failed(runs, experiment="all-failed")
    failed(runs, experiment="with-notes")
    (runs / "with-notes/notes.txt").write_text("mine")
    cleaned(FAILED, runs)
    assert sorted(path.name for path in runs.iterdir()) == ["small", "with-notes"]
    assert [path.name for path in (runs / "small").iterdir()] == ["bunny"]
    assert [path.name for path in (runs / "with-notes").iterdir()] == ["notes.txt"]


def test_the_folder_that_was_asked_for_stays(tmp_path):
    folder = failed(tmp_path / "runs")
    cleaned(FAILED, folder.parent)
    assert list(folder.parent.iterdir()) == []
    failed(tmp_path / "runs")
    cleaned(FAILED, folder)
    assert not folder.exists()
    assert folder.parent.exists()


def test_half_written_files_go_from_complete_trials_with_the_interrupted_ones(tmp_path, monkeypatch):
    folder = complete(tmp_path)
    before = contents(folder)
    monkeypatch.setattr(os, "fsync", _killed)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(folder / "result.ply", "half")
    (half,) = set(contents(folder)) - set(before)
    assert cleaned(FAILED, tmp_path).removed == ()
    (found,) = cleaned(PARTIAL, tmp_path).removed
    assert (found.names, found.size) == ((half.name,), 4)
    assert contents(folder) == before


def _killed(_descriptor):
    raise KeyboardInterrupt


@pytest.mark.parametrize("name", [".lock", ".hidden", "result.json", ".result.json.ABCD1234", ".gitignore", ".a.b"])
def test_other_files_are_not_taken_for_half_written_ones(name):
    assert not is_half_written(name)


def test_half_written_files_of_a_trial_whose_lock_is_held_stay(tmp_path):
    folder = complete(tmp_path)
    (folder / ".trace.csv.abcd1234").write_text("being written")
    with held(folder):
        found = cleaned(PARTIAL, tmp_path)
    assert (folder / ".trace.csv.abcd1234").exists()
    assert (found.removed, [trial.path for trial in found.running]) == ((), [folder])


def test_nothing_is_removed_through_a_link(tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "precious").write_text("mine")
    other = failed(tmp_path / "other", target="cow")
    folder = failed(tmp_path / "runs")
    (folder / "link").symlink_to(outside)
    (folder / "file").symlink_to(outside / "precious")
    (tmp_path / "runs/small/cow").symlink_to(other.parents[1])
    (folder.parent / "seed-5-0123456789").symlink_to(other)
    write_plan(tmp_path / "runs/small", [{"target": "cow"}, {"target": "bunny"}])
    cleaned(BOTH, tmp_path / "runs")
    assert not folder.exists()
    assert (outside / "precious").read_text() == "mine"
    assert (other / "failure.json").exists()


def test_a_lock_that_is_a_link_is_not_followed(tmp_path):
    folder = failed(tmp_path)
    (tmp_path / "mine").write_text("mine")
    (folder / ".lock").unlink()
    (folder / ".lock").symlink_to(tmp_path / "mine")
    with pytest.raises(StoreError, match="cannot be removed"):
        cleaned(FAILED, tmp_path)
    assert (folder / "failure.json").exists()


def test_a_folder_of_another_name_is_never_removed(tmp_path):
    renamed = failed(tmp_path).rename(tmp_path / "small/bunny/loop/why-did-this-fail")
    assert cleaned(BOTH, tmp_path).removed == ()
    assert renamed.exists()


def test_the_lock_is_held_while_files_go_and_gone_after(tmp_path, monkeypatch):
    folder = begun(tmp_path)
    seen = []

    unlinked = type(folder).unlink

    def unlink(path, **options):
        if path.name == "source.ply":
            with pytest.raises(TimeoutError):
                FileLock(folder / ".lock").acquire(timeout=0)
            seen.append(path)
        unlinked(path, **options)

    monkeypatch.setattr(type(folder), "unlink", unlink)
    cleaned(PARTIAL, tmp_path)
    assert len(seen) == 1
    assert not folder.exists()


def test_what_cannot_be_removed_is_one_clear_line(tmp_path, monkeypatch):
    folder = begun(tmp_path)

    def refused(path, **_):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(type(folder), "unlink", refused)
    with pytest.raises(StoreError, match=r"checkpoint\.pt: cannot be removed: Permission denied"):
        cleaned(PARTIAL, tmp_path)
