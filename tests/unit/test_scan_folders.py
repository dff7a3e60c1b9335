import json
import os
import stat
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest
from filelock import FileLock

from meshfit.errors import StoreError
from meshfit.experiment.status.scan import scan, status_of, trial_folder
from meshfit.experiment.storage.result import read_results
from meshfit.experiment.storage.trial_log import this_host
from meshfit.experiment.trial_status import TrialStatus
from tests.runs import NOW, begun, complete, failed, held, result_of, write_progress


def state(folder):
    return status_of(trial_folder(folder), NOW)


def test_a_trial_is_complete_failed_interrupted_or_waiting_by_its_files(tmp_path):
    assert state(complete(tmp_path, seed=0)) is TrialStatus.COMPLETE
    assert state(failed(tmp_path, seed=1)) is TrialStatus.FAILED
    assert state(begun(tmp_path, seed=2)) is TrialStatus.INTERRUPTED
    assert state(tmp_path / "small/bunny/loop/seed-3-0123456789") is TrialStatus.WAITING


def test_a_result_counts_for_more_than_a_failure_before_it(tmp_path):
    folder = failed(tmp_path)
    (folder / "result.json").write_text(json.dumps(result_of()))
    assert state(folder) is TrialStatus.COMPLETE


def test_a_trial_whose_result_is_damaged_is_damaged_unless_it_runs_again(tmp_path):
    folder = complete(tmp_path)
    result = (folder / "result.json").read_bytes()
    for content in (b"", result[:-9], b"{}", b"[]", result.replace(b'"bunny"', b"7"), b"\xff" + result):
        (folder / "result.json").write_bytes(content)
        assert state(folder) is TrialStatus.DAMAGED
    with held(folder):
        assert state(folder) is TrialStatus.RUNNING
    (folder / "result.json").write_bytes(result)
    assert state(folder) is TrialStatus.COMPLETE


def test_a_trial_runs_while_another_process_holds_its_lock_and_no_longer(tmp_path):
    once_failed, anew, done = failed(tmp_path, seed=0), begun(tmp_path, seed=1), complete(tmp_path, seed=2)
    with held(once_failed, anew, done) as process:
        assert [state(folder) for folder in (once_failed, anew, done)] == [
            TrialStatus.RUNNING,
            TrialStatus.RUNNING,
            TrialStatus.COMPLETE,
        ]
        process.kill()
        process.wait()
        assert [state(folder) for folder in (once_failed, anew)] == [TrialStatus.FAILED, TrialStatus.INTERRUPTED]


def test_a_lock_is_let_go_at_once_and_none_is_made(tmp_path):
    folder = begun(tmp_path)
    state(folder)
    with FileLock(folder / ".lock").acquire(timeout=0):
        pass
    (folder / ".lock").unlink()
    assert state(folder) is TrialStatus.INTERRUPTED
    assert not (folder / ".lock").exists()


def test_a_folder_that_is_removed_during_a_scan_is_left_out(tmp_path, monkeypatch):
    removed, kept = failed(tmp_path, seed=0), complete(tmp_path, seed=1)
    scandir = os.scandir

    def scandir_without_removed(path):
        if Path(path) == removed:
            raise FileNotFoundError(path)
        return scandir(path)

    monkeypatch.setattr("os.scandir", scandir_without_removed)
    assert [folder.path for folder in scan(tmp_path).trials] == [kept]
    assert [Path(result["folder"]) for result in read_results([tmp_path])] == [kept]


def test_a_stale_sign_of_life_does_not_make_a_trial_run(tmp_path):
    folder = begun(tmp_path)
    write_progress(folder, silent=1, host=this_host())
    assert state(folder) is TrialStatus.INTERRUPTED
    write_progress(folder, silent=61, host="node7")
    assert state(folder) is TrialStatus.INTERRUPTED


def test_a_fresh_sign_of_life_from_another_machine_counts_for_it_may_not_share_locks(tmp_path):
    folder = begun(tmp_path)
    write_progress(folder, silent=59, host="node7")
    assert state(folder) is TrialStatus.RUNNING


@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied"), OSError(30, "Read-only file system")])
def test_where_locks_cannot_be_tried_the_last_sign_of_life_counts(tmp_path, monkeypatch, error):
    def refused(*_, **__):
        raise error

    monkeypatch.setattr(FileLock, "acquire", refused)
    folder = begun(tmp_path)
    assert state(folder) is TrialStatus.INTERRUPTED
    write_progress(folder, silent=59, host=this_host())
    assert state(folder) is TrialStatus.RUNNING
    write_progress(folder, silent=61, host=this_host())
    assert state(folder) is TrialStatus.INTERRUPTED


@contextmanager
def unprivileged(folder):
    """A folder that may be read and not written, by someone who is not root, whom permissions do not bind."""
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)
        for path in (folder, *folder.rglob("*")):
            path.chmod(path.stat().st_mode | stat.S_IWUSR)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="needs POSIX permissions")
def test_a_directory_that_cannot_be_written_is_looked_through_all_the_same():
    with tempfile.TemporaryDirectory() as name:
        runs = Path(name)
        runs.chmod(0o755)
        running, silent = begun(runs, seed=0), begun(runs, seed=1)
        write_progress(running, silent=10, host=this_host())
        write_progress(silent, silent=100, host=this_host())
        with unprivileged(runs):
            assert [state(trial.path) for trial in scan(runs).trials] == [TrialStatus.RUNNING, TrialStatus.INTERRUPTED]


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"phase": "fitting", "step": null}'])
def test_a_damaged_sign_of_life_is_none(tmp_path, content):
    folder = begun(tmp_path)
    (folder / "progress.json").write_text(content)
    assert state(folder) is TrialStatus.INTERRUPTED


def test_folders_are_found_from_any_level_in_the_order_of_seeds(tmp_path):
    folders = [complete(tmp_path, seed=seed) for seed in (10, 2)]
    for root in (tmp_path, tmp_path / "small", tmp_path / "small/bunny", tmp_path / "small/bunny/loop"):
        assert [trial.path for trial in scan(root).trials] == folders[::-1]
    assert [trial.path for trial in scan(folders[0]).trials] == folders[:1]


def test_links_inside_a_run_directory_are_not_followed_one_to_it_is(tmp_path):
    folder = complete(tmp_path / "elsewhere")
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs/small").symlink_to(tmp_path / "elsewhere/small")
    assert scan(tmp_path / "runs").trials == ()
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    assert [trial.path.name for trial in scan(tmp_path / "link").trials] == [folder.name]


def test_a_folder_that_was_renamed_is_still_a_trial_if_it_has_ended(tmp_path):
    renamed = complete(tmp_path).rename(tmp_path / "small/bunny/loop/best")
    (trial,) = scan(tmp_path).trials
    assert (trial.path, trial.seed, trial.is_named) == (renamed, None, False)


def test_what_is_no_directory_is_refused(tmp_path):
    with pytest.raises(StoreError, match="gone: no such run directory; `meshfit run` makes one"):
        scan(tmp_path / "gone")
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="file: not a directory"):
        scan(tmp_path / "file")
