"""A real Dask cluster on loopback: a scheduler and two workers, one of which is killed during a trial."""

import json
import os
import signal
from contextlib import closing, suppress

import pytest

from meshfit.config.loading import load_experiment
from meshfit.experiment.plan import plan
from meshfit.experiment.running.dask_backend import DaskRemote
from meshfit.experiment.running.scheduler import run_trials
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.storage.targets import read_written_mesh
from meshfit.experiment.trial_status import TrialStatus
from meshfit.mesh.io.files import load_mesh
from tests.cli.dask_cluster import running_cluster
from tests.cli.processes import contents, meshfit, start, wait_until
from tests.small import CONFIG, config_file

pytest.importorskip("distributed", reason="needs the extra dask")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals"),
]

LONG = CONFIG.replace("steps: 20", "steps: 1500")
NAMES = ("result.ply", "trace.csv", "source.ply", "config.yaml")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with running_cluster(tmp_path_factory.mktemp("cluster")) as (file, _):
        yield file


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    out, _ = meshfit("run", config_file(folder, LONG), "-q", folder=folder)
    return contents(folder / "runs", *NAMES), out


def same(found, undisturbed):
    # Where a mesh file lies is written into the copy of the config, and into nothing else.
    return {path: content for path, content in found.items() if "config" not in path} == {
        path: content for path, content in undisturbed.items() if "config" not in path
    }


def running(folder):
    found = []
    for path in folder.rglob("progress.json"):
        with suppress(FileNotFoundError):
            found.append(json.loads(path.read_text()))
    return found


@pytest.mark.parametrize("transfer", ["shared", "returned"])
def test_trials_sent_to_a_cluster_leave_what_they_leave_here(tmp_path, cluster, undisturbed, transfer):
    config = config_file(tmp_path, LONG)
    out, err = meshfit("run", config, "--cluster", cluster, "--transfer", transfer, folder=tmp_path)
    assert err.count(": complete") == 4
    found = contents(tmp_path / "runs", *NAMES)
    assert found.keys() == undisturbed[0].keys()
    assert same(found, undisturbed[0])
    assert out == undisturbed[1]
    (carried,) = (tmp_path / "runs/targets").glob("*.ply")
    assert read_written_mesh(carried).num_verts == load_mesh(tmp_path / "ellipsoid.ply").num_verts
    left = {path.name for path in (tmp_path / "runs/small").rglob("*") if path.is_file()}
    assert left == {*NAMES, "times.csv", "result.json", "trial.log", "plan.json", ".lock"}


def test_the_trial_of_a_worker_that_is_killed_goes_on_elsewhere_from_its_checkpoint(tmp_path, cluster, undisturbed):
    config = config_file(tmp_path, LONG)
    process = start("run", config, "--cluster", cluster, folder=tmp_path)
    wait_until(lambda: any(trial["step"] > 100 for trial in running(tmp_path / "runs")), process)
    os.kill(next(trial["pid"] for trial in running(tmp_path / "runs") if trial["step"] > 100), signal.SIGKILL)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (0, undisturbed[1]), err
    assert same(contents(tmp_path / "runs", *NAMES), undisturbed[0])
    logs = [path.read_text() for path in (tmp_path / "runs").rglob("trial.log")]
    assert sum(log.count("started on") for log in logs) == 5


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs POSIX signals")
@pytest.mark.parametrize("transfer", ["shared", "returned"])
def test_the_trial_of_a_worker_that_is_stopped_goes_on_elsewhere_whatever_the_scheduler_is_set_to(
    tmp_path, undisturbed, transfer
):
    trials, store, stopped = plan([load_experiment(config_file(tmp_path, LONG))]), RunDirectory(tmp_path / "runs"), []

    def stop(_, outcomes):
        begun = [trial["pid"] for trial in running(tmp_path) if trial["step"] > 100]
        if begun and not stopped and not outcomes:
            stopped.append(begun[0])
            os.kill(begun[0], signal.SIGSTOP)

    with (
        running_cluster(tmp_path) as (file, _),
        closing(DaskRemote(str(file), transfer=transfer, silent_after=8)) as remote,
    ):
        outcomes = run_trials(trials, store, remote=remote, watch=stop)
    assert len(stopped) == 1
    assert [outcomes[i].status for i in range(4)] == [TrialStatus.COMPLETE] * 4
    assert same(contents(tmp_path / "runs", *NAMES), undisturbed[0])


@pytest.mark.parametrize("transfer", ["shared", "returned"])
def test_ctrl_c_brings_checkpoints_back_and_the_next_run_goes_on_from_them(tmp_path, cluster, undisturbed, transfer):
    config = config_file(tmp_path, LONG)
    process = start("run", config, "--cluster", cluster, "--transfer", transfer, folder=tmp_path)
    where = tmp_path if transfer == "shared" else cluster.parent  # workers' own directories are there
    wait_until(lambda: any(trial["step"] > 100 for trial in running(where)), process)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "interrupted" in err
    assert "Traceback" not in err
    stopped = sorted((tmp_path / "runs").rglob("checkpoint.pt"))
    assert stopped
    meshfit("run", config, "-q", folder=tmp_path)
    assert all("resuming from a checkpoint" in (path.parent / "trial.log").read_text() for path in stopped)
    assert same(contents(tmp_path / "runs", *NAMES), undisturbed[0])


def test_a_scheduler_that_is_lost_is_one_line_and_the_next_run_goes_on(tmp_path, undisturbed):
    config = config_file(tmp_path, LONG)
    with running_cluster(tmp_path) as (file, processes):
        process = start("run", config, "--cluster", file, folder=tmp_path)
        wait_until(lambda: any(trial["step"] > 100 for trial in running(tmp_path / "runs")), process)
        os.killpg(processes[0].pid, signal.SIGKILL)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 2, err
    assert "Traceback" not in err
    assert "lost the connection to the workers; run the same command again to resume" in err
    meshfit("run", config, "-q", folder=tmp_path)
    assert same(contents(tmp_path / "runs", *NAMES), undisturbed[0])


def test_a_gpu_that_no_worker_has_is_missed_at_once(tmp_path, cluster):
    config = config_file(tmp_path, CONFIG.replace("device: cpu", "device: cuda"))
    _, err = meshfit("run", config, "--cluster", cluster, folder=tmp_path, code=2)
    assert "requires a GPU, but no worker has one" in err


def test_a_scheduler_that_is_not_there_is_one_line(tmp_path, monkeypatch):
    _, err = meshfit("run", config_file(tmp_path), "--cluster", "tcp://127.0.0.1:9", folder=tmp_path, code=2)
    (line,) = err.strip().splitlines()
    assert "tcp://127.0.0.1:9: no Dask scheduler can be reached there" in line
