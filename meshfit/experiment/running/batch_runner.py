"""Run trials in one process, alone or as one batch: what is complete is left, what fails is recorded."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial

from filelock import FileLock, Timeout

from meshfit.errors import StoreError
from meshfit.experiment.plan import Trial
from meshfit.experiment.running.trial_runner import Attempt
from meshfit.experiment.storage.run_directory import CHECKPOINT, RESULT, RunDirectory
from meshfit.experiment.trial_status import Outcome, Phase, Progress
from meshfit.fitting.callbacks import Interrupted
from meshfit.fitting.fit import fit_batch
from meshfit.fitting.problem import Diverged, Problem

_LOCK_SECONDS = 0.5


def run_together(
    trials: Sequence[Trial],
    store: RunDirectory,
    on_progress: Callable[[int, Progress], None],
    *,
    device: str | None = None,
    threads: int = 1,
    force: bool = False,
) -> list[Outcome]:
    """Run those of some trials that are not complete yet, from their last checkpoints if there are such.

    A lock on each folder keeps two processes from running a trial at once; the second waits, and finds it complete.

    Args:
        trials: what to run; of the same settings of fit, device and dtype.
        store: where their files go.
        on_progress: called at every step with the place of a trial; it may raise `Interrupted`, upon which checkpoints
            are written.
        device: in place of the one in the settings.
        threads: as `fit` takes it.
        force: run them anew, whatever is there.

    Returns:
        The outcome of each; a failure is recorded in the folder and returned, not raised.

    Raises:
        StoreError: the run directory cannot be written to.
    """
    attempts = [Attempt(trial, store, partial(on_progress, place)) for place, trial in enumerate(trials)]
    try:
        with ExitStack() as locks:
            # In the same order everywhere: two processes that wait for each other would wait for ever.
            for attempt in sorted(attempts, key=lambda attempt: attempt.trial.folder):
                locks.enter_context(_held(store.lock(attempt.trial), attempt.on_progress))
                if force:
                    store.remove(attempt.trial, RESULT, CHECKPOINT)
                elif store.is_complete(attempt.trial):
                    attempt.outcome = Outcome(Phase.COMPLETE)
            _run_unless_stopped([attempt for attempt in attempts if attempt.outcome is None], device, threads)
    except Interrupted:
        pass
    return [attempt.outcome or Outcome(Phase.INTERRUPTED) for attempt in attempts]


@contextmanager
def _held(lock: FileLock, on_progress: Callable[[Progress], None]) -> Iterator[None]:
    while not lock.is_locked:
        try:
            lock.acquire(timeout=_LOCK_SECONDS)
        except Timeout:
            on_progress(Progress(Phase.WAITING))
    try:
        yield
    finally:
        lock.release()


class _Clock:
    """The seconds of a fit: those of the batch, shared out among its members."""

    def start(self, members: int) -> None:
        """Begin to count."""
        self._start, self._end, self._members = time.perf_counter(), math.inf, members

    def stop(self) -> None:
        """Count no further: what follows is no part of the fit."""
        self._end = time.perf_counter()

    def __call__(self) -> float:
        return (min(time.perf_counter(), self._end) - self._start) / self._members


def _run_unless_stopped(attempts: Sequence[Attempt], device: str | None, threads: int) -> None:
    """Run trials whose locks are held; what is stopped says so while they still are."""
    try:
        for attempt in attempts:
            attempt.start()
        _run(attempts, device, threads)
    except Interrupted:
        for attempt in attempts:
            if attempt.outcome is None:
                attempt.stop()
        raise


def _run(attempts: Sequence[Attempt], device: str | None, threads: int) -> None:
    clock, problems = _Clock(), dict[Attempt, Problem]()
    for attempt in attempts:
        with _failures_recorded(attempt):
            problems[attempt] = attempt.prepare(clock)
    if not problems:
        return
    settings = attempts[0].trial.settings
    clock.start(len(problems))
    try:
        outcomes = fit_batch(
            list(problems.values()),
            settings.fit,
            device=device or settings.device,
            dtype=settings.dtype,
            threads=threads,
        )
    except (Interrupted, StoreError):
        raise
    except Exception as error:  # noqa: BLE001  whatever it is, it concerns one of them
        _settle(list(problems), error, device, threads)
        return
    clock.stop()
    for attempt, outcome in zip(problems, outcomes, strict=True):
        with _failures_recorded(attempt):
            if isinstance(outcome, Diverged):
                raise outcome
            attempt.finish(outcome)


def _settle(attempts: Sequence[Attempt], error: Exception, device: str | None, threads: int) -> None:
    """A batch that failed as a whole is run again one by one, so that the others get through."""
    if len(attempts) == 1:
        attempts[0].fail(error)
        return
    for attempt in attempts:
        _run([attempt], device, threads)


@contextmanager
def _failures_recorded(attempt: Attempt) -> Iterator[None]:
    try:
        yield
    except (Interrupted, StoreError):
        raise
    except Exception as error:  # noqa: BLE001  whatever a trial raises, the others go on
        attempt.fail(error)
