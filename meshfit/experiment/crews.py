"""Who runs trials: processes of this machine, or workers elsewhere."""

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from typing import Protocol

from meshfit.errors import DeviceError
from meshfit.experiment.board import Board
from meshfit.experiment.file_board import FileBoard
from meshfit.experiment.local import LocalExecutor
from meshfit.experiment.parcels import parcel_for
from meshfit.experiment.placement import Batch, place, workers_and_threads
from meshfit.experiment.plan import Trial
from meshfit.experiment.progress import Phase
from meshfit.experiment.remote import Remote
from meshfit.experiment.store import RunDirectory
from meshfit.experiment.work import Done, Errand, Job, work
from meshfit.fitting.progress import Step


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
