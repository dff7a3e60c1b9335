"""The scheduler, with real processes: some of these tests start workers, which import torch."""

import json
import math
import os
import signal
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing

import pytest

from meshfit.errors import ClusterError, MeshError, StoreError, TrialError
from meshfit.experiment.plan import plan
from meshfit.experiment.running import backends, process_pool, trial_runner
from meshfit.experiment.running.backends import CancellationFile, LocalWorkers, Remote
from meshfit.experiment.running.process_pool import ProcessPool, environment
from meshfit.experiment.running.scheduler import run_trials
from meshfit.experiment.running.shared_progress import SharedProgress
from meshfit.experiment.running.worker import Job, RemoteOptions, run_job
from meshfit.experiment.storage.failure import failure_kind
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.trial_status import Progress, TrialStatus
from meshfit.fitting.callbacks import Step
from tests.dying import die_while_counting
from tests.inline import Inline
from tests.small import experiment

posix = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")


def test_shared_progress_is_read_as_it_was_written():
    progress = SharedProgress.of(3)
    progress[1] = Progress(TrialStatus.FITTING, Step(5, 20, 0.25))
    assert progress[0].status is TrialStatus.WAITING
    assert progress[1] == Progress(TrialStatus.FITTING, Step(5, 20, 0.25))
    progress[1] = Progress(TrialStatus.MEASURING, Step(20, 20, float("inf")))
    assert (progress[1].status, progress[1].step.done) == (TrialStatus.MEASURING, 20)
    assert math.isnan(progress[1].step.loss)
    progress.reset(1)
    assert (progress[1].status, progress[1].step.done) == (TrialStatus.WAITING, 0)
    assert not progress.cancelled
    progress.cancel()
    assert SharedProgress(progress.shared).cancelled


