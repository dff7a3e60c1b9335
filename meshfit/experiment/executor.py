"""Run many trials side by side in processes of their own, so that one that dies takes none of the others with it."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Any

from meshfit.errors import TrialError
from meshfit.experiment.board import Board
from meshfit.experiment.plan import Trial
from meshfit.experiment.progress import Outcome, Phase, Progress
from meshfit.experiment.store import FAILURE, RunDirectory, write_json
from meshfit.fitting.progress import Interrupted

_POLL_SECONDS = 0.1
_RUNNING = (Phase.FITTING, Phase.MEASURING)
_MOST_IDLE_DEATHS = 3

# A worker computes on one thread: two threads of two workers on two cores spin while they wait for each other.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

Watcher = Callable[[Board, Mapping[int, Outcome]], None]


@dataclass(frozen=True)
class Job:
    """What a worker is given: a trial, its place on the board, and where its files go."""

    index: int
    trial: Trial
    store: RunDirectory
    force: bool


def run_trials(
    trials: Sequence[Trial], store: RunDirectory, *, jobs: int, force: bool = False, watch: Watcher = lambda *_: None
) -> dict[int, Outcome]:
    """Run trials and wait for them.

    A trial whose process dies is run once more, alone, so that the guilt is certain; if it dies again, it has failed.

    Args:
        trials: what to run; those that are complete are left as they are.
        store: where their files go.
        jobs: how many processes.
        force: run complete ones too.
        watch: called many times a second with the board of progress and the outcomes so far.

    Returns:
        The outcome of each trial, by its place in `trials`.

    Raises:
        KeyboardInterrupt: after every running trial has written a checkpoint.
        StoreError: the run directory cannot be written to.
        TrialError: worker processes die without having started a trial.
    """
    board = Board.of(len(trials))
    work = {i: Job(i, trial, store, force) for i, trial in enumerate(trials)}
    outcomes: dict[int, Outcome] = {}
    if not force:
        outcomes |= {i: Outcome(Phase.COMPLETE) for i, trial in enumerate(trials) if store.result(trial) is not None}
    with _environment(_ONE_THREAD):
        idle_deaths = 0
        while len(outcomes) < len(work):
            before = len(outcomes)
            left = {i: job for i, job in work.items() if i not in outcomes}
            for i in _run_pool(left, board, outcomes, jobs, watch):
                board.reset(i)
                if _run_pool({i: work[i]}, board, outcomes, 1, watch):
                    outcomes[i] = _record_death(work[i], board)
            idle_deaths = 0 if len(outcomes) > before else idle_deaths + 1
            if idle_deaths > _MOST_IDLE_DEATHS:
                raise TrialError("worker processes die before they start a trial; perhaps there is not enough memory")
    return outcomes


def _run_pool(
    work: Mapping[int, Job], board: Board, outcomes: dict[int, Outcome], jobs: int, watch: Watcher
) -> list[int]:
    """Run jobs in a fresh pool until all are done or a worker dies; the trials that were running then are returned."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(
        min(jobs, len(work)), mp_context=context, initializer=_start_worker, initargs=(board.shared,)
    )
    try:
        with _interrupts_held():
            futures = {pool.submit(_work, job): i for i, job in work.items()}
        _collect(futures, board, outcomes, watch)
    except BrokenProcessPool:
        return [i for i in work if i not in outcomes and board.phase(i) in _RUNNING]
    except BaseException:
        board.stop()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return []


def _collect(
    futures: Mapping[Future[Outcome], int], board: Board, outcomes: dict[int, Outcome], watch: Watcher
) -> None:
    pending = set(futures)
    while pending:
        done, pending = wait(pending, timeout=_POLL_SECONDS, return_when=FIRST_COMPLETED)
        # Outcomes first, then the exception of a worker that died: what was finished beside it counts.
        for future in sorted(done, key=lambda future: future.exception() is not None):
            outcomes[futures[future]] = future.result()
        watch(board, outcomes)


def _record_death(job: Job, board: Board) -> Outcome:
    step = board.step(job.index)
    message = "the process that ran it was killed, twice; perhaps there was not enough memory"
    record: dict[str, Any] = {"kind": "killed", "message": message, "step": step.done, "identity": job.trial.identity}
    job.store.write(job.trial, FAILURE, write_json(record))
    board.post(job.index, Progress(Phase.FAILED))
    return Outcome(Phase.FAILED, f"killed: {message}")


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back while processes start: they inherit that, and leave it to the parent from the first instant."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # it lets go of the signal whenever it starts, so it starts before
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


_board: Board | None = None


def _start_worker(shared: Any) -> None:  # noqa: ANN401  a ctypes array, which has no public type
    """Leave Ctrl-C to the parent, which asks for checkpoints; and do not outlive it."""
    global _board  # noqa: PLW0603  the one thing that a worker is given once and keeps
    _board = Board(shared)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(job: Job) -> Outcome:
    board = _board
    if board is None:
        raise RuntimeError("the worker was not started by _start_worker")

    def on_progress(progress: Progress) -> None:
        board.post(job.index, progress)
        if board.stopped and progress.phase is not Phase.MEASURING:
            raise Interrupted

    if board.stopped:
        return Outcome(Phase.INTERRUPTED)
    from meshfit.experiment.trial import run_trial

    on_progress(Progress(Phase.FITTING))
    outcome = run_trial(job.trial, job.store, on_progress, force=job.force)
    board.post(job.index, Progress(outcome.phase))
    return outcome
