"""Workers that are no children of this process: any executor, with what has to be known of it besides."""

import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from meshfit.errors import ClusterError, DeviceError
from meshfit.experiment.plan import Trial
from meshfit.experiment.running.device_assignment import Batch, place, workers_and_threads
from meshfit.experiment.running.process_pool import LocalExecutor
from meshfit.experiment.running.progress import Board, FileBoard
from meshfit.experiment.running.worker import Done, Errand, Job, parcel_for, work
from meshfit.experiment.storage.run_directory import RunDirectory, make_folder, write_atomically
from meshfit.experiment.trial_status import Phase
from meshfit.fitting.callbacks import Step

Transfer = Literal["auto", "shared", "returned"]
"""How files travel: workers write to a `shared` directory, or they are `returned` to the one who sent the trial."""


class StopSign(Protocol):
    """What workers look at to see whether they should write checkpoints and stop; it travels with each job."""

    def set(self) -> None:
        """Ask them to."""

    def is_set(self) -> bool:
        """Whether they are asked to."""

    def clear(self) -> None:
        """Take the sign away."""


@dataclass(frozen=True)
class FileStopSign:
    """A stop sign that stands as a file in the run directory: seen by those who share it."""

    path: Path

    def set(self) -> None:
        """Ask workers to stop."""
        write_atomically(self.path, "", lasting=False)

    def is_set(self) -> bool:
        """Whether they are asked to."""
        return self.path.exists()

    def clear(self) -> None:
        """Take the sign away."""
        self.path.unlink(missing_ok=True)


class Remote:
    """Workers elsewhere.

    Attributes:
        executor: takes calls; anything with the interface of `concurrent.futures.Executor`. Of two jobs in threads of
            one process the second waits for the first.
        gpus: how many trials can have a GPU of their own at a time.
        transfer: how files travel; `auto` looks whether workers see the run directory.
        workers: how many there are, as far as is known.
    """

    workers = 1

    def __init__(self, executor: Executor, *, gpus: int = 0, transfer: Transfer = "auto") -> None:
        self.executor, self.gpus, self.transfer = executor, gpus, transfer

    def stop_sign(self, root: Path) -> StopSign:
        """A new stop sign for trials under a run directory."""
        return FileStopSign(root / f".stop-{uuid.uuid4().hex}")

    def on_workers(self, function: Callable[..., Any], *args: object) -> list[Any]:
        """What some workers return for a call: all of them if that can be had, else one."""
        return [self.executor.submit(function, *args).result()]

    def shares(self, root: Path) -> bool:
        """Whether workers see this run directory.

        Raises:
            StoreError: it cannot be written to.
            ClusterError: workers have to see it, and do not.
        """
        if self.transfer == "returned":
            return False
        make_folder(root)
        path = (root / f".token-{uuid.uuid4().hex}").resolve()
        write_atomically(path, path.name, lasting=False)
        try:
            seen = all(self.on_workers(_sees, str(path), path.name))
        finally:
            path.unlink(missing_ok=True)
        if self.transfer == "shared" and not seen:
            raise ClusterError(f"workers do not see {root.resolve()}; name a directory they share, or return files")
        return seen

    def close(self) -> None:
        """Let go of the executor, which belongs to whoever made it."""


def _sees(path: str, content: str) -> bool:
    with suppress(OSError):
        return Path(path).read_text(encoding="utf-8") == content
    return False


class ProgressBoard(Protocol):
    """Where each trial is, by its number, for whoever shows it."""

    def phase(self, trial: int) -> Phase:
        """Where a trial is."""

    def step(self, trial: int) -> Step:
        """The steps of a trial so far."""

    def reset(self, trial: int) -> None:
        """Put a trial back to where it waits."""


class Crew(Protocol):
    """Those who run trials."""

    @property
    def board(self) -> ProgressBoard:
        """Where each trial is."""

    @property
    def workers(self) -> int:
        """How many trials run side by side on the CPU."""

    @property
    def on_this_machine(self) -> bool:
        """Whether its workers share the memory of this machine, and their deaths may be due to each other."""

    def batches(self, trials: Mapping[int, Trial]) -> list[Batch]:
        """Divide trials into batches, each for a device."""

    def submit(self, trials: Mapping[int, Trial], device: str) -> Future[Done]:
        """Hand a batch to a worker."""

    def stop(self) -> None:
        """Ask workers to write checkpoints and stop."""

    def close(self) -> None:
        """Wait for what runs."""