def test_the_environment_of_workers_is_put_back(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with environment({"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}):
        assert os.environ["OMP_NUM_THREADS"] == os.environ["MKL_NUM_THREADS"] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


@pytest.mark.slow
def test_results_do_not_depend_on_workers_or_companions_and_a_failing_trial_takes_none_with_it(tmp_path):
    good = experiment(tmp_path, schemes=["loop", "interp-loop"])
    anywhere = experiment(tmp_path, schemes=["loop", "interp-loop"], device="auto")
    bad = experiment(tmp_path, fit={"optimizer": {"lr": 1e30}})
    contents = []
    for name, experiments, where in (
        ("here", [good], {"remote": Remote(Inline())}),
        ("two", [bad, anywhere], {"jobs": 2}),
    ):
        store = RunDirectory(tmp_path / name)
        trials = plan(experiments)
        outcomes = run_trials(trials, store, **where)
        complete = [trial for i, trial in enumerate(trials) if outcomes[i].status is TrialStatus.COMPLETE]
        assert len(complete) == 2
        folders = [store.folder(trial) for trial in complete]
        contents.append([(folder / name).read_bytes() for folder in folders for name in ("result.ply", "trace.csv")])
        contents[-1] += [store.result(trial)["hausdorff"] for trial in complete]
        contents[-1] += [sorted(path.name for path in folder.iterdir()) for folder in folders]
    assert outcomes[0].status is TrialStatus.FAILED
    assert contents[0] == contents[1]


class Killer:
    """Kills the process of one trial, so many times, once it has made some steps."""

    def __init__(self, trial, store, times):
        self.folder, self.left, self.killed = store.folder(trial), times, set()

    def __call__(self, board, outcomes):
        pid = self.fitting()
        if not self.left or pid is None or pid in self.killed or board[0].step.done <= 5:
            return
        os.kill(pid, signal.SIGSTOP)
        if self.fitting() != pid:  # it has gone on to measure, or to another trial, before it stopped
            os.kill(pid, signal.SIGCONT)
            return
        self.killed.add(pid)
        self.left -= 1
        os.kill(pid, signal.SIGKILL)

    def fitting(self):
        """The process that fits the trial; None if none does."""
        try:
            progress = json.loads((self.folder / "progress.json").read_text())
        except (FileNotFoundError, NotADirectoryError):
            return None
        return progress["pid"] if progress["phase"] == "fitting" else None


def test_processes_are_kept_from_run_to_run_while_they_suffice():
    with closing(LocalWorkers()) as workers:
        pool = workers.pool(2, 3)
        pool.progress[1] = Progress(TrialStatus.FITTING)
        assert workers.pool(1, 2) is pool
        assert pool.progress[1].status is TrialStatus.WAITING
        assert workers.pool(3, 3) is not pool, "more workers"
        pool = workers.pool(3, 4)
        assert pool.progress.capacity == 4, "more trials"
        pool.progress.cancel()
        assert workers.pool(3, 4) is not pool, "its workers were asked to stop"


@posix
def test_a_trial_without_retries_is_recorded_when_its_process_is_killed(tmp_path):
    (trial,) = plan([experiment(tmp_path, fit={"steps": 100_000}, retries=0)])
    store = RunDirectory(tmp_path / "runs")
    outcomes = run_trials([trial], store, jobs=1, watch=Killer(trial, store, times=1))
    assert (outcomes[0].status, outcomes[0].kind) == (TrialStatus.FAILED, "killed")
    record = store.failure(trial)
    assert (record["kind"], record["attempts"], record["step"] > 5) == ("killed", 1, True)
    assert (store.folder(trial) / "trial.log").read_text().count("killed at step") == 1


@pytest.mark.slow
@posix
def test_a_trial_whose_process_is_killed_is_tried_again_and_then_recorded(tmp_path):
    trials = plan([experiment(tmp_path, fit={"steps": 100_000}), experiment(tmp_path, seeds=[0, 1, 2])])
    store = RunDirectory(tmp_path / "runs")
    killer = Killer(trials[0], store, times=2)
    outcomes = run_trials(trials, store, jobs=2, watch=killer)
    assert killer.left == 0
    assert (outcomes[0].status, outcomes[0].kind) == (TrialStatus.FAILED, "killed")
    record = store.failure(trials[0])
    assert (record["kind"], record["attempts"], record["log"]) == ("killed", 2, "trial.log")
    assert record["step"] > 5
    assert "killed twice" in record["message"]
    assert (store.folder(trials[0]) / "trial.log").read_text().count("killed at step") == 2
    assert all(outcomes[i].status is TrialStatus.COMPLETE for i in (1, 2, 3))


@posix
@pytest.mark.slow
def test_a_trial_that_is_killed_once_goes_on_from_its_checkpoint_and_disturbs_no_other(tmp_path):
    trials = plan([experiment(tmp_path, seeds=[0, 1], fit={"steps": 3000})])
    quiet, store = RunDirectory(tmp_path / "quiet"), RunDirectory(tmp_path / "runs")
    with closing(LocalWorkers()) as workers:
        run_trials(trials, quiet, jobs=2, local=workers)
        outcomes = run_trials(trials, store, jobs=2, local=workers, watch=Killer(trials[0], store, times=1))
    assert [outcome.status for outcome in outcomes.values()] == [TrialStatus.COMPLETE] * 2
    logs = [(store.folder(trial) / "trial.log").read_text() for trial in trials]
    assert [log.count("started on") for log in logs] == [2, 1]
    assert store.failure(trials[0]) is None
    for trial in trials:
        for name in ("result.ply", "trace.csv"):
            assert (store.folder(trial) / name).read_bytes() == (quiet.folder(trial) / name).read_bytes()


@posix
@pytest.mark.parametrize("deaths", [2, 9])
def test_workers_that_die_while_they_start_are_replaced_a_few_times(tmp_path, monkeypatch, deaths):
    left = tmp_path / "left"
    left.write_text(str(deaths))
    monkeypatch.setenv("DEATHS", str(left))
    monkeypatch.setattr(process_pool, "_count_gpus", die_while_counting)
    with closing(ProcessPool(1, SharedProgress.of(1))) as pool:
        if deaths > process_pool.MOST_DEATHS:
            with pytest.raises(TrialError, match=r"^worker processes are killed again and again; .*--jobs 1$"):
                pool.count_gpus()
        else:
            assert pool.count_gpus() == 0
    assert int(left.read_text()) == max(0, deaths - 1 - process_pool.MOST_DEATHS)


@pytest.mark.parametrize("main", ["unguarded.py", "<stdin>"])
def test_workers_start_without_the_main_module(tmp_path, monkeypatch, main):
    """A script without `if __name__ == "__main__"`, and one that is read from standard input, can run trials."""
    (tmp_path / "unguarded.py").write_text("raise SystemExit('the script is run again')")
    monkeypatch.setattr(sys.modules["__main__"], "__file__", str(tmp_path / main), raising=False)
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", None, raising=False)
    with closing(ProcessPool(1, SharedProgress.of(1))) as pool:
        assert pool.submit("cpu", os.getpid).result() != os.getpid()
    assert sys.modules["__main__"].__file__ == str(tmp_path / main)


def test_a_system_that_starts_no_process_gives_one_line(monkeypatch):
    def refused(*_, **__):
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(process_pool, "ProcessPoolExecutor", refused)
    with (
        closing(ProcessPool(1, SharedProgress.of(1))) as pool,
        pytest.raises(TrialError, match=r"^cannot start .*Resou"),
    ):
        pool.count_gpus()


@pytest.fixture(scope="module")
def run_here(tmp_path_factory):
    folder = tmp_path_factory.mktemp("here")
    trials, here = plan([experiment(folder, seeds=[0, 1])]), RunDirectory(folder / "here")
    run_trials(trials, here, remote=Remote(Inline(), transfer="shared"))
    return trials, here


class Waiting(Remote):
    """A remote whose workers wait after the first message until it is here."""

    def __init__(self, executor, arrived):
        super().__init__(executor, transfer="returned")
        self.arrived, self.steps = arrived, []

    def channel(self, receive):
        self.receive = receive
        return self

    def send(self, trial, files):
        self.steps.append(json.loads(files.get("progress.json", '{"step": null}'))["step"])
        self.receive(trial, files)
        if b"warning: " in files["trial.log"]:
            assert self.arrived.wait(60)


def test_workers_that_return_files_send_warnings_before_the_first_step(tmp_path):
    (trial,) = plan([experiment(tmp_path, source={"centre": [9.0, 0.0, 0.0]})])
    store, arrived, steps = RunDirectory(tmp_path / "runs"), threading.Event(), []
    log = store.folder(trial) / "trial.log"

    def watch(progress, outcomes):
        if not outcomes and log.is_file() and "do not overlap" in log.read_text():
            steps.append(progress[0].step.done)
            arrived.set()

    with ThreadPoolExecutor(1) as pool:
        remote = Waiting(pool, arrived)
        assert run_trials([trial], store, remote=remote, watch=watch)[0].status is TrialStatus.COMPLETE
    assert remote.steps[0] == steps[0] == 0
    assert not (store.folder(trial) / "progress.json").exists()


@pytest.mark.parametrize("transfer", ["auto", "shared", "returned"])
def test_any_executor_can_run_trials(tmp_path, run_here, transfer):
    trials, here = run_here
    there = RunDirectory(tmp_path / "there")
    with ThreadPoolExecutor(2) as pool:
        outcomes = run_trials(trials, there, remote=Remote(pool, transfer=transfer))
    assert [outcomes[i].status for i in (0, 1)] == [TrialStatus.COMPLETE] * 2
    for trial in trials:
        names = {path.name for path in here.folder(trial).iterdir()}
        assert {path.name for path in there.folder(trial).iterdir()} == names
        for name in names - {"result.json", "trial.log", "times.csv"}:
            assert (there.folder(trial) / name).read_bytes() == (here.folder(trial) / name).read_bytes()
        assert there.result(trial)["settings"] == here.result(trial)["settings"]
        assert there.result(trial)["hausdorff"] == here.result(trial)["hausdorff"]


class Dying(Inline):
    """An executor whose worker dies in some of the first calls."""

    def __init__(self, *deaths):
        self.deaths = list(deaths)

    def submit(self, fn, /, *args, **kwargs):
        if self.deaths and self.deaths.pop(0):
            raise BrokenProcessPool("a worker died")
        return super().submit(fn, *args, **kwargs)


def test_workers_elsewhere_that_die_are_asked_again_and_their_trials_recorded(tmp_path):
    (trial,) = plan([experiment(tmp_path)])
    store = RunDirectory(tmp_path / "runs")
    outcomes = run_trials([trial], store, remote=Remote(Dying(1, 0, 1)))
    assert (outcomes[0].kind, store.failure(trial)["kind"]) == ("killed", "killed")
    with pytest.raises(ClusterError, match=r"^workers cannot be reached: BrokenProcessPool: a worker died; run"):
        run_trials([trial], store, remote=Remote(Dying(*[1] * 9)))


def test_a_run_directory_that_is_moved_during_a_run_is_one_line(tmp_path):
    (trial,) = plan([experiment(tmp_path)])
    store = RunDirectory(tmp_path / "runs")
    with store.lock(trial):
        store.root.rename(tmp_path / "elsewhere")
        for write in (store.write, store.append):
            with pytest.raises(StoreError, match=r"moved or removed during the run; run the same command again$"):
                write(trial, "a", "text")


def test_half_written_files_of_earlier_attempts_are_removed(tmp_path):
    (trial,) = plan([experiment(tmp_path)])
    store = RunDirectory(tmp_path / "runs")
    store.folder(trial).mkdir(parents=True)
    half = store.folder(trial) / ".checkpoint.pt.a1b2c3d4"
    half.write_bytes(b"half")
    run_trials([trial], store, remote=Remote(Inline()))
    assert not half.exists()


@pytest.mark.parametrize(("retries", "complete"), [(0, False), (1, False), (2, True)])
def test_a_trial_that_runs_out_of_memory_is_tried_again_as_often_as_allowed(tmp_path, monkeypatch, retries, complete):
    real, calls = trial_runner.measure, []

    def measure(*arguments, **options):
        calls.append(1)
        if len(calls) < 3:
            raise RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 1 bytes")
        return real(*arguments, **options)

    monkeypatch.setattr(trial_runner, "measure", measure)
    (trial,) = plan([experiment(tmp_path, retries=retries)])
    store = RunDirectory(tmp_path / "runs")
    outcome = run_trials([trial], store, remote=Remote(Inline()))[0]
    assert outcome.status is (TrialStatus.COMPLETE if complete else TrialStatus.FAILED)
    assert len(calls) == min(retries + 1, 3)
    if not complete:
        assert outcome.kind == "out-of-memory"
        assert store.failure(trial)["attempts"] == retries + 1


def test_a_trial_that_diverges_is_not_tried_again(tmp_path):
    (trial,) = plan([experiment(tmp_path, fit={"optimizer": {"lr": 1e30}}, retries=5)])
    store = RunDirectory(tmp_path / "runs")
    assert run_trials([trial], store, remote=Remote(Inline()))[0].kind == "diverged"
    assert store.failure(trial)["attempts"] == 1


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (MemoryError(), "out-of-memory"),
        (RuntimeError("CUDA out of memory. Tried to allocate 2 GiB"), "out-of-memory"),
        (RuntimeError("shape mismatch"), "error"),
        (MeshError("no faces"), "input"),
        (KeyError("x"), "error"),
    ],
)
def test_failures_have_kinds(error, kind):
    assert failure_kind(error) == kind


def test_a_worker_of_another_version_is_refused(tmp_path):
    (trial,) = plan([experiment(tmp_path)])
    remote = RemoteOptions(CancellationFile(tmp_path / "stop"), version=-1)
    with pytest.raises(ClusterError, match="another version"):
        run_job(Job({0: trial}, RunDirectory(tmp_path), "cpu", 1, force=False, remote=remote))


def test_workers_that_have_to_see_the_run_directory_and_do_not_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(backends, "_sees", lambda *_: False)
    with pytest.raises(ClusterError, match="do not see"):
        Remote(Inline(), transfer="shared").shares(tmp_path)
    assert Remote(Inline()).shares(tmp_path) is False
    assert list(tmp_path.iterdir()) == []
