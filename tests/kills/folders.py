"""Run directories that are taken away in the middle of a trial: moved, removed, made read-only, or full."""

import os
import resource
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from tests.cli.processes import wait_until
from tests.kills.experiments import FITS, Experiment
from tests.kills.signals import check_kept, check_phase, finish, named

_SIZE = "size=4m"
_TIGHT = 4096
"""Bytes that are left on a full disk."""


@dataclass(frozen=True)
class Loss:
    """The loss of the run directory at a phase."""

    how: str
    phase: str

    def __str__(self) -> str:
        return f"run directory {self.how} while {self.phase}"


@dataclass(frozen=True)
class Chain:
    """Losses of one run directory."""

    engine: str
    kills: tuple[Loss, ...]

    def __str__(self) -> str:
        return f"{self.engine}, lost run directories"


def chains() -> list[Chain]:
    """Every loss at each phase, in both engines."""
    losses = tuple(Loss(*each) for each in product(_LOSSES, ("fitting", "measuring")))
    return [Chain(engine, losses) for engine in FITS]


def disturb(chain: Chain, folder: Path, reference: Mapping[int, str], report: Callable[[str], None]) -> None:
    """Lose a run directory again and again, and check that what was in it is taken up when it is back.

    Raises:
        AssertionError: saying which loss did what.
    """
    disk = folder.with_name(f"{folder.name}-disk")
    resumed, kept = set[int](), dict[int, str]()
    with _mounted(disk):
        experiment = Experiment(folder, chain.engine, runs=disk / "runs")
        for seed, loss in enumerate(chain.kills):
            with named(loss):
                process = experiment.start([*range(max(0, seed - 1), seed), seed], "-j", 1)
                experiment.pause.arm(loss.phase, seed)
                hit(loss, process, experiment, seed)
                if loss.how == "removed":
                    resumed, kept = set(), {}
                else:
                    resumed.add(seed)
                    kept = check_kept(experiment, kept, reference, resumed)
            report(str(loss))
        experiment.pause.disarm()
        finish(experiment, len(chain.kills), reference, resumed)


def hit(loss: Loss, process: subprocess.Popen[str], experiment: Experiment, seed: int) -> None:
    """Take the run directory away once the phase is reached, and give it back after the run has ended."""
    try:
        wait_until(lambda: experiment.pause.process is not None, process)
        check_phase(loss.phase, experiment, seed)
        with _LOSSES[loss.how](experiment):
            experiment.pause.release()
            out, err = process.communicate(timeout=300)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert process.returncode == 2, f"exit code {process.returncode}\n{out}{err}"
    assert err.startswith("error: "), err
    assert len(err.splitlines()) == 1, err
    assert loss.how == "removed" or (experiment.trial(seed) / "checkpoint.pt").is_file()


@contextmanager
def _mounted(disk: Path) -> Iterator[None]:
    """Mount a small file system, which takes the right to do so; without it, the folder is one of a large one."""
    disk.mkdir()
    mounted = subprocess.run(mount_command(disk), capture_output=True, check=False).returncode == 0
    try:
        yield
    finally:
        if mounted:
            subprocess.run(["umount", disk], check=True)


def mount_command(disk: Path) -> list[str]:
    return ["mount", "-t", "tmpfs", "-o", _SIZE, "tmpfs", str(disk)]


@contextmanager
def _moved(experiment: Experiment) -> Iterator[None]:
    runs, place = experiment.runs, experiment.runs.with_name("elsewhere")
    runs.rename(place)
    yield
    if runs.exists():
        shutil.rmtree(runs)
    place.rename(runs)


@contextmanager
def _removed(experiment: Experiment) -> Iterator[None]:
    shutil.rmtree(experiment.runs)
    yield


@contextmanager
def _read_only(experiment: Experiment) -> Iterator[None]:
    places = [experiment.runs, *experiment.runs.rglob("*")]
    modes = [place.stat().st_mode for place in places]
    for place in places:
        place.chmod(place.stat().st_mode & ~0o222)
    yield
    for place, mode in zip(places, modes, strict=True):
        place.chmod(mode)


@contextmanager
def _full(experiment: Experiment) -> Iterator[None]:
    """Fill the disk; where it is a large one, let the worker write no file that is longer than a page instead."""
    runs = experiment.runs
    if not runs.parent.is_mount():
        worker = experiment.pause.process
        assert worker is not None
        resource.prlimit(worker, resource.RLIMIT_FSIZE, (_TIGHT, _TIGHT))
        yield
        return
    filler = runs.with_name("filler")
    with filler.open("wb", buffering=0) as file:
        free = os.statvfs(runs).f_bavail * os.statvfs(runs).f_frsize
        file.write(bytes(free - _TIGHT))
    yield
    filler.unlink()


_LOSSES = {"moved": _moved, "removed": _removed, "made read-only": _read_only, "full": _full}
