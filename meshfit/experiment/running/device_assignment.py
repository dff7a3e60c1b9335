"""Assignment of trials to devices, batches, processes and threads."""

import os
from collections.abc import Mapping, Sequence
from itertools import cycle
from math import ceil
from pathlib import Path
from typing import NamedTuple

from meshfit.experiment.plan import Trial

_MAX_BATCH = 64
_MAX_THREADS = 2
_BYTES_PER_TRIAL = 600e6
_USABLE_MEMORY = 0.8
_CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")


class Batch(NamedTuple):
    """Trials that are fitted together, by number, and their device."""

    device: str
    numbers: tuple[int, ...]


def assign_devices(trials: Mapping[int, Trial], gpus: Sequence[str]) -> list[Batch]:
    """Divide trials into batches, each for a device.

    On the CPU each trial is a batch of its own, so that the load is even and a worker that dies stops no other trial.
    On other devices trials of the same settings share a batch, since a step costs about the same for one as for many.

    Args:
        trials: trials by number.
        gpus: names of the CUDA devices, as their workers call them.
    """
    groups: dict[tuple[str, ...], list[int]] = {}
    for number, trial in trials.items():
        groups.setdefault(_batch_key(trial, number, gpus=bool(gpus)), []).append(number)
    batches = list[Batch]()
    devices = cycle(gpus or ["cuda:0"])
    for (device, *_), numbers in groups.items():
        per_gpu = ceil(len(numbers) / max(len(gpus), 1)) if device == "cuda" else len(numbers)
        size = min(_MAX_BATCH, per_gpu)
        for start in range(0, len(numbers), size):
            assigned = next(devices) if device == "cuda" else device
            batches.append(Batch(assigned, tuple(numbers[start : start + size])))
    return batches


def _batch_key(trial: Trial, number: int, *, gpus: bool) -> tuple[str, ...]:
    settings = trial.settings
    device = settings.device if settings.device != "auto" else "cuda" if gpus else "cpu"
    if settings.fit.method == "external":
        device = "cpu"
    return (device, str(number)) if device == "cpu" else (device, settings.dtype, settings.fit.model_dump_json())


def workers_and_threads(trials: Sequence[Trial], jobs: int | None) -> tuple[int, int]:
    """Choose the number of processes on the CPU and of threads in each, so that each core has about one thread.

    Args:
        trials: the trials to run.
        jobs: the number of processes; None takes it from the settings.
    """
    cores = available_cores()
    jobs_set = [trial.settings.jobs for trial in trials if trial.settings.jobs != "auto"]
    workers = jobs or min(jobs_set, default=min(cores, _trials_in_memory()))
    workers = max(1, min(workers, len(trials)))
    threads_set = [trial.settings.threads for trial in trials if trial.settings.threads != "auto"]
    return workers, min(threads_set, default=max(1, min(_MAX_THREADS, cores // workers)))


def available_cores() -> int:
    """Return the number of cores that this process may use: those it is bound to, up to its container's quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = _CPU_QUOTA.read_text().split()
    except (OSError, ValueError):
        return cores
    return cores if quota == "max" else max(1, min(cores, int(quota) // int(period)))


def _trials_in_memory() -> int:
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows
        return os.cpu_count() or 1
    return max(1, int(_USABLE_MEMORY * memory / _BYTES_PER_TRIAL))
