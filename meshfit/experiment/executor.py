"""Run many trials side by side in processes of their own, so that one that dies takes none of the others with it."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from typing import Any

from meshfit.errors import TrialError
from meshfit.experiment.board import Board
from meshfit.experiment.placement import place, workers_and_threads
from meshfit.experiment.plan import Trial
from meshfit.experiment.pools import Pools
from meshfit.experiment.progress import Outcome, Phase, Progress
from meshfit.experiment.store import FAILURE, Result, RunDirectory, write_json
from meshfit.fitting.progress import Interrupted

_POLL_SECONDS = 0.1
_RUNNING = (Phase.FITTING, Phase.MEASURING)
_MOST_IDLE_DEATHS = 3
_MAY_BE_GPU = ("auto", "cuda")

# Threads of numerical libraries spin while they wait for each other, and two workers' on two cores spin for long.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "IGL_NUM_THREADS"), "1")

Watcher = Callable[[Board, Mapping[int, Outcome]], None]


@dataclass(frozen=True)
class Job:
    """What a worker is given: trials to fit together, their places on the board, and where their files go."""

    trials: Mapping[int, Trial]
    store: RunDirectory
    device: str
    threads: int
    force: bool


def run_trials(
    trials: Sequence[Trial],
    store: RunDirectory,
    *,
    jobs: int | None = None,
    force: bool = False,
    watch: Watcher = lambda *_: None,
) -> dict[int, Outcome]:
    """Run trials and wait for them: side by side on the CPU, in batches on other devices.

    A trial whose process dies is run once more, alone, so that the guilt is certain; if it dies again, it has failed.

    Args:
        trials: what to run; those that are complete are left as they are.
        store: where their files go.
        jobs: how many processes on the CPU; None leaves it to the trials' settings.
        force: run complete ones too.
        watch: called many times a second with the board of progress and the outcomes so far.

    Returns:
        The outcome of each trial, by its place in `trials`.

    Raises:
        KeyboardInterrupt: after every running trial has written a checkpoint.
        StoreError: the run directory cannot be written to.
        TrialError: worker processes die without having started a trial.
    """
    session = _Session(trials, store, force, Board.of(len(trials)), watch)
    if not force:
        complete = (i for i, trial in enumerate(trials) if store.result(trial) is not None)
        session.outcomes |= dict.fromkeys(complete, Outcome(Phase.COMPLETE))
    with _environment(_ONE_THREAD):
        idle_deaths = 0
        while left := [i for i in range(len(trials)) if i not in session.outcomes]:
            workers, threads = workers_and_threads([trials[i] for i in left], jobs)
            for i in session.run(left, workers, threads):
                session.board.reset(i)
                if session.run([i], 1, threads):
                    session.record_death(i)
            idle_deaths = idle_deaths + 1 if all(i not in session.outcomes for i in left) else 0
            if idle_deaths > _MOST_IDLE_DEATHS:
                raise TrialError("worker processes die before they start a trial; perhaps there is not enough memory")
    return session.outcomes


@dataclass
class _Session:
    """Trials that are being run, and how those ended that have."""

    trials: Sequence[Trial]
    store: RunDirectory
    force: bool
    board: Board
    watch: Watcher
    outcomes: dict[int, Outcome] = field(default_factory=dict)

    def run(self, numbers: Sequence[int], workers: int, threads: int) -> list[int]:
        """Run trials in fresh processes until all are done or one dies; those that were running then are returned."""
        pools = Pools(workers, _start_worker, self.board.shared)
        trials = {i: self.trials[i] for i in numbers}
        try:
            gpus = _gpus(pools) if any(trial.settings.device in _MAY_BE_GPU for trial in trials.values()) else 0
            with _interrupts_held():
                futures = [
                    pools.submit(
                        device, _work, Job({i: trials[i] for i in batch}, self.store, device, threads, self.force)
                    )
                    for device, batch in place(trials, gpus)
                ]
            self._collect(futures)
        except BrokenProcessPool:
            return [i for i in numbers if i not in self.outcomes and self.board.phase(i) in _RUNNING]
        except BaseException:
            self.board.stop()
            raise
        finally:
            pools.shutdown()
        return []

    def record_death(self, i: int) -> None:
        """Record that a trial's process died when it was alone, too."""
        message = "the process that ran it was killed, twice; perhaps there was not enough memory"
        trial, step = self.trials[i], self.board.step(i).done
        record: Result = {"kind": "killed", "message": message, "step": step, "identity": trial.identity}
        self.store.write(trial, FAILURE, write_json(record))
        self.board.post(i, Progress(Phase.FAILED))
        self.outcomes[i] = Outcome(Phase.FAILED, f"killed: {message}")

    def _collect(self, futures: Sequence[Future[dict[int, Outcome]]]) -> None:
        pending = set(futures)
        while pending:
            done, pending = wait(pending, timeout=_POLL_SECONDS, return_when=FIRST_COMPLETED)
            # Outcomes first, then the exception of a worker that died: what was finished beside it counts.
            for future in sorted(done, key=lambda future: future.exception() is not None):
                self.outcomes |= future.result()
            self.watch(self.board, self.outcomes)


def _gpus(pools: Pools) -> int:
    with _interrupts_held():
        counted = pools.count_gpus()
    return counted.result()


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


def _work(job: Job) -> dict[int, Outcome]:
    board, numbers = _board, list(job.trials)
    if board is None:
        raise RuntimeError("the worker was not started by _start_worker")

    def on_progress(at: int, progress: Progress) -> None:
        board.post(numbers[at], progress)
        if board.stopped and progress.phase is not Phase.MEASURING:
            raise Interrupted

    if board.stopped:
        return dict.fromkeys(numbers, Outcome(Phase.INTERRUPTED))
    from meshfit.experiment.trial import run_together

    for at in range(len(numbers)):
        on_progress(at, Progress(Phase.FITTING))
    trials = list(job.trials.values())
    found = run_together(trials, job.store, on_progress, device=job.device, threads=job.threads, force=job.force)
    for number, outcome in zip(numbers, found, strict=True):
        board.post(number, Progress(outcome.phase))
    return dict(zip(numbers, found, strict=True))
