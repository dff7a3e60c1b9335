"""Timing of benchmarks: medians of wall and CPU time over repetitions, against a twin in the same run."""

import resource
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class Benchmark:
    """What is timed, what it is set against, and what is asked of it.

    Attributes:
        ours: what is timed.
        repeat: how often.
        other: what is timed in turns with it, if anything.
        other_name: what that is.
        ratio: `faster`: the time of the other over ours, to be at least the target; `growth`: ours over the other's, to
            be at most the target.
        target: of the ratio.
        clock: which time the ratio and the limit are of.
        limit: most seconds that are allowed.
        memory_limit_mb: most memory that is allowed.
        calls, other_calls: how often each is called in a row at its turn; times are those of one call.
    """

    ours: Callable[[], object]
    repeat: int
    other: Callable[[], object] | None = None
    other_name: str = ""
    ratio: Literal["faster", "growth"] = "faster"
    target: float | None = None
    clock: Literal["wall", "cpu"] = "cpu"
    limit: float | None = None
    memory_limit_mb: float | None = None
    calls: int = 1
    other_calls: int = 1


@dataclass(frozen=True)
class Timing:
    """Median seconds of one thing, on the wall and on the CPU, and the spread of the former (half the middle half)."""

    wall: float
    cpu: float
    spread: float


@dataclass(frozen=True)
class Outcome:
    """The timings of a benchmark, in plain values that can be written to a file.

    Attributes:
        ours, other: the timings; None where there is no other.
        ratio: as the benchmark defines it.
        asked: the target of the ratio and the limits, in words.
        short: whether it falls short of one of them.
        memory_limit_mb: most memory that is allowed.
        memory_mb: the most memory of a process that does nothing else but this, once.
    """

    ours: Timing
    other: Timing | None
    other_name: str
    ratio: float | None
    asked: str
    short: bool
    memory_limit_mb: float | None
    memory_mb: float = 0.0

    def with_memory(self, memory_mb: float) -> "Outcome":
        """The same with its memory, which counts too."""
        fat = self.memory_limit_mb is not None and memory_mb > self.memory_limit_mb
        return replace(self, memory_mb=memory_mb, short=self.short or fat)


def run(benchmark: Benchmark) -> Outcome:
    """Time a benchmark and its twin in turns, so that a busy machine slows both."""
    benchmark.ours()
    ours, other = [], []
    for _ in range(benchmark.repeat):
        ours.append(_once(benchmark.ours, benchmark.calls))
        if benchmark.other is not None:
            other.append(_once(benchmark.other, benchmark.other_calls))
    mine, theirs = _median(ours), _median(other) if other else None
    ratio = None if theirs is None else _ratio(benchmark, mine, theirs)
    late = benchmark.limit is not None and _time(benchmark, mine) > benchmark.limit
    short = ratio is not None and benchmark.target is not None and not _reached(benchmark, ratio)
    return Outcome(
        mine, theirs, benchmark.other_name, ratio, _asked(benchmark), late or short, benchmark.memory_limit_mb
    )


def _ratio(benchmark: Benchmark, ours: Timing, other: Timing) -> float:
    mine, theirs = (_time(benchmark, timing) for timing in (ours, other))
    return theirs / mine if benchmark.ratio == "faster" else mine / theirs


def _time(benchmark: Benchmark, timing: Timing) -> float:
    return timing.wall if benchmark.clock == "wall" else timing.cpu


def _reached(benchmark: Benchmark, ratio: float) -> bool:
    return ratio >= benchmark.target if benchmark.ratio == "faster" else ratio <= benchmark.target


def _asked(benchmark: Benchmark) -> str:
    sign = "≥" if benchmark.ratio == "faster" else "≤"
    parts = {
        f"{sign} {benchmark.target} ×": benchmark.target,
        f"≤ {seconds(benchmark.limit or 0)}": benchmark.limit,
        f"≤ {benchmark.memory_limit_mb} MB": benchmark.memory_limit_mb,
    }
    return ", ".join(text for text, value in parts.items() if value is not None)


def seconds(value: float) -> str:
    """A time for a person to read."""
    return f"{value:.2f} s" if value >= 1 else f"{value * 1000:.1f} ms"


def _once(function: Callable[[], object], calls: int) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), _cpu()
    for _ in range(calls):
        function()
    return (time.perf_counter() - wall) / calls, (_cpu() - cpu) / calls


def _cpu() -> float:
    """CPU time of this process and of the children that it has waited for."""
    return time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])


def _median(times: list[tuple[float, float]]) -> Timing:
    walls, cpus = ([time[i] for time in times] for i in (0, 1))
    quarters = statistics.quantiles(walls, n=4) if len(walls) > 1 else [0.0, 0.0, 0.0]
    return Timing(statistics.median(walls), statistics.median(cpus), (quarters[2] - quarters[0]) / 2)
