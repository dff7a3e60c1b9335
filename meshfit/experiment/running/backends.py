"""Backends that run trials: processes of this machine, or remote workers behind any executor."""

import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Literal, Protocol

from meshfit.errors import ClusterError, DeviceError
from meshfit.experiment.plan import Trial
from meshfit.experiment.running.commands import WORKER_VARIABLE, has_command, worker_allows_commands
from meshfit.experiment.running.device_assignment import Batch, assign_devices, workers_and_threads
from meshfit.experiment.running.process_pool import MOST_DEATHS, ProcessPool
from meshfit.experiment.running.shared_progress import SharedProgress
from meshfit.experiment.running.worker import (
    CancellationFlag,
    Channel,
    Files,
    Job,
    JobResult,
    RemoteOptions,
    pack_inputs,
    run_job,
)
from meshfit.experiment.storage.run_directory import PROGRESS, RunDirectory, make_folder, write_atomically
from meshfit.experiment.storage.targets import carry_for_remote, present_target
from meshfit.experiment.storage.trial_log import read_progress
from meshfit.experiment.trial_status import Outcome, Progress, TrialStatus

Transfer = Literal["auto", "shared", "returned"]
"""Transfer of files: workers write to a `shared` directory, or return files to the sender of the trial."""

_SECONDS_BETWEEN_READS = 2.0
_RUNNER = "meshfit.experiment.running.batch_runner"
"""The module that runs trials, and imports all that they need."""


class ProgressReader(Protocol):
    """Progress of trials, by number."""

    def __getitem__(self, trial: int) -> Progress:
        """The progress of a trial."""

    def reset(self, trial: int) -> None:
        """Set a trial back to waiting."""


class Backend(Protocol):
    """A set of workers that run batches of trials."""

    @property
    def progress(self) -> ProgressReader:
        """The progress of each trial."""

    @property
    def workers(self) -> int:
        """The number of trials that run side by side on the CPU."""

    @property
    def is_local(self) -> bool:
        """Whether workers share the memory of this machine, so that one that takes too much may get another killed."""

    def batches(self, trials: Mapping[int, Trial]) -> list[Batch]:
        """Divide trials into batches, each for a device."""

    def submit(self, trials: Mapping[int, Trial], device: str) -> Future[JobResult]:
        """Hand a batch to a worker."""

    def receive(self) -> None:
        """Take in what workers have sent of running trials."""

    def cancel(self) -> None:
        """Ask workers to write checkpoints and stop."""

    def close(self) -> None:
        """Wait for running batches to end."""


@dataclass(frozen=True)
class Options:
    """Options of all jobs of a run: rerun complete trials, and run external commands."""

    force: bool
    allow_commands: bool

    def job(
        self,
        trials: Mapping[int, Trial],
        store: RunDirectory,
        device: str,
        threads: int,
        remote: RemoteOptions | None = None,
    ) -> Job:
        """Return a job with these options."""
        return Job(trials, store, device, threads, self.force, remote, self.allow_commands)


class LocalWorkers:
    """Processes of this machine that one run after another uses, so that only the first has to start them."""

    def __init__(self) -> None:
        self._pool: ProcessPool | None = None

    def pool(self, workers: int, trials: int) -> ProcessPool:
        """Return a pool of at least some workers, with room for the progress of some trials, all of which wait."""
        pool = self._pool
        if pool is None or pool.progress.cancelled or pool.workers < workers or pool.progress.capacity < trials:
            self.close()
            pool = self._pool = ProcessPool(workers, SharedProgress.of(trials), preload=_RUNNER)
        pool.progress.clear()
        return pool

    def close(self) -> None:
        """Drop batches that have not started, wait for the others, and end the processes."""
        if self._pool is not None:
            self._pool.close(cancel=True)
            self._pool = None


class LocalBackend:
    """Processes of this machine: several on the CPU, one for each GPU.

    Args:
        trials: the trials of the run.
        pending: indices of those that are to be run.
        store: the run directory.
        jobs: the number of processes on the CPU; None takes it from the settings.
        options: options of the jobs.
        kept: processes that outlast the run; None ends them with it.
    """

    is_local = True

    def __init__(
        self,
        trials: Sequence[Trial],
        pending: Sequence[int],
        store: RunDirectory,
        jobs: int | None,
        options: "Options",
        kept: LocalWorkers | None = None,
    ) -> None:
        self._store, self._options, self._kept = store, options, kept
        self.workers, self._threads = workers_and_threads([trials[i] for i in pending], jobs)
        self._pool = (kept or LocalWorkers()).pool(self.workers, len(trials))
        self.progress = self._pool.progress

    def batches(self, trials: Mapping[int, Trial]) -> list[Batch]:
        """Divide trials into batches: single trials on the CPU."""
        may_use_gpu = any(trial.settings.device in ("auto", "cuda") for trial in trials.values())
        return assign_devices(trials, [f"cuda:{i}" for i in range(self._pool.count_gpus() if may_use_gpu else 0)])

    def submit(self, trials: Mapping[int, Trial], device: str) -> Future[JobResult]:
        """Hand a batch to a worker of its device."""
        return self._pool.submit(device, run_job, self._options.job(trials, self._store, device, self._threads))

    def receive(self) -> None:
        """Do nothing: the progress is in memory, and the logs are here."""

    def cancel(self) -> None:
        """Ask workers to write checkpoints and stop."""
        self.progress.cancel()

    def close(self) -> None:
        """Drop batches that have not started, and wait for the others; processes that outlast the run are idle then."""
        if self._kept is None or self.progress.cancelled:
            self._pool.close(cancel=True)


