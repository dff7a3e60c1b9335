"""Benchmarks in processes of their own, so that none has the memory, the caches or the threads of another."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from tests.benchmarks.commands import COMMANDS
from tests.benchmarks.timing import Benchmark, Outcome, run

_Result = TypeVar("_Result")


def names() -> list[str]:
    """The names of all benchmarks."""
    return _apart(_names)


def outcome_of(name: str) -> Outcome:
    """Time a benchmark, and then once more see how much memory it takes."""
    return _apart(_time, name).with_memory(_apart(_memory, name))


def _apart(function: Callable[..., _Result], *args: object) -> _Result:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *args).result()


def _names() -> list[str]:
    from tests.benchmarks.cases import CASES

    return [*CASES, *COMMANDS]


def _benchmark(name: str) -> Benchmark:
    if name in COMMANDS:
        return COMMANDS[name]()
    import torch

    from tests.benchmarks.cases import CASES

    torch.set_num_threads(1)
    return CASES[name]()


def _time(name: str) -> Outcome:
    return run(_benchmark(name))


def _memory(name: str) -> float:
    _benchmark(name).ours()
    from meshfit.experiment.running.trial_runner import peak_memory_mb  # not before, for its memory

    return peak_memory_mb(of_children=True) or peak_memory_mb() or 0.0
