"""The executor, with real processes: some of these tests start workers, which import torch."""

import os
import signal

import pytest

from meshfit.experiment import executor
from meshfit.experiment.board import Board
from meshfit.experiment.executor import run_trials
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
    with executor._environment({"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}):
        assert os.environ["OMP_NUM_THREADS"] == os.environ["MKL_NUM_THREADS"] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_results_do_not_depend_on_the_number_of_workers(tmp_path):
    trials = plan([experiment(tmp_path, schemes=["loop", "interp-loop"])])
    contents = []
    for jobs in (1, 2):
        store = RunDirectory(tmp_path / str(jobs))
        outcomes = run_trials(trials, store, jobs=jobs)
        assert {outcome.phase for outcome in outcomes.values()} == {Phase.COMPLETE}
        folders = [store.folder(trial) for trial in trials]
        contents.append([(folder / name).read_bytes() for folder in folders for name in ("result.ply", "trace.csv")])
        contents[-1] += [store.result(trial)["hausdorff"] for trial in trials]
    assert contents[0] == contents[1]


def test_a_trial_that_fails_takes_none_with_it(tmp_path):
    good = experiment(tmp_path)
    bad = experiment(tmp_path, fit={"optimizer": {"lr": 1e30}})
    trials = plan([bad, good])
    outcomes = run_trials(trials, RunDirectory(tmp_path / "runs"), jobs=2)
    assert [outcomes[i].phase for i in (0, 1)] == [Phase.FAILED, Phase.COMPLETE]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_trial_whose_process_is_killed_is_run_again_and_then_recorded(tmp_path):
    trials = plan([experiment(tmp_path, fit={"steps": 100_000}), experiment(tmp_path)])
    store = RunDirectory(tmp_path / "runs")

    def kill_the_long_one(board, _outcomes):
        if board.phase(0) is Phase.FITTING and board.step(0).done > 5:
            for child in executor.multiprocessing.active_children():
                os.kill(child.pid, signal.SIGKILL)

    outcomes = run_trials(trials, store, jobs=2, watch=kill_the_long_one)
    assert outcomes[0].phase is Phase.FAILED
    assert store.failure(trials[0])["kind"] == "killed"
    assert outcomes[1].phase is Phase.COMPLETE
    assert store.result(trials[1]) is not None
