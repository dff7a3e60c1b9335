"""Which device a fit runs on, and with how many threads."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Generic, TypeVar

import torch

from meshfit.errors import DeviceError, MeshfitWarning

DEVICES = "auto, cpu, cuda, cuda:N, mps"


def resolve_device(name: str, dtype: str = "float32") -> torch.device:
    """The torch device of a setting; `auto` takes a CUDA device where there is one, and the CPU otherwise.

    Raises:
        DeviceError: not a device name, a device that is not there, or one that has no such dtype.
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
        found = f"only {count} of its kind here" if count else "none of its kind here, or torch was built without it"
        raise DeviceError(f"device: '{name}' is not available ({found}); use device: cpu, or auto")
    if device.type == "mps" and dtype == "float64":
        raise DeviceError("device: 'mps' has no float64; use dtype: float32")
    return device


@contextmanager
def single_thread() -> Iterator[None]:
    """Run torch on one CPU thread: at the sizes of a fit more cost more than they bring, and one keeps sums ordered."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


_Result = TypeVar("_Result")
_WARM_UP = 3


def as_cuda_graph(
    function: Callable[[], _Result], generators: Sequence[torch.Generator], device: torch.device
) -> Callable[[], _Result]:
    """On a CUDA device, what captures a function after a few calls and replays it from then on; else the function.

    Args:
        function: reads tensors at fixed places, and never waits for the device.
        generators: that it draws from.
        device: that it runs on.

    Returns:
        A function of the same results. A replay returns the same tensors as the one before it, with new contents.
    """
    return _Captured(function, generators) if device.type == "cuda" else function


class _Captured(Generic[_Result]):
    def __init__(self, function: Callable[[], _Result], generators: Sequence[torch.Generator]) -> None:
        self._function, self._generators = function, generators
        self._calls_until_capture = _WARM_UP
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
