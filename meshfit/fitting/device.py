"""Devices: selection by name, single-threaded execution on the CPU, and CUDA-graph capture."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Generic, TypeVar

import torch

from meshfit.errors import DeviceError, MeshfitWarning

DEVICES = "auto, cpu, cuda, cuda:N, mps"

_CALLS_BEFORE_CAPTURE = 3

_Result = TypeVar("_Result")


def resolve_device(name: str, dtype: str = "float32") -> torch.device:
    """Return the torch device of a setting; `auto` is the CUDA device if there is one, and the CPU otherwise.

    Raises:
        DeviceError: not a device name, or a device that this machine lacks, or that has no such dtype.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise DeviceError(f"device: '{name}' is not a device; allowed: {DEVICES}") from None
    if device.type not in ("cpu", "cuda", "mps"):
        raise DeviceError(f"device: '{name}' is not supported; allowed: {DEVICES}")
    count = {"cpu": 1, "cuda": torch.cuda.device_count(), "mps": int(torch.backends.mps.is_available())}[device.type]
    if not 0 <= (device.index or 0) < count:  # torch lets large indices overflow to negative ones
        reason = f"only {count} of its kind here" if count else "none of its kind here, or torch was built without it"
        raise DeviceError(f"device: '{name}' is not available ({reason}); use device: cpu, or auto")
    if device.type == "mps" and dtype == "float64":
        raise DeviceError("device: 'mps' has no float64; use dtype: float32")
    return device


@contextmanager
def single_thread() -> Iterator[None]:
    """Run torch on one CPU thread: more are slower at the sizes of a fit, and one keeps the order of sums."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def as_cuda_graph(
    function: Callable[[], _Result], generators: Sequence[torch.Generator], device: torch.device
) -> Callable[[], _Result]:
    """Wrap a function so that, on CUDA, it is captured as a graph after a few calls and replayed from then on.

    Args:
        function: reads tensors at fixed addresses, and never waits for the device.
        generators: the random generators it draws from.
        device: the device it runs on.

    Returns:
        A function with the same results. Every replay returns the same tensors with new contents.
    """
    return _CudaGraph(function, generators) if device.type == "cuda" else function


class _CudaGraph(Generic[_Result]):
    def __init__(self, function: Callable[[], _Result], generators: Sequence[torch.Generator]) -> None:
        self._function, self._generators = function, generators
        self._calls_until_capture = _CALLS_BEFORE_CAPTURE
        self._graph: torch.cuda.CUDAGraph | None = None
        self._result: _Result | None = None

    def __call__(self) -> _Result:
        if self._calls_until_capture == 0:
            self._capture()
        self._calls_until_capture -= 1
        if self._graph is None or self._result is None:
            return self._function()
        self._graph.replay()
        return self._result

    def _capture(self) -> None:
        graph = torch.cuda.CUDAGraph()
        for generator in self._generators:
            graph.register_generator_state(generator)
        try:
            with torch.cuda.graph(graph):
                self._result = self._function()
        except RuntimeError as error:
            reason = str(error).partition("\n")[0]
            warnings.warn(f"steps run without a CUDA graph, and slower: {reason}", MeshfitWarning, stacklevel=4)
            return
        self._graph = graph
