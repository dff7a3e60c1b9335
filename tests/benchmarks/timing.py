"""How benchmarks are timed: medians over repetitions, wall time beside CPU time, against a twin in the same run."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """Median seconds of one thing, on the wall and on the CPU, and the spread of the former (half the middle half)."""

    wall: float
    cpu: float
    spread: float


@dataclass(frozen=True)
class Benchmark:
    """One line: what was timed, and what it is compared with, if anything; a target is a ratio of twin to ours."""

    name: str
    ours: Callable[[], object]
    repeat: int
    twin: Callable[[], object] | None = None
    twin_name: str = ""
    target: float | None = None


@dataclass(frozen=True)
class Outcome:
    """A benchmark and its timings."""

    benchmark: Benchmark
    ours: Timing
    twin: Timing | None

    @property
    def ratio(self) -> float | None:
        """How many times faster than the twin."""
        return None if self.twin is None else self.twin.cpu / self.ours.cpu


def run(benchmark: Benchmark) -> Outcome:
    """Time a benchmark and its twin in turns, so that a busy machine slows both."""
    benchmark.ours()
    ours, twin = [], []
    for _ in range(benchmark.repeat):
        ours.append(_once(benchmark.ours))
        if benchmark.twin is not None:
            twin.append(_once(benchmark.twin))
    return Outcome(benchmark, _median(ours), _median(twin) if twin else None)


def _once(function: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    function()
    return time.perf_counter() - wall, time.process_time() - cpu


def _median(times: list[tuple[float, float]]) -> Timing:
    walls, cpus = ([time[i] for time in times] for i in (0, 1))
    quarters = statistics.quantiles(walls, n=4) if len(walls) > 1 else [0.0, 0.0, 0.0]
    return Timing(statistics.median(walls), statistics.median(cpus), (quarters[2] - quarters[0]) / 2)