class Remote:
    """Workers elsewhere, reached through an executor.

    Attributes:
        executor: anything with the interface of `concurrent.futures.Executor`. If it runs two jobs in threads of one
            process, the second waits for the first.
        gpus: the number of trials that can each have a GPU at the same time.
        transfer: transfer of files; `auto` checks whether workers see the run directory.
        workers: the number of workers; 1 if it is not known.
    """

    workers = 1

    def __init__(self, executor: Executor, *, gpus: int = 0, transfer: Transfer = "auto") -> None:
        self.executor, self.gpus, self.transfer = executor, gpus, transfer

    def cancellation_flag(self, root: Path) -> CancellationFlag:
        """Return a new cancellation flag for trials in a run directory."""
        return CancellationFile(root / f".stop-{uuid.uuid4().hex}")

    def channel(self, receive: Callable[[int, Files], None]) -> Channel | None:  # noqa: ARG002  there is none
        """Return a channel for files of running trials; None if the executor has none.

        Args:
            receive: called with the number of a trial and its files, in any thread.
        """
        return None

    def on_workers(self, function: Callable[..., Any], *args: object) -> list[Any]:
        """Call a function on all workers, or on one if the executor cannot address all, and return the results."""
        return [self.executor.submit(function, *args).result()]

    def shares(self, root: Path) -> bool:
        """Whether workers see a run directory.

        Raises:
            StoreError: it cannot be written to.
            ClusterError: workers have to see it, but do not.
        """
        if self.transfer == "returned":
            return False
        make_folder(root)
        path = (root / f".token-{uuid.uuid4().hex}").resolve()
        write_atomically(path, path.name, lasting=False)
        try:
            seen = all(_answers(self, _sees, str(path), path.name))
        finally:
            path.unlink(missing_ok=True)
        if self.transfer == "shared" and not seen:
            raise ClusterError(f"workers do not see {root.resolve()}; use a directory that they share, or return files")
        return seen

    def close(self) -> None:
        """Release the connection; the executor belongs to its creator."""


def _answers(remote: Remote, function: Callable[..., Any], *args: object) -> list[Any]:
    """Call a function on all workers, again if one of them dies.

    Raises:
        ClusterError: they die again and again, or cannot be reached.
    """
    failure: Exception | None = None
    for _ in range(1 + MOST_DEATHS):
        try:
            return remote.on_workers(function, *args)
        except Exception as error:  # noqa: BLE001  libraries raise many kinds when a worker is lost
            failure = error
            if not (is_death(error) or isinstance(error, OSError)):
                break
    reason = f"{type(failure).__name__}: {failure}".partition("\n")[0]
    raise ClusterError(f"workers cannot be reached: {reason}; run the same command again") from failure


def _sees(path: str, content: str) -> bool:
    with suppress(OSError):
        return Path(path).read_text(encoding="utf-8") == content
    return False


@dataclass(frozen=True)
class CancellationFile:
    """A cancellation flag as a file in the run directory, for workers that share it."""

    path: Path

    def set(self) -> None:
        """Ask workers to stop."""
        write_atomically(self.path, "", lasting=False)

    def is_set(self) -> bool:
        """Whether workers are asked to stop."""
        return self.path.exists()

    def clear(self) -> None:
        """Remove the flag."""
        self.path.unlink(missing_ok=True)