class LocalCrew:
    """Processes of this machine: side by side on the CPU, one for each GPU."""

    on_this_machine = True

    def __init__(self, store: RunDirectory, board: Board, workers: int, threads: int, *, force: bool) -> None:
        self._store, self._threads, self._force = store, threads, force
        self.board, self.workers = board, workers
        self._executor = LocalExecutor(workers, board)

    @classmethod
    def of(
        cls, trials: Sequence[Trial], left: Sequence[int], store: RunDirectory, jobs: int | None, *, force: bool
    ) -> "LocalCrew":
        """As many as the trials that are left keep busy."""
        workers, threads = workers_and_threads([trials[i] for i in left], jobs)
        return cls(store, Board.of(len(trials)), workers, threads, force=force)

    def batches(self, trials: Mapping[int, Trial]) -> list[Batch]:
        """Divide trials into batches: on the CPU each is by itself."""
        may_be_gpu = any(trial.settings.device in ("auto", "cuda") for trial in trials.values())
        return place(trials, [f"cuda:{i}" for i in range(self._executor.count_gpus() if may_be_gpu else 0)])

    def submit(self, trials: Mapping[int, Trial], device: str) -> Future[Done]:
        """Hand a batch to a worker of its device."""
        return self._executor.submit(work, Job(trials, self._store, device, self._threads, self._force))

    def stop(self) -> None:
        """Ask workers to write checkpoints and stop."""
        self.board.stop()

    def close(self) -> None:
        """Drop what does not run yet, and wait for what does."""
        self._executor.shutdown(wait=True, cancel_futures=True)


class RemoteCrew:
    """Workers elsewhere, who write to a directory that they share, or give files back."""

    on_this_machine = False

    def __init__(self, remote: Remote, store: RunDirectory, board: FileBoard, *, force: bool) -> None:
        self._remote, self._force = remote, force
        self.board, self.workers = board, remote.workers
        self._shared = remote.shares(store.root)
        self._store = RunDirectory(store.root.resolve()) if self._shared else store
        self._stop = remote.stop_sign(store.root.resolve())
        self._futures: list[Future[Done]] = []

    def batches(self, trials: Mapping[int, Trial]) -> list[Batch]:
        """Divide trials into batches: each by itself, but where there are GPUs for them.

        Raises:
            DeviceError: trials need a GPU, and no worker has one.
        """
        needing = [trial for trial in trials.values() if trial.settings.device.startswith("cuda")]
        if needing and not self._remote.gpus:
            raise DeviceError(
                f"{needing[0].label} needs a GPU, and no worker offers one; start workers with --resources 'GPU=1', "
                "or set device: cpu"
            )
        return place(trials, ["cuda"] * self._remote.gpus)

    def submit(self, trials: Mapping[int, Trial], device: str) -> Future[Done]:
        """Hand a batch to a worker, which has a resource called GPU if the batch needs one."""
        parcels = None if self._shared else {i: parcel_for(trial, self._store) for i, trial in trials.items()}
        job = Job(trials, self._store, device, _threads(trials.values()), self._force, Errand(self._stop, parcels))
        self._futures.append(self._remote.executor.submit(work, job))
        return self._futures[-1]

    def stop(self) -> None:
        """Ask workers to write checkpoints and stop, if they can be reached."""
        with suppress(OSError, RuntimeError, TimeoutError):
            self._stop.set()

    def close(self) -> None:
        """Drop what does not run yet, and wait for what does."""
        # Nothing is cancelled: Dask would forget a running trial's files, and one that waits sees the sign and ends.
        wait(self._futures)
        with suppress(OSError, RuntimeError, TimeoutError):
            self._stop.clear()


def _threads(trials: Iterable[Trial]) -> int:
    return min((trial.settings.threads for trial in trials if trial.settings.threads != "auto"), default=1)


def is_death(error: BaseException) -> bool:
    """Whether an exception in place of a result says that a worker died: of ours, of loky's, or of Dask's."""
    return isinstance(error, BrokenProcessPool) or type(error).__name__ in ("KilledWorker", "TerminatedWorkerError")
