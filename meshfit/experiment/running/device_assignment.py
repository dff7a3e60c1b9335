"""Where trials run: how many side by side, with how many threads, on which devices, and which of them in one batch."""

import os
from collections.abc import Mapping, Sequence
from itertools import cycle
from math import ceil
from pathlib import Path
from typing import NamedTuple

from meshfit.experiment.plan import Trial

_MOST_TOGETHER = 64
_MOST_THREADS = 2
_MEMORY_OF_TRIAL = 600e6
_SHARE_OF_MEMORY = 0.8
_QUOTA = Path("/sys/fs/cgroup/cpu.max")


class Batch(NamedTuple):
    """Trials that are fitted in one go, by their numbers, and the device for it."""

    device: str
    numbers: tuple[int, ...]


def place(trials: Mapping[int, Trial], gpus: Sequence[str]) -> list[Batch]:
    """Divide trials into batches.

    On the CPU each trial is by itself, so that workers share them evenly and one that dies takes no other with it. On
    other devices those of the same settings go together: a step there costs about the same for one as for many.

    Args:
        trials: what to run, by number.
        gpus: the CUDA devices there are, each by the name that its worker calls it.
    """
    alike: dict[tuple[str, ...], list[int]] = {}
    for number, trial in trials.items():
        alike.setdefault(_likeness(trial, number, gpus=bool(gpus)), []).append(number)
    shares, batches = max(len(gpus), 1), list[Batch]()
    devices = cycle(gpus or ["cuda:0"])
    for (device, *_), numbers in alike.items():
        fair = ceil(len(numbers) / shares) if device == "cuda" else len(numbers)
        most = min(_MOST_TOGETHER, fair)
        for start in range(0, len(numbers), most):
            chosen = next(devices) if device == "cuda" else device
            batches.append(Batch(chosen, tuple(numbers[start : start + most])))
    return batches


def _likeness(trial: Trial, number: int, *, gpus: bool) -> tuple[str, ...]:
    settings = trial.settings
    device = settings.device if settings.device != "auto" else "cuda" if gpus else "cpu"
    return (device, str(number)) if device == "cpu" else (device, settings.dtype, settings.fit.model_dump_json())


def workers_and_threads(trials: Sequence[Trial], jobs: int | None) -> tuple[int, int]:
    """How many processes on the CPU, and how many threads in each, so that the cores are full and none is asked twice.

    Args:
        trials: what to run.
        jobs: how many processes; None leaves it to the trials' settings.
    """
    cores = available_cores()
    asked = [trial.settings.jobs for trial in trials if trial.settings.jobs != "auto"]
    workers = jobs or min(asked, default=min(cores, _trials_in_memory()))
    workers = max(1, min(workers, len(trials)))
    wanted = [trial.settings.threads for trial in trials if trial.settings.threads != "auto"]
    return workers, min(wanted, default=max(1, min(_MOST_THREADS, cores // workers)))


def available_cores() -> int:
    """The cores that this process may use: those it is bound to, and no more than a container's quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = _QUOTA.read_text().split()
    except (OSError, ValueError):
        return cores
    return cores if quota == "max" else max(1, min(cores, int(quota) // int(period)))


def _trials_in_memory() -> int:
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows
        return os.cpu_count() or 1
    return max(1, int(_SHARE_OF_MEMORY * memory / _MEMORY_OF_TRIAL))