class RemoteBackend:
    """Remote workers, which write to a directory that they share with this machine, or return files."""

    is_local = False

    def __init__(
        self,
        remote: Remote,
        trials: Sequence[Trial],
        store: RunDirectory,
        outcomes: Mapping[int, Outcome],
        options: "Options",
    ) -> None:
        self._remote, self._options = remote, options
        if any(has_command(trial) for i, trial in enumerate(trials) if i not in outcomes):
            _require_worker_permission(remote)
        self.progress, self.workers = FileProgress(trials, store, outcomes), remote.workers
        self._shared = remote.shares(store.root)
        self._store = RunDirectory(store.root.resolve()) if self._shared else store
        self._cancellation = remote.cancellation_flag(store.root.resolve())
        self._futures: list[Future[JobResult]] = []
        self._trials, self._outcomes, self._received = trials, outcomes, SimpleQueue[tuple[int, Files]]()
        self._channel = None if self._shared else remote.channel(lambda *sent: self._received.put(sent))

    def batches(self, trials: Mapping[int, Trial]) -> list[Batch]:
        """Divide trials into batches: single trials, except where there are GPUs for them.

        Raises:
            DeviceError: trials require a GPU, and no worker has one.
        """
        on_gpu = [trial for trial in trials.values() if trial.settings.device.startswith("cuda")]
        if on_gpu and not self._remote.gpus:
            raise DeviceError(
                f"{on_gpu[0].label} requires a GPU, but no worker has one; start workers with --resources 'GPU=1', "
                "or set device: cpu"
            )
        return assign_devices(trials, ["cuda"] * self._remote.gpus)

    def submit(self, trials: Mapping[int, Trial], device: str) -> Future[JobResult]:
        """Hand a batch to a worker, which has a resource called GPU if the batch requires one."""
        inputs = None
        if not self._shared:
            trials = {i: self._with_present_target(trial) for i, trial in trials.items()}
            inputs = {i: pack_inputs(trial, self._store) for i, trial in trials.items()}
        threads_set = [trial.settings.threads for trial in trials.values() if trial.settings.threads != "auto"]
        threads = min(threads_set, default=1)
        job = self._options.job(
            trials, self._store, device, threads, RemoteOptions(self._cancellation, inputs, self._channel)
        )
        self._futures.append(self._submitted(job))
        return self._futures[-1]

    def _submitted(self, job: Job) -> Future[JobResult]:
        """Submit a job; an executor whose workers have died refuses it, which counts as the death of its worker."""
        try:
            return self._remote.executor.submit(run_job, job)
        except Exception as error:
            if not is_death(error):
                raise
            refused: Future[JobResult] = Future()
            refused.set_exception(error)
            return refused

    def _with_present_target(self, trial: Trial) -> Trial:
        """Return a trial that reads the carried copy of its target if the file is missing."""
        carry_for_remote(trial, self._store)
        present = present_target(trial, self._store)
        if present == trial.current_path(trial.target):
            return trial
        others = [copy for copy in trial.copies if copy[0] != trial.target]
        return replace(trial, copies=(*others, (trial.target, present)))

    def receive(self) -> None:
        """Write the logs and the progress that workers have sent, of trials that have not ended."""
        while not self._received.empty():
            number, files = self._received.get()
            if number not in self._outcomes:
                make_folder(self._store.folder(self._trials[number]))
                for name, content in files.items():
                    self._store.write(self._trials[number], name, content, lasting=False)

    def cancel(self) -> None:
        """Ask workers to write checkpoints and stop, if they can be reached."""
        with suppress(OSError, RuntimeError, TimeoutError):
            self._cancellation.set()

    def close(self) -> None:
        """Wait for all batches; those that have not started see the flag and end."""
        # Futures are not cancelled: Dask would forget the files of a running trial.
        wait(self._futures)
        with suppress(OSError, RuntimeError, TimeoutError):
            self._cancellation.clear()


def _require_worker_permission(remote: Remote) -> None:
    if not all(_answers(remote, worker_allows_commands)):
        raise ClusterError(
            f"not every worker runs commands of configs; to allow them, start workers with {WORKER_VARIABLE}=1 set"
        )


class FileProgress:
    """Progress of each trial, read from the `progress.json` in its folder; a trial without one is waiting."""

    def __init__(self, trials: Sequence[Trial], store: RunDirectory, outcomes: Mapping[int, Outcome]) -> None:
        self._folders = [store.folder(trial) for trial in trials]
        self._outcomes = outcomes
        self._read: dict[int, Progress] = {}
        self._due = 0.0

    def __getitem__(self, trial: int) -> Progress:
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + _SECONDS_BETWEEN_READS
            unfinished = (i for i in range(len(self._folders)) if i not in self._outcomes)
            latest = {i: read_progress(self._folders[i]) for i in unfinished}
            self._read = {i: progress for i, progress in latest.items() if progress is not None}
        return self._read.get(trial, Progress(TrialStatus.WAITING))

    def reset(self, trial: int) -> None:
        """Set a trial back to waiting."""
        (self._folders[trial] / PROGRESS).unlink(missing_ok=True)
        self._read.pop(trial, None)


def is_death(error: BaseException) -> bool:
    """Whether an exception means that a worker of this package, of loky or of Dask died."""
    return isinstance(error, BrokenProcessPool) or type(error).__name__ in ("KilledWorker", "TerminatedWorkerError")
