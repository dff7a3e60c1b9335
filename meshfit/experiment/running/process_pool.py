"""Worker processes of this machine, and the environment that they inherit."""

import gc
import importlib
import multiprocessing
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from meshfit.errors import TrialError
from meshfit.experiment.running.shared_progress import SharedProgress
from meshfit.library_output import silence_libraries

MOST_DEATHS = 3
"""Number of workers that may die in succession without having started a trial."""

_Result = TypeVar("_Result")
_Call = tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]

# Threads of numerical libraries spin while they wait for each other, which is costly where workers share cores.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "IGL_NUM_THREADS"), "1")


class ProcessPool:
    """A pool of `workers` processes for the CPU and one for each other device, each started when it is first needed.

    A call whose process dies ends with `BrokenProcessPool`; other calls continue, and the process is replaced.

    Pools of pebble also replace a process that dies during a call. But one that dies while it is idle breaks the whole
    pool, and cancelling a call kills its process before it has written a checkpoint.

    Args:
        workers: number of processes for the CPU.
        progress: shared with all processes.
        preload: module that each process imports as it starts.
    """

    def __init__(self, workers: int, progress: SharedProgress, *, preload: str | None = None) -> None:
        self.workers, self.progress = workers, progress
        self._preload = preload
        self._queues: dict[str, queue.SimpleQueue[_Call | None]] = {}
        self._threads: list[threading.Thread] = []

    def submit(self, device: str, function: Callable[..., _Result], *args: object) -> Future[_Result]:
        """Have a worker of a device call a function."""
        if device not in self._queues:
            self._queues[device] = queue.SimpleQueue()
            for _ in range(self.workers if device == "cpu" else 1):
                thread = threading.Thread(target=self._serve, args=(self._queues[device],), daemon=True)
                self._threads.append(thread)
                thread.start()
        future: Future[_Result] = Future()
        self._queues[device].put((future, function, args))
        return future

    def count_gpus(self) -> int:
        """Count the GPUs in a worker, and let all workers of the CPU load torch, which they need in any case.

        Raises:
            TrialError: workers die before they have counted.
        """
        for _ in range(self.workers - 1):
            self.submit("cpu", _count_gpus)
        return self.call(_count_gpus)

    def call(self, function: Callable[..., _Result], *args: object) -> _Result:
        """Have a worker of the CPU call a function, and wait for the result; if it dies, another one takes over.

        Raises:
            TrialError: workers die again and again.
        """
        for _ in range(1 + MOST_DEATHS):
            with suppress(BrokenProcessPool):
                return self.submit("cpu", function, *args).result()
        raise workers_die()

    def close(self, *, cancel: bool = False) -> None:
        """Wait for the calls to end, and end the workers; `cancel` drops the calls that have not started."""
        for calls in self._queues.values():
            if cancel:
                _cancel_all(calls)
            for _ in self._threads:
                calls.put(None)
        for thread in self._threads:
            thread.join()

    def _serve(self, calls: "queue.SimpleQueue[_Call | None]") -> None:
        """Pass calls to one process, one after the other, until there are no more."""
        process: ProcessPoolExecutor | None = None
        while (call := calls.get()) is not None:
            future, function, args = call
            if not future.set_running_or_notify_cancel():
                continue
            try:
                with interrupts_blocked(), _start_failures_named(), _main_module_hidden():
                    process = process or self._new_process()
                    running = process.submit(function, *args)
                future.set_result(running.result())
            except BaseException as error:  # noqa: BLE001  any error belongs to the call
                if isinstance(error, BrokenProcessPool) and process is not None:
                    process.shutdown()
                    process = None
                future.set_exception(error)
        if process is not None:
            process.shutdown()

    def _new_process(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, context, _start_worker, (self.progress.shared, self._preload))


@contextmanager
def _start_failures_named() -> Iterator[None]:
    """Raise what keeps the system from starting a process as an error of one line."""
    try:
        yield
    except (OSError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or "not enough memory"
        raise TrialError(f"cannot start a worker process: {reason}; try --jobs 1") from error


def workers_die() -> TrialError:
    """Return the error to raise where so many workers have died."""
    return TrialError("worker processes are killed again and again; perhaps memory is short; try --jobs 1")


_starting = threading.Lock()


@contextmanager
def _main_module_hidden() -> Iterator[None]:
    """Keep processes that start from running the main module, which calls need nothing of.

    Otherwise a script without `if __name__ == "__main__"` would start itself again in each process, and one that is
    read from standard input could not be found.
    """
    main: dict[str, Any] = vars(sys.modules["__main__"])
    with _starting:
        previous: dict[str, Any] = {name: main[name] for name in ("__file__", "__spec__") if name in main}
        main.update(dict.fromkeys(previous))
        try:
            yield
        finally:
            main.update(previous)


def _cancel_all(calls: "queue.SimpleQueue[_Call | None]") -> None:
    while True:
        try:
            call = calls.get_nowait()
        except queue.Empty:
            return
        if call is not None:
            call[0].cancel()
            call[0].set_running_or_notify_cancel()


_worker_progress: SharedProgress | None = None


def worker_progress() -> SharedProgress:
    """Return the progress that this process shares with its parent.

    Raises:
        RuntimeError: this process is not a worker of a `ProcessPool`.
    """
    if _worker_progress is None:
        raise RuntimeError("this process was not started by a ProcessPool")
    return _worker_progress


def _start_worker(shared: Any, preload: str | None) -> None:  # noqa: ANN401  a ctypes array, which has no public type
    """Ignore Ctrl-C, on which the parent asks for checkpoints, end with the parent, and import a module, quietly."""
    global _worker_progress  # noqa: PLW0603  set once in each worker
    silence_libraries()
    _worker_progress = SharedProgress(shared)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    if preload is not None:
        # To look for garbage among what is imported takes a sixth of that time, and again at the exit.
        gc.disable()
        importlib.import_module(preload)
        gc.freeze()
        gc.enable()


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _count_gpus() -> int:
    import torch  # in a worker, which saves the parent process two seconds

    return torch.cuda.device_count()


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C while processes start; they inherit the block, so that only the parent ever gets it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # it unblocks the signal when it starts, so it has to start before
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


@contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for the duration of a block."""
    previous = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in previous.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
