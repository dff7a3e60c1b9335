"""Worker processes: several for the CPU, and one for each other device."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Any, ParamSpec, TypeVar

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


class Pools:
    """Pools of processes by device, each started when it is first given work.

    There are `workers` of them for the CPU; each calls `initializer` with `argument` when it starts.
    """

    def __init__(self, workers: int, initializer: Callable[[Any], None], argument: Any) -> None:  # noqa: ANN401
        self._workers, self._initializer, self._argument = workers, initializer, argument
        self._pools: dict[str, ProcessPoolExecutor] = {}

    def submit(
        self,
        device: str,
        function: Callable[_Parameters, _Result],
        *args: _Parameters.args,
        **kwargs: _Parameters.kwargs,
    ) -> Future[_Result]:
        """Have a worker of a device call a function."""
        if device not in self._pools:
            workers = self._workers if device == "cpu" else 1
            context = multiprocessing.get_context("spawn")
            self._pools[device] = ProcessPoolExecutor(workers, context, self._initializer, (self._argument,))
        return self._pools[device].submit(function, *args, **kwargs)

    def count_gpus(self) -> Future[int]:
        """Ask the CPU's workers, all of which load torch for it, as they have to in any case."""
        first, *_ = [self.submit("cpu", _count_gpus) for _ in range(self._workers)]
        return first

    def shutdown(self) -> None:
        """Wait for what runs, and drop what does not run yet."""
        for pool in self._pools.values():
            pool.shutdown(wait=True, cancel_futures=True)


def _count_gpus() -> int:
    import torch  # the parent process does without it, which saves it two seconds

    return torch.cuda.device_count()
