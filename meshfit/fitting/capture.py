"""Replaying as one CUDA graph what launches the same kernels at every call: launches take longer than small kernels."""

import warnings
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import torch

from meshfit.errors import MeshfitWarning

_Result = TypeVar("_Result")
_WARM_UP = 3


def captured(
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
