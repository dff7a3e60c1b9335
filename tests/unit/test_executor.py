"""The executor, with real processes: some of these tests start workers, which import torch."""

import multiprocessing
import os
import signal

import pytest

from meshfit.experiment.board import Board
from meshfit.experiment.executor import run_trials
from meshfit.experiment.interrupts import environment
from meshfit.experiment.plan import plan
from meshfit.experiment.progress import Phase, Progress
from meshfit.experiment.store import RunDirectory
from meshfit.fitting.progress import Step
from tests.small import experiment


def test_the_board_tells_what_was_posted():
    board = Board.of(3)
    board.post(1, Progress(Phase.FITTING, Step(5, 20, 0.25)))
    assert board.phase(0) is Phase.WAITING
    assert (board.phase(1), board.step(1)) == (Phase.FITTING, Step(5, 20, 0.25))
    board.post(1, Progress(Phase.MEASURING))
    assert (board.phase(1), board.step(1).done) == (Phase.MEASURING, 5)
    board.reset(1)
    assert (board.phase(1), board.step(1).done) == (Phase.WAITING, 0)
    assert not board.stopped
    board.stop()
    assert Board(board.shared).stopped


def test_the_environment_of_workers_is_put_back(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with environment({"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}):
        assert os.environ["OMP_NUM_THREADS"] == os.environ["MKL_NUM_THREADS"] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_results_do_not_depend_on_workers_or_companions_and_a_failing_trial_takes_none_with_it(tmp_path):
    good = experiment(tmp_path, schemes=["loop", "interp-loop"])
    anywhere = experiment(tmp_path, schemes=["loop", "interp-loop"], device="auto")
    bad = experiment(tmp_path, fit={"optimizer": {"lr": 1e30}})
    contents = []
    for jobs, experiments in ((1, [good]), (2, [bad, anywhere])):
        store = RunDirectory(tmp_path / str(jobs))
        trials = plan(experiments)
        outcomes = run_trials(trials, store, jobs=jobs)
        complete = [trial for i, trial in enumerate(trials) if outcomes[i].phase is Phase.COMPLETE]
        assert len(complete) == 2
        folders = [store.folder(trial) for trial in complete]
        contents.append([(folder / name).read_bytes() for folder in folders for name in ("result.ply", "trace.csv")])
        contents[-1] += [store.result(trial)["hausdorff"] for trial in complete]
    assert outcomes[0].phase is Phase.FAILED
    assert contents[0] == contents[1]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_trial_whose_process_is_killed_is_run_again_and_then_recorded(tmp_path):
    trials = plan([experiment(tmp_path, fit={"steps": 100_000}), experiment(tmp_path)])
    store = RunDirectory(tmp_path / "runs")

    def kill_the_long_one(board, _outcomes):
        if board.phase(0) is Phase.FITTING and board.step(0).done > 5:
            for child in multiprocessing.active_children():
                os.kill(child.pid, signal.SIGKILL)

    outcomes = run_trials(trials, store, jobs=2, watch=kill_the_long_one)
    assert outcomes[0].phase is Phase.FAILED
    assert store.failure(trials[0])["kind"] == "killed"
    assert outcomes[1].phase is Phase.COMPLETE
    assert store.result(trials[1]) is not None
