"""Batch runner: run a batch of trials in one process; complete ones are skipped, failures are recorded."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial

from filelock import FileLock, Timeout

from meshfit.config.experiment import ExperimentSettings
from meshfit.errors import StoreError
from meshfit.experiment.plan import Trial
from meshfit.experiment.running.trial_runner import TrialRunner, recorded_warnings
from meshfit.experiment.storage.run_directory import CHECKPOINT, RESULT, RunDirectory
from meshfit.experiment.trial_status import Outcome, Progress, TrialStatus
from meshfit.fitting.batch import fit_batch
from meshfit.fitting.callbacks import Interrupted
from meshfit.fitting.loop import FitResult
from meshfit.fitting.problem import Diverged, Problem

_LOCK_SECONDS = 0.5


def run_batch(
    trials: Sequence[Trial],
    store: RunDirectory,
    on_progress: Callable[[int, Progress], None],
    *,
    device: str | None = None,
    threads: int = 1,
    force: bool = False,
    allow_commands: bool = False,
) -> list[Outcome]:
    """Run the trials of a batch that are not complete, from their last checkpoints if there are any.

    A lock on each folder keeps two processes from running a trial at once; the second waits, and finds it complete.

    Args:
        trials: trials of the same fit settings, device and dtype.
        store: the run directory.
        on_progress: called at every step with the index of a trial; if it raises `Interrupted`, checkpoints are
            written.
        device: the device in place of that of the settings.
        threads: as in `fit`.
        force: rerun complete trials, and ignore checkpoints.
        allow_commands: run the external commands of trials.

    Returns:
        The outcome of each trial; a failure is recorded in the folder and returned, not raised.

    Raises:
        StoreError: the run directory cannot be written to.
    """
    runners = [TrialRunner(trial, store, partial(on_progress, index)) for index, trial in enumerate(trials)]
    try:
        with ExitStack() as locks:
            # All processes take locks in the same order; otherwise two could wait for each other forever.
            for runner in sorted(runners, key=lambda runner: runner.trial.folder):
                locks.enter_context(_locked(store.lock(runner.trial), runner.on_progress))
                store.clear(runner.trial)
                if force:
                    store.remove(runner.trial, RESULT, CHECKPOINT)
                elif store.is_complete(runner.trial):
                    runner.outcome = Outcome(TrialStatus.COMPLETE)
            fit = partial(_fit, device=device, threads=threads, allow_commands=allow_commands)
            _run_locked([runner for runner in runners if runner.outcome is None], fit)
    except Interrupted:
        pass
    return [runner.outcome or Outcome(TrialStatus.INTERRUPTED) for runner in runners]


@contextmanager
def _locked(lock: FileLock, on_progress: Callable[[Progress], None]) -> Iterator[None]:
    while not lock.is_locked:
        try:
            lock.acquire(timeout=_LOCK_SECONDS)
        except Timeout:
            on_progress(Progress(TrialStatus.WAITING))
    try:
        yield
    finally:
        lock.release()


def _fit(
    problems: Sequence[Problem], settings: ExperimentSettings, *, device: str | None, threads: int, allow_commands: bool
) -> list[FitResult | Diverged]:
    return fit_batch(
        list(problems),
        settings.fit,
        device=device or settings.device,
        dtype=settings.dtype,
        threads=threads,
        allow_commands=allow_commands,
    )


_Fit = Callable[[Sequence[Problem], ExperimentSettings], list[FitResult | Diverged]]


def _run_locked(runners: Sequence[TrialRunner], fit: _Fit) -> None:
    """Run trials whose locks are held; interrupted ones close their logs while they still are."""
    try:
        for runner in runners:
            runner.start()
        _run(runners, fit)
    except Interrupted:
        for runner in runners:
            if runner.outcome is None:
                runner.stop()
        raise


def _run(runners: Sequence[TrialRunner], fit: _Fit) -> None:
    clock, problems = _Clock(), dict[TrialRunner, Problem]()
    for runner in runners:
        with _failures_recorded(runner):
            problems[runner] = runner.prepare(clock)
    if not problems:
        return
    settings = runners[0].trial.settings
    clock.start(len(problems))
    try:
        with recorded_warnings() as texts:
            outcomes = fit(list(problems.values()), settings)
    except (Interrupted, StoreError):
        raise
    except Exception as error:  # noqa: BLE001  any error, of any trial of the batch
        _run_singly(list(problems), error, fit)
        return
    clock.stop()
    for runner, outcome in zip(problems, outcomes, strict=True):
        with _failures_recorded(runner):
            for text in texts:
                runner.warn(text)
            if isinstance(outcome, Diverged):
                raise outcome
            runner.finish(outcome)


def _run_singly(runners: Sequence[TrialRunner], error: Exception, fit: _Fit) -> None:
    """Rerun each trial of a failed batch by itself, so that those that did not cause the failure succeed."""
    if len(runners) == 1:
        runners[0].fail(error)
        return
    for runner in runners:
        _run([runner], fit)


@contextmanager
def _failures_recorded(runner: TrialRunner) -> Iterator[None]:
    try:
        yield
    except (Interrupted, StoreError):
        raise
    except Exception as error:  # noqa: BLE001  any error of a trial is recorded, and the others go on
        runner.fail(error)


class _Clock:
    """Seconds of a fit: those of the batch, divided by its size."""

    def start(self, size: int) -> None:
        """Start the clock."""
        self._start, self._end, self._size = time.perf_counter(), math.inf, size

    def stop(self) -> None:
        """Stop the clock; what follows is not part of the fit."""
        self._end = time.perf_counter()

    def __call__(self) -> float:
        return (min(time.perf_counter(), self._end) - self._start) / self._size
