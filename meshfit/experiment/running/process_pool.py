"""Worker processes on this machine, each by itself: one that dies takes no other with it, and is replaced."""

import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from typing import Any, ParamSpec, TypeVar

from meshfit.experiment.running.environment import interrupts_held
from meshfit.experiment.running.progress import Board

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")
_Call = tuple[Future[Any], Callable[..., Any], tuple[Any, ...], dict[str, Any]]


class LocalExecutor(Executor):
    """Processes of this machine: `workers` of them for the CPU, one for each other device; started when first needed.

    A call whose process dies ends with `BrokenProcessPool`; the calls beside it and after it are not concerned.
    """

    def __init__(self, workers: int, board: Board) -> None:
        self._workers, self._board = workers, board
        self._queues: dict[str, queue.SimpleQueue[_Call | None]] = {}
        self._threads: list[threading.Thread] = []

    def submit(
        self,
        fn: Callable[_Parameters, _Result],
        /,
        *args: _Parameters.args,
        **kwargs: _Parameters.kwargs,
    ) -> Future[_Result]:
        """Have a worker call a function; that of a device, if the first argument has one as its `device`."""
        device = getattr(args[0], "device", "cpu") if args else "cpu"
        if device not in self._queues:
            self._queues[device] = queue.SimpleQueue()
            for _ in range(self._workers if device == "cpu" else 1):
                thread = threading.Thread(target=self._attend, args=(self._queues[device],), daemon=True)
                self._threads.append(thread)
                thread.start()
        future: Future[_Result] = Future()
        self._queues[device].put((future, fn, args, kwargs))
        return future

    def count_gpus(self) -> int:
        """Ask the CPU's workers, all of which load torch for it, as they have to in any case."""
        first, *_ = [self.submit(_count_gpus) for _ in range(self._workers)]
        return first.result()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:  # noqa: FBT001, FBT002  as declared
        """Take no more calls, and end the workers when they are done with those there are."""
        for calls in self._queues.values():
            if cancel_futures:
                _cancel_all(calls)
            for _ in self._threads:
                calls.put(None)
        if wait:
            for thread in self._threads:
                thread.join()

    def _attend(self, calls: "queue.SimpleQueue[_Call | None]") -> None:
        """Hand calls to one process after the other, until there are no more."""
        process: ProcessPoolExecutor | None = None
        while (call := calls.get()) is not None:
            future, function, args, kwargs = call
            if not future.set_running_or_notify_cancel():
                continue
            try:
                with interrupts_held():
                    process = process or self._new_process()
                    running = process.submit(function, *args, **kwargs)
                future.set_result(running.result())
            except BaseException as error:  # noqa: BLE001  whatever it is, it belongs to the call
                if isinstance(error, BrokenProcessPool) and process is not None:
                    process.shutdown()
                    process = None
                future.set_exception(error)
        if process is not None:
            process.shutdown()

    def _new_process(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, context, _start_worker, (self._board.shared,))


def _cancel_all(calls: "queue.SimpleQueue[_Call | None]") -> None:
    while True:
        try:
            call = calls.get_nowait()
        except queue.Empty:
            return
        if call is not None:
            call[0].cancel()
            call[0].set_running_or_notify_cancel()


_board: Board | None = None


def board_of_worker() -> Board | None:
    """The board that this process posts to, if it is a worker of a `LocalExecutor`."""
    return _board


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


def _count_gpus() -> int:
    import torch  # the parent process does without it, which saves it two seconds

    return torch.cuda.device_count()
